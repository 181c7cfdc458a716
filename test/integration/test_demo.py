# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The README's first command, as a stranger runs it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.domains import lease_domain
from support.patience import HANG

import mp_pca_planner as mp
from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.robot.examples import EXAMPLE_ROBOTS, HUMAN_ARM
from mp_pca_planner.robot.world import World


@pytest.mark.slow
def test_the_demo_goes_the_whole_way_and_leaves_pictures(tmp_path):
    pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(lease_domain("demo"))}
    done = subprocess.run(
        [sys.executable, "-m", "mp_pca_planner", "demo", "--output", str(tmp_path / "out")],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert sum(line.endswith("; arrived") for line in lines) == 12
    folder = tmp_path / "out"
    # The arm was commanded to all of the goals: it raised itself six times.
    elbow = np.load(folder / "commands.npz")["q"][:, 3]
    level = 0.5 * (elbow.min() + elbow.max())
    assert np.count_nonzero(np.diff(np.sign(elbow - level))) == 12
    for name in ("primitive.png", "motion.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    recordings = load_recordings([folder / "recording"])
    primitive = load_primitive(folder / "arm_raising.npz")
    assert len(primitive.durations) == len(recordings.demonstrations) >= 50


def children(pid: int) -> dict[int, str]:
    """Command lines of the running children of a process."""
    found = {}
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            if f"\nPPid:\t{pid}\n" in status.read_text():
                found[int(status.parent.name)] = (status.parent / "cmdline").read_text()
        except OSError:  # it has just ended
            continue
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "number", "status"),
    [
        ((), signal.SIGTERM, 1),
        ((), signal.SIGHUP, 1),
        (("human_arm", "--node"), signal.SIGINT, 0),  # its usual end
    ],
)
def test_interrupted_demo_ends_its_child_processes(tmp_path, words, number, status):
    pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(lease_domain("demo"))}
    command = [sys.executable, "-m", "mp_pca_planner", "demo", *words, "--output", str(tmp_path)]

    def unprotect() -> None:
        signal.signal(number, signal.SIG_DFL)  # the tests may run under nohup

    options = {"env": environment, "stdout": subprocess.DEVNULL, "preexec_fn": unprotect}
    with subprocess.Popen(command, **options) as demo:
        started: dict[int, str] = {}
        while not any("simulate" in words for words in started.values()):
            assert demo.poll() is None
            started |= children(demo.pid)
            time.sleep(0.01)
        demo.send_signal(number)
        assert demo.wait(60.0) == status
    assert len(started) == 2
    assert not any(Path(f"/proc/{pid}").exists() for pid in started)


@pytest.mark.parametrize("option", ["--node", "--files"])
def test_what_is_for_one_robot_needs_its_name(option, tmp_path, capsys):
    assert main(["demo", option, "--output", str(tmp_path / "made")]) == 2
    assert "for one ROBOT of 'human_arm', 'panda'" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("name", EXAMPLE_ROBOTS)
def test_files_of_every_example_give_motions_of_its_arm_and_are_kept(tmp_path, name, capsys):
    if name != HUMAN_ARM:
        pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")
    words = ["demo", name, "--files", "--output", str(tmp_path)]
    assert main(words) == 0
    found = mp.load_demonstrations(tmp_path / "session.mcap", robot=tmp_path / "arm.urdf")
    assert found[0].joint_names == mp.Robot.example(name).joint_names
    assert len(found) >= 79
    if (tmp_path / "scene.yaml").exists():
        assert len(World.from_file(tmp_path / "scene.yaml").names) == 1
        mp.Robot.from_file(tmp_path / "arm.urdf").limits(tmp_path / "limits.yaml")
    assert (name in (HUMAN_ARM, "panda")) == (tmp_path / "scene.yaml").exists()
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
