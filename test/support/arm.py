# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The arm that most tests plan for: its model, demonstrations and a primitive."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot

JOINTS = JOINT_NAMES
URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")
GRIPPER_URDF = URDF.replace(
    "</robot>",
    """
  <joint name="finger" type="prismatic">
    <parent link="wrist"/><child link="finger_link"/><origin xyz="0 0 -0.1"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" velocity="1" effort="10"/>
  </joint>
  <link name="finger_link">
    <inertial><mass value="0.2"/>
      <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.02"/></geometry></collision>
  </link>
</robot>""",
)


def mass_matrix(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Joint-space mass matrix of one configuration."""
    still = np.zeros((1, robot.n_joints))
    _, derivatives = robot.inverse_dynamics_derivatives(np.reshape(q, (1, -1)), still, still)
    return derivatives[0, :, 2 * robot.n_joints :]


def arm_robot() -> Robot:
    """The human-like arm."""
    return Robot.from_file(config_file("human_arm.urdf"), JOINTS)


@cache
def arm_demonstrations(n: int = 20, seed: int = 5) -> tuple[Demonstration, ...]:
    """Motions of it, without the detour through a bag."""
    motions = generate_motions(n, seed)
    return tuple(replace(motion, recording=f"motion_{i}") for i, motion in enumerate(motions))


@cache
def arm_primitive(coupling: str = "arm", n_components: int = 4) -> MovementPrimitive:
    """A primitive learned from them."""
    options = PrimitiveOptions(coupling=coupling, n_components=n_components)
    return build_primitive(arm_demonstrations(), f"arm_{coupling}_{n_components}", options)


def file_bytes(primitive: MovementPrimitive) -> bytes:
    """The content of its file."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "x.npz")
        save_primitive(primitive, path)
        return path.read_bytes()
