# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commands run in this process: what they print, return and refuse."""

from __future__ import annotations

import contextlib
import io
import json
import os
from pathlib import Path

from mp_pca_planner.cli.main import main


def run(*words: object) -> tuple[int, str, str]:
    """Run a command; return its status and what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main([*map(str, words)])
        except SystemExit as leaving:
            status = int(leaving.code or 0)
    return status, out.getvalue(), err.getvalue()


def result(*words: object) -> dict:
    """The JSON object that a command prints, which must succeed."""
    status, out, err = run(*words, "--json")
    assert status == 0, err
    return json.loads(out)


def refusal(*words: object) -> str:
    """The one line with which a command refuses its input."""
    status, out, err = run(*words)
    assert (status, out) == (2, "")
    (line,) = err.splitlines()
    return line


def with_folder(folder: Path) -> str:
    """The PYTHONPATH with another folder in it."""
    return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
