# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The offline commands, run in this process."""

import contextlib
import io
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


def run(*arguments, ok=None):
    """Run a command as the program does; check its status if told to."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as leaving:
            status = leaving.code
    if ok is not None:
        assert (status == 0) == ok, err.getvalue()
    return Done(status, out.getvalue(), err.getvalue())


def refusal(*arguments):
    """The one line with which a command refuses its input."""
    done = run(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    return line
