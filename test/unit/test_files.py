# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of users, read with bounds; files that are written whole or not at all."""

import errno
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import (
    check_writable,
    load_json,
    load_yaml,
    read_bytes,
    read_text,
    reading,
    replace_path,
    workspace_beside,
    write_together,
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


def test_a_file_may_be_as_large_as_the_limit(tmp_path):
    (tmp_path / "file").write_bytes(b"x" * 100)
    assert read_bytes(tmp_path / "file", 100) == b"x" * 100


BOMB = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "aliases of YAML"),
        ("[" * 100_000, "levels deep"),
        ("? " * 1000, "levels deep"),
        ("a: " + "9" * 5000, "4300 digits"),
        ("a: " + ":".join(["1"] * 40_000), "65,536 bytes"),
        ("a: !!int x", "invalid literal"),
        ("a: !!bool x", "KeyError 'x'"),
        ("a: !!timestamp 2001-02-30", "out of range"),
        ("a: \0", "character"),
        ('a: "\\ud800"', "Unicode|UTF-8"),
        ("{a: 1}: 2", "unhashable"),
        (" " * (INPUT_LIMITS.yaml_bytes + 1), "larger than 1,048,576 bytes"),
    ],
)
def test_hostile_yaml_is_refused(text, words):
    with pytest.raises(PlannerError, match=words), reading("it", PlannerError):
        load_yaml(text)


@pytest.mark.parametrize("depth", [INPUT_LIMITS.json_depth + 1, 300, 900])
def test_json_that_is_nested_too_deep_is_refused(depth):
    """What is accepted can be copied, compared and written by recursion."""
    with pytest.raises(ValueError, match="nested more than 50 levels deep"):
        load_json("[" * depth + "]" * depth)
    allowed = INPUT_LIMITS.json_depth
    assert load_json('{"a": ' * allowed + "1" + "}" * allowed)
    assert load_json("1") == 1


def test_dates_of_yaml_are_text_and_numbers_are_numbers():
    assert load_yaml("{a: 2001-02-30, b: 2001-02-03, c: 1.5, d: .inf}") == {
        "a": "2001-02-30",
        "b": "2001-02-03",
        "c": 1.5,
        "d": float("inf"),
    }


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


def test_files_that_are_written_together_change_together_or_not_at_all(tmp_path):
    one, two, gone = (tmp_path / name for name in ("one", "two", "gone"))
    write_whole(one, b"old")
    write_whole(gone, b"old")
    contents = {one: b"new", gone: None, two: b"x" * 5000}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(PlannerError, match="two' can't be written: File too large"):
            write_together(contents, overwrite=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert one.read_bytes() == gone.read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["gone", "one"]
    write_together(contents, overwrite=True)
    assert sorted(os.listdir(tmp_path)) == ["one", "two"]
    assert one.read_bytes() == b"new"


def test_file_system_without_hard_links_serves_too(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refuse)
    write_whole(tmp_path / "file", b"first")
    with pytest.raises(PlannerError, match="exists already"):
        write_whole(tmp_path / "file", b"second")
    assert (tmp_path / "file").read_bytes() == b"first"
    assert os.listdir(tmp_path) == ["file"]


def test_what_a_killed_writer_left_is_removed_by_the_next_one(tmp_path):
    script = (
        "import sys; from pathlib import Path; from mp_pca_planner.files import workspace_beside\n"
        "with workspace_beside(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'part').write_bytes(b'x')\n"
        "    print('ready', flush=True)\n"
        "    sys.stdin.read()"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "file")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as killed, subprocess.Popen(command, **pipes) as alive:
        killed.stdout.readline()
        alive.stdout.readline()
        (tmp_path / ".file.of.others.tmp").write_bytes(b"")
        killed.kill()
        killed.wait()
        write_whole(tmp_path / "other", b"")
        left = sorted(os.listdir(tmp_path))
        assert len(left) == 3 and left[0] == ".file.of.others.tmp" and left[2] == "other"
        alive.stdin.close()
        assert alive.wait() == 0
    assert sorted(os.listdir(tmp_path)) == [".file.of.others.tmp", "other"]


def test_a_folder_is_replaced_without_a_moment_in_which_it_is_missing(tmp_path):
    target, missing, done = tmp_path / "bag", [], threading.Event()

    def watch():
        while not done.is_set():
            if not target.exists():
                missing.append(True)

    target.mkdir()
    watcher = threading.Thread(target=watch)
    watcher.start()
    for i in range(300):
        with workspace_beside(target) as folder:
            (folder / "bag").mkdir()
            (folder / "bag" / str(i)).write_bytes(b"")
            replace_path(folder / "bag", target)
        assert os.listdir(target) == [str(i)]
    done.set()
    watcher.join()
    assert not missing
    assert os.listdir(tmp_path) == ["bag"]
