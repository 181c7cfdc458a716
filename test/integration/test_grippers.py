# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Arms with grippers: joints of the robot that never move in the recordings are left out."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support import commands

import mp_pca_planner as mp
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

FINGER = """
  <joint name="finger" type="prismatic">
    <parent link="wrist"/><child link="finger_link"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" velocity="0.1" effort="10"/>
  </joint>
  <link name="finger_link">
    <inertial>
      <mass value="0.05"/>
      <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
</robot>"""
STILL = "joints left out, as they never move: 'finger'"

build = partial(commands.result, "build_primitives")


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = mp.config_file("human_arm.urdf").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("robot") / "gripper.urdf"
    path.write_text(text.replace("</robot>", FINGER), encoding="utf-8")
    return path


def record(path: Path, finger: str, seed: int = 1, n_motions: int = 6) -> Path:
    """Write a recording of the arm whose finger is 'absent', 'still' or 'moving'."""
    recording = continuous_recording(generate_motions(n_motions, seed), seed=seed)
    names, positions = list(JOINT_NAMES), recording.positions
    if finger != "absent":
        rng = np.random.default_rng(seed)
        opening = 0.02 + 1e-5 * rng.standard_normal(len(positions))
        if finger == "moving":
            opening = opening + 0.01 * np.tanh(positions[:, 0])
        names, positions = ["finger", *names], np.column_stack([opening, positions])
    write_joint_states(path, "mcap", names, recording.stamps, positions)
    return path


def test_a_finger_that_does_not_move_is_left_out_and_listed(urdf: Path, tmp_path: Path) -> None:
    bags = [record(tmp_path / f"{x}.mcap", x, seed) for seed, x in enumerate(["still", "absent"])]
    facts = build(*bags, "--robot", urdf, "--output", tmp_path / "reach.npz")
    assert facts["joint_names"] == list(JOINT_NAMES)
    assert STILL in facts["notes"]["still"]
    absent = "joints left out, as the recording lacks them: 'finger'"
    assert absent in facts["notes"]["absent"]


def test_a_chosen_finger_stays(urdf: Path, tmp_path: Path) -> None:
    bag, names = record(tmp_path / "bag.mcap", "still"), ["finger", *JOINT_NAMES]
    options = ("--robot", urdf, "--joints", ",".join(names), "--output", tmp_path / "reach.npz")
    assert build(bag, *options)["joint_names"] == names
    assert mp.load_demonstrations(bag, robot=urdf, joints=names)[0].joint_names == tuple(names)
    robot = mp.Robot.from_file(urdf)
    assert mp.load_demonstrations(bag, robot=robot)[0].joint_names == robot.joint_names
