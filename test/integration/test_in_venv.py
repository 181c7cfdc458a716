# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""``scripts/in_venv``: what it installs, and when. A script in place of pip logs its calls."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
LOGGING_PYTHON = """#!/bin/sh
case "$*" in *--editable*) echo "$@" >>"$(dirname "$0")/pip.log"; true ;; esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout whose environment exists already."""
    folder = tmp_path / "a checkout"
    (folder / "scripts").mkdir(parents=True)
    shutil.copy(ROOT / "scripts/in_venv", folder / "scripts")
    shutil.copy(ROOT / "setup.py", folder)
    python = folder / ".venv/bin/python3"
    python.parent.mkdir(parents=True)
    python.write_text(LOGGING_PYTHON, encoding="utf-8")
    python.chmod(0o755)
    return folder


def in_venv(checkout: Path, extras: str, *command: str, cwd: Path) -> str:
    done = subprocess.run(
        [checkout / "scripts/in_venv", extras, *command],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=True,
        env=os.environ,
    )
    return done.stdout


def installed(checkout: Path) -> list[str]:
    """What pip or uv was asked to install, call by call."""
    log = checkout / ".venv/bin/pip.log"
    calls = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    return [call.rpartition("[")[2].rstrip("]").removeprefix("ros,") for call in calls]


def test_what_is_there_is_not_installed_again(checkout: Path, tmp_path: Path) -> None:
    for extras in ("plot,test", "plot,test", "test", "plot", "plot,doc", "doc,test"):
        in_venv(checkout, extras, "true", cwd=tmp_path)
    with (checkout / "setup.py").open("a", encoding="utf-8") as file:
        file.write("# one more dependency\n")
    for _ in range(2):
        in_venv(checkout, "plot", "true", cwd=tmp_path)
    assert installed(checkout) == ["plot,test", "plot,doc", "plot"]
