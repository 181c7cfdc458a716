# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commands run in this process: what they print, return and refuse."""

from __future__ import annotations

import contextlib
import io
import json
import os
from pathlib import Path
from typing import NamedTuple

from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file

URDF = str(config_file("human_arm.urdf"))
START, GOAL = "-0.2,0.1,0.5,-0.4", "shoulder1=-1.2,elbow=-0.9"


class Done(NamedTuple):
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


def run(*words: object, ok: bool | None = None) -> Done:
    """Run a command as the program does; check its status if told to."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main([*map(str, words)])
        except SystemExit as leaving:
            status = int(leaving.code or 0)
    if ok is not None:
        assert (status == 0) == ok, err.getvalue()
    return Done(status, out.getvalue(), err.getvalue())


def result(*words: object) -> dict:
    """The JSON object that a command prints, which must succeed."""
    return json.loads(run(*words, "--json", ok=True).stdout)


def refusal(*words: object) -> str:
    """The one line with which a command refuses its input."""
    status, out, err = run(*words)
    assert (status, out) == (2, "")
    (line,) = err.splitlines()
    return line


def with_folder(folder: Path) -> str:
    """The PYTHONPATH with another folder in it."""
    return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
