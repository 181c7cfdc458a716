# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `teach` with a recording that is played back, without ROS."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.patience import HANG

from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file
from mp_pca_planner.recordings.synthetic import write_example_recording

URDF = str(config_file("human_arm.urdf"))


def teach(folder: Path, keys: str, *options: str) -> subprocess.CompletedProcess[str]:
    bag = folder / "example.mcap"
    if not bag.exists():
        write_example_recording(bag, 4)
    words = [sys.executable, "-m", "mp_pca_planner", "teach", "--play", str(bag)]
    words += ["--output", str(folder / "taught.npz"), *options]
    return subprocess.run(
        words, input=keys, capture_output=True, text=True, timeout=HANG, check=False
    )


def test_the_primitive_is_that_of_the_recording_with_the_same_cuts(tmp_path: Path) -> None:
    done = teach(tmp_path, "d\nb\n", "--robot", URDF)
    assert (done.returncode, done.stderr) == (0, "")
    assert "motion 7: " in done.stdout and "motion 7 is discarded: 6 left" in done.stdout
    assert "left-out error" in done.stdout and "wrist at" in done.stdout
    errors = re.findall(r"left-out error (.*)", done.stdout)
    assert errors and all(
        re.match(r"[\d.]+ deg \(straight motions: [\d.]+ deg\)", x) for x in errors
    )
    ranges = re.findall(r"goals shown(.*)", done.stdout)
    assert ranges and all("[rad]" in x for x in ranges)
    again = tmp_path / "again.npz"
    bag, table = tmp_path / "taught.mcap", tmp_path / "taught_segments.csv"
    command = ["build_primitives", str(bag), "--segments", str(table), "--output", str(again)]
    assert main([*command, "--robot", URDF, "--name", "taught"]) == 0
    assert again.read_bytes() == (tmp_path / "taught.npz").read_bytes()


@pytest.mark.slow
def test_a_session_that_is_quit_is_continued(tmp_path: Path) -> None:
    done = teach(tmp_path, "q\n")
    assert done.returncode == 0
    assert "taught.mcap holds the recording" in done.stdout
    assert not (tmp_path / "taught.npz").exists()
    done = teach(tmp_path, "b\n")
    assert (done.returncode, done.stderr) == (0, "")
    # What is in the session already is not recorded again.
    assert "of 7 demonstrations" in done.stdout
    # The primitive is not overwritten without a word.
    done = teach(tmp_path, "b\n")
    assert (done.returncode, done.stdout) == (2, "")
    assert "taught.npz' exists already" in done.stderr


def test_a_wrong_topic_is_refused_in_a_sentence(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = str(write_example_recording(tmp_path / "example.mcap", 2))
    with open(os.devnull, encoding="utf-8") as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        words = ["--play", bag, "--output", str(tmp_path / "taught.npz"), "--topic", "/other"]
        status = main(["teach", *words])
    error = capsys.readouterr().err
    assert (status, error.count("\n")) == (2, 1)
    assert "there are no joint states on '/other'" in error
    assert not (tmp_path / "taught.mcap").exists()
