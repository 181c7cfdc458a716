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


def test_fuzz_notices_what_it_looks_for(tmp_path):
    script = (
        f"import sys; sys.path.insert(0, {str(TEST)!r}); from campaigns import fuzz\n"
        "from pathlib import Path\n"
        "def bad(arguments):\n"
        "    Path(arguments[0]).write_text('x'); print('\\x1b[31m'); raise ValueError('oh')\n"
        "def endless(arguments):\n"
        "    while True: bytearray(600 << 20)\n"
        "for fuzz.command in (bad, endless):\n"
        f"    for problem in fuzz.judged([{str(tmp_path / 'elsewhere')!r}], ()):\n"
        "        print(ascii(problem))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    for word in ("raised", "wrote open", "printed", "ended by signal SIGXCPU", "took"):
        assert word in done.stdout


def test_killed_writers_leave_every_earlier_file_whole():
    done = run("kills", "--kills", "24")
    assert done.returncode == 0, done.stdout + done.stderr
