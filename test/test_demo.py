# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The README's first command, as a stranger runs it."""

import os
import subprocess
import sys

import pytest

from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.recordings.load import load_recordings


def test_the_demo_goes_the_whole_way_and_leaves_pictures(tmp_path):
    pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(1 + (os.getpid() + 50) % 101)}
    done = subprocess.run(
        [sys.executable, "-m", "mp_pca_planner", "demo", "--output", str(tmp_path / "out")],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert sum(line.endswith("  executable") for line in lines) == 12
    folder = tmp_path / "out"
    for name in ("primitive.png", "motion.png", "arm.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    recordings = load_recordings([folder / "recording"])
    primitive = load_primitive(folder / "arm_raising.npz")
    assert len(primitive.durations) == len(recordings.demonstrations) >= 50


def test_without_ros_the_demo_names_the_extra(tmp_path):
    script = (
        "import sys\n"
        "from importlib import util\n"
        "find = util.find_spec\n"
        "util.find_spec = lambda name, *rest: None if name == 'rclpy' else find(name, *rest)\n"
        "from mp_pca_planner.cli.main import main\n"
        f"sys.exit(main(['demo', '--output', {str(tmp_path / 'out')!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "mp_pca_planner[ros]" in done.stderr
    assert list(tmp_path.iterdir()) == []
