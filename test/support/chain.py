# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Three links in a plane, which can hit each other."""

import numpy as np
from support.dense import minimum_jerk_motion
from support.patience import EVER

from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot.model import Robot

NAMES = ("one", "two", "three")
RADIUS, LENGTH = 0.04, 0.4


def link(name: str, geometry: str = f'<sphere radius="{RADIUS}"/>') -> str:
    return f"""
  <link name="{name}">
    <inertial><origin xyz="{LENGTH / 2} 0 0"/><mass value="1"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <collision><origin xyz="{LENGTH} 0 0"/><geometry>{geometry}</geometry></collision>
  </link>"""


def joint(name: str, parent: str, child: str, x: float) -> str:
    return f"""
  <joint name="{name}" type="revolute">
    <origin xyz="{x} 0 0"/><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" velocity="20" effort="1000"/>
  </joint>"""


# Three links in a plane, with a sphere at the end of each and one at the base.
CHAIN = (
    '<robot name="chain"><link name="base"><collision><geometry><box size="0.1 0.1 0.1"/>'
    "</geometry></collision></link>"
    + link("a")
    + link("b", '<cylinder radius="0.04" length="0.05"/>')
    + link("c")
    + joint("one", "base", "a", 0.0)
    + joint("two", "a", "b", LENGTH)
    + joint("three", "b", "c", LENGTH)
    + "</robot>"
)


def chain(**changes: str) -> Robot:
    text = CHAIN
    for old, new in changes.items():
        text = text.replace(old, new)
    return Robot(text, NAMES)


def motion(start: np.ndarray, goal: np.ndarray, duration: float = 1.0) -> Trajectory:
    return minimum_jerk_motion(NAMES, start, goal, duration, 21)


ACROSS_BASE = JointState(NAMES, [0.0, 1.5, 2.09]), JointState(NAMES, [0.0, 2.7, 2.09])


def chain_planner(model: CollisionModel | None, **options: float) -> Planner:
    robot = chain()
    options = PlannerOptions(**{"max_solve_time": EVER, **options})
    return Planner(robot, [fold()], robot.limits(), options, model)


def fold() -> MovementPrimitive:
    """A primitive whose only component bends hardly anything."""
    demonstrations = [
        Demonstration(
            NAMES, m.times, m.positions, m.velocities, m.accelerations,
            recording=f"{k}", start_time=0.0, end_time=1.0,
        )
        for k in range(6)
        for m in [motion([0.0, 0.5, 0.1 * k], [0.1 * k, 0.9, 1.0 + 0.06 * k**2])]
    ]  # fmt: skip
    return build_primitive(demonstrations, "fold", PrimitiveOptions(n_components=1))
