# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots to try the package with: a model of a person's arm, and arms of example-robot-data."""

from __future__ import annotations

from pathlib import Path

from ..exceptions import RobotError, require, unknown_name
from ..files import config_file

HUMAN_ARM = "human_arm"
_UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_UR_JOINTS = tuple(f"{name}_joint" for name in _UR)
_SO_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
# Files of the package example-robot-data, and the joints of the arms.
_FILES: dict[str, tuple[str, tuple[str, ...]]] = {
    "panda": (
        "panda_description/urdf/panda.urdf",
        tuple(f"panda_joint{i}" for i in range(1, 8)),
    ),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", _UR_JOINTS),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", _UR_JOINTS),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", _UR_JOINTS),
    "kinova": (
        "kinova_description/robots/kinova.urdf",
        tuple(f"j2s6s200_joint_{i}" for i in range(1, 7)),
    ),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", tuple(f"joint{i}" for i in range(1, 8))),
    "z1": ("z1_description/urdf/z1.urdf", tuple(f"joint{i}" for i in range(1, 7))),
    "so100": ("so_arm_description/urdf/so100.urdf", _SO_JOINTS),
    "so101": ("so_arm_description/urdf/so101.urdf", _SO_JOINTS),
}
EXAMPLE_ROBOTS = (HUMAN_ARM, *_FILES)
"""Their names; all but the first need the extra 'example'."""


def example_file(name: str) -> tuple[Path, tuple[str, ...]]:
    """URDF file of an example, and the joints of its arm.

    Raises
    ------
    RobotError
        If there is no example of that name.
    MissingDependencyError
        If example-robot-data is not installed.
    """
    if name == HUMAN_ARM:
        return config_file("human_arm.urdf"), ("shoulder1", "shoulder2", "shoulder3", "elbow")
    if name not in _FILES:
        raise RobotError(unknown_name("example", name, EXAMPLE_ROBOTS))
    file, joints = _FILES[name]
    loader = require("example_robot_data.robots_loader", "example", f"the robot '{name}'")
    return Path(loader.getModelPath(file)) / file, joints
