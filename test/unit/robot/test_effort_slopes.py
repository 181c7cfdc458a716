# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Tests of mp_pca_planner.robot.joints."""

from pathlib import Path

import numpy as np
import pytest
from support.arm import arm_robot

from mp_pca_planner.robot.model import Robot

PRISMATIC = """<robot name="lift"><link name="base"/>
<link name="column"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
<inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.1" izz="0.1" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
<link name="slide"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hand"><inertial><origin xyz="0 0.1 0.1"/><mass value="0.5"/>
<inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="up" type="prismatic"><parent link="base"/><child link="column"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
<joint name="turn" type="revolute"><parent link="column"/><child link="arm"/>
<origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
<joint name="out" type="prismatic"><parent link="arm"/><child link="slide"/>
<origin xyz="0.5 0 0" rpy="0.3 0 0"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
<joint name="tip" type="revolute"><parent link="slide"/><child link="hand"/>
<origin xyz="0.1 0 0" rpy="0 0.4 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="100"/></joint></robot>"""


DRIVE = {"armature": 0.3, "damping": 2.0, "friction": 0.5}
ROBOTS = {
    "arm": arm_robot,
    "prismatic joints": lambda: Robot(PRISMATIC),
    "drives": lambda: Robot(PRISMATIC).with_drives({"turn": DRIVE, "out": DRIVE}),
}


@pytest.mark.parametrize("name", [*ROBOTS, "panda_description/urdf/panda.urdf"])
def test_no_effort_changes_faster_than_its_bound(name):
    if name in ROBOTS:
        robot = ROBOTS[name]()
    else:
        loader = pytest.importorskip("example_robot_data.robots_loader")
        robot = Robot.from_file(Path(loader.getModelPath(name)) / name)
    random, step = np.random.default_rng(1), 1e-5
    for size in (0.1, 1.0, 10.0):
        state = random.normal(size=(4, 500, robot.n_joints)) * [[[2.0]], *3 * [[[size]]]]
        later = [
            sum(state[d + k] * step**k / f for k, f in enumerate((1, 1, 2, 6)[: 4 - d]))
            for d in range(3)
        ]
        change = robot.inverse_dynamics(*later) - robot.inverse_dynamics(*state[:3])
        slopes = np.abs(change) / step
        assert np.all(slopes <= robot.effort_slopes(*np.abs(state)) * (1.0 + 1e-3) + 1e-3)


def test_the_bound_of_a_pendulum_is_met():
    """τ = (m l² + I) q̈ + m g l sin q: bounds with I = 0 are exact at the lowest point."""
    link = """<link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
    <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    joint = """<joint name="swing" type="revolute"><parent link="base"/><child link="rod"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="1" effort="9"/></joint>"""
    robot = Robot(f'<robot name="pendulum"><link name="base"/>{link}{joint}</robot>')
    zero, one = np.zeros((1, 1)), np.ones((1, 1))
    np.testing.assert_allclose(robot.effort_slopes(zero, zero, zero, one), 0.5, rtol=1e-3)
    of_gravity = robot.effort_slopes(zero, 1e-3 * one, zero, zero)
    np.testing.assert_allclose(of_gravity, 1e-3 * 2.0 * 9.81 * 0.5, rtol=1e-3)
