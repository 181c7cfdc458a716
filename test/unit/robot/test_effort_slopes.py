# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bounds of the rates of change of efforts, against differences and a closed form."""

import numpy as np
import pytest
from support.arm import arm_robot
from support.chain import CHAIN, NAMES

import mp_pca_planner as mp
from mp_pca_planner.robot.model import Robot

DRIVE = {"armature": 0.3, "damping": 2.0, "friction": 0.5}
# Two joints that slide, along z and along a tilted x, and two that turn.
SLIDING = (
    CHAIN.replace('"two" type="revolute"', '"two" type="prismatic"')
    .replace('"three" type="revolute"', '"three" type="prismatic"')
    .replace('<origin xyz="0.4 0 0"/>', '<origin xyz="0.4 0 0" rpy="0.3 1 0"/>')
)
ROBOTS = {
    "arm": arm_robot,
    "drives": lambda: Robot(SLIDING, NAMES).with_drives({"one": DRIVE, "three": DRIVE}),
    "panda": lambda: mp.Robot.example("panda"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_no_effort_changes_faster_than_its_bound(name):
    if name == "panda":
        pytest.importorskip("example_robot_data.robots_loader")
    robot, random, step = ROBOTS[name](), np.random.default_rng(1), 1e-5
    # Each derivative may be large while the others are small.
    exponents = random.uniform(-2.0, [[[1.0]], [[2.0]], [[1.0]]], (3, 1500, 1))
    sizes = np.vstack([np.full((1, 1500, 1), 2.0), 10.0**exponents])
    state = random.normal(size=(4, 1500, robot.n_joints)) * sizes
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
