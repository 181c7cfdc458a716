# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

import os
import signal
import subprocess
import sys
import time

import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import check_writable, write_whole


def test_an_existing_file_is_kept_unless_overwriting_is_asked_for(tmp_path):
    path = tmp_path / "file"
    write_whole(path, b"first")
    with pytest.raises(PlannerError, match="exists already"):
        write_whole(path, b"second")
    assert path.read_bytes() == b"first"
    write_whole(path, b"second", overwrite=True)
    assert path.read_bytes() == b"second"
    assert os.listdir(tmp_path) == ["file"]


def test_a_folder_that_is_missing_is_named(tmp_path):
    with pytest.raises(PlannerError, match="nowhere.*No such file"):
        write_whole(tmp_path / "nowhere" / "file", b"")


def test_a_file_that_could_not_be_written_is_refused_before_the_work(tmp_path):
    (tmp_path / "there").write_bytes(b"")
    check_writable(tmp_path / "new", overwrite=False)
    check_writable(tmp_path / "there", overwrite=True)
    with pytest.raises(PlannerError, match="exists already"):
        check_writable(tmp_path / "there", overwrite=False)
    with pytest.raises(PlannerError, match="no folder '.*nowhere'"):
        check_writable(tmp_path / "nowhere" / "file", overwrite=False)


def test_a_new_file_gets_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    write_whole(tmp_path / "whole", b"")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_killing_the_writer_leaves_the_old_file_or_the_new_one(tmp_path):
    path = tmp_path / "file"
    old, new = b"o" * 1_000_000, b"n" * 1_000_000
    script = (
        "import sys; from mp_pca_planner.files import write_whole\n"
        "print('ready', flush=True)\n"
        "while True:\n"
        "    for c in (b'n', b'o'): write_whole(sys.argv[1], c * 1_000_000, overwrite=True)"
    )
    write_whole(path, old)
    for i in range(10):
        with subprocess.Popen(
            [sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE
        ) as process:
            process.stdout.readline()
            time.sleep(0.002 * i)
            process.send_signal(signal.SIGKILL)
        assert path.read_bytes() in (old, new)
