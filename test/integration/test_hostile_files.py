# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Spoilt files and killed writers: a short run of the commands that try many of each."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

TEST = Path(__file__).resolve().parents[1]


def run(name, *arguments):
    command = [sys.executable, "-m", f"campaigns.{name}", *arguments]
    paths = os.pathsep.join([str(TEST), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": paths}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_spoilt_files_of_every_format_are_used_or_refused_in_a_sentence():
    done = run("fuzz", "--inputs", "360", "--jobs", "2")
    assert done.returncode == 0, done.stdout + done.stderr


def test_killed_writers_leave_every_earlier_file_whole():
    done = run("kills", "--kills", "24")
    assert done.returncode == 0, done.stdout + done.stderr
