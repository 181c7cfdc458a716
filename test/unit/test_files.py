# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of users, read with bounds; files that are written whole or not at all."""

import errno
import os
import socket
from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import (
    check_writable,
    load_yaml,
    read_text,
    reading,
    write_whole,
)
from mp_pca_planner.input_limits import INPUT_LIMITS
from mp_pca_planner.motion.trajectory import Trajectory

# Reading


@pytest.mark.parametrize("what", ["pipe", "device", "folder", "large", "latin", "nowhere", "nul\0"])
def test_what_is_no_text_of_bounded_size_is_refused(tmp_path, what):
    path = Path("/dev/zero") if what == "device" else tmp_path / what
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    elif what in ("large", "latin"):
        path.write_bytes(b"\xe9" * (101 if what == "large" else 1))
    with (
        pytest.raises(PlannerError, match=r"^the file can't be read: .+$"),
        reading("the file", PlannerError),
    ):
        read_text(path, 100)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "aliases of YAML"),
        ("[" * 100_000, "nest"),
        ("{a: 1}: 2", "unhashable"),
        (" " * (INPUT_LIMITS.yaml_bytes + 1), "larger than 1,048,576 bytes"),
    ],
)
def test_hostile_yaml_is_refused(text, words):
    with pytest.raises(PlannerError, match=words), reading("it", PlannerError):
        load_yaml(text)


# Writing


def test_an_existing_file_is_kept_unless_overwriting_is_asked_for(tmp_path):
    path = tmp_path / "file"
    write_whole(path, b"first")
    with pytest.raises(PlannerError, match="exists already"):
        write_whole(path, b"second")
    assert path.read_bytes() == b"first"
    write_whole(path, b"second", overwrite=True)
    assert path.read_bytes() == b"second"
    assert os.listdir(tmp_path) == ["file"]


def test_a_file_that_could_not_be_written_is_refused_before_the_work(tmp_path):
    (tmp_path / "there").write_bytes(b"")
    check_writable(tmp_path / "new", overwrite=False)
    check_writable(tmp_path / "there", overwrite=True)
    with pytest.raises(PlannerError, match="exists already"):
        check_writable(tmp_path / "there", overwrite=False)
    with pytest.raises(PlannerError, match="no folder '.*nowhere'"):
        check_writable(tmp_path / "nowhere" / "file", overwrite=False)


@pytest.mark.parametrize("what", ["pipe", "socket", "link to a pipe"])
@pytest.mark.parametrize("name", ["motion", "motion.csv"])  # a bag, and a file
def test_a_device_or_a_pipe_is_never_replaced(tmp_path, monkeypatch, what, name):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    if what == "socket":
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(name)
    elif what == "pipe":
        os.mkfifo(name)
    else:
        os.mkfifo("pipe")
        os.symlink("pipe", name)
    before, states = os.lstat(name), np.zeros((2, 1))
    motion = Trajectory(["joint"], [0.0, 1.0], states, states, states)
    for write in (
        lambda: check_writable(Path(name), overwrite=True),
        lambda: write_whole(name, b"", overwrite=True),
        lambda: motion.save(name, overwrite=True),
    ):
        with pytest.raises(PlannerError, match="is a device or a pipe"):
            write()
    after = os.lstat(name)
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)


@pytest.mark.parametrize("name", ["null", "stdout", "stderr"])
def test_a_stream_of_the_machine_is_no_output_file(name):
    # Only the check: a defect must not destroy the device.
    with pytest.raises(PlannerError, match="is a device or a pipe"):
        check_writable(Path("/dev") / name, overwrite=True)


def test_a_new_file_gets_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    write_whole(tmp_path / "whole", b"")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_file_system_without_hard_links_serves_too(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refuse)
    write_whole(tmp_path / "file", b"first")
    with pytest.raises(PlannerError, match="exists already"):
        write_whole(tmp_path / "file", b"second")
    assert (tmp_path / "file").read_bytes() == b"first"
    assert os.listdir(tmp_path) == ["file"]
