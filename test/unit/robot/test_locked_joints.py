# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joints that do not move are where they are said to be, and matter where they should."""

import numpy as np
import pytest

from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.locked import relevant_joints
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Obstacle, Sphere, World

MASS = (
    '<inertial><mass value="{mass}"/><origin xyz="0.1 0 0"/><inertia ixx="0.01" iyy="0.01" '
    'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
SHAPE = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'


def link(name, mass=0.0, shape=False):
    content = (MASS.format(mass=mass) if mass else "") + (SHAPE if shape else "")
    return f'<link name="{name}">{content}</link>'


def joint(name, parent, child, xyz, kind="revolute", more="", lower=-2):
    axis = "0 0 1" if name == "lift" else "0 1 0"
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        f'<limit lower="{lower}" upper="2" effort="99" velocity="9"/>{more}</joint>'
    )


FOLLOWS = '<mimic joint="grip" multiplier="-2" offset="0.01"/>'
URDF = f"""<robot name="r">
{link("base")} {link("column", 5.0)} {link("upper", 2.0, True)} {link("fore", 1.0, True)}
{link("finger", 0.5, True)} {link("other", 0.5, True)} {link("tip", 0.1, True)} {link("dial")}
{link("wheel", 1.0, True)} {link("pan", 1.0)} {link("stop")}
{joint("lift", "base", "column", "0 0 0.5", "prismatic")}
{joint("shoulder", "column", "upper", "0.2 0 0")} {joint("elbow", "upper", "fore", "0.4 0 0")}
{joint("grip", "fore", "finger", "0.3 0 0", "prismatic")}
{joint("mimic", "fore", "other", "0.3 0 0", "prismatic", FOLLOWS)}
{joint("swivel", "finger", "tip", "0.1 0 0")} {joint("dial", "fore", "dial", "0 0 0")}
{joint("roll", "base", "wheel", "0 0.5 0.1", "continuous")} {joint("pan", "base", "pan", "0 -1 0")}
{joint("stop", "base", "stop", "0 0 0", "prismatic", lower=0.25)}
</robot>"""
ARM = ("elbow", "shoulder")
WHERE = {"lift": 0.3, "grip": 0.04, "swivel": 0.7, "roll": 1.0}


def test_locked_robot_is_the_whole_robot_with_the_other_joints_there():
    part, whole = Robot(URDF, ARM, locked=WHERE), Robot(URDF)
    names = whole.joint_names
    assert "mimic" not in names
    whole = Robot(URDF, (*(name for name in names if name != "dial"), "mimic"))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    every = np.zeros((5, len(whole.joint_names)))
    # One that is not mentioned stands as near to 0 as it can.
    for name, position in {**WHERE, "mimic": -2.0 * 0.04 + 0.01, "stop": 0.25}.items():
        every[:, whole.joint_names.index(name)] = position
    moved = [whole.joint_names.index(name) for name in ARM]
    every[:, moved] = q
    frames, origins = ["tip", "other", "stop"], np.zeros((3, 6))
    np.testing.assert_allclose(
        part.attached_poses(q, frames, origins), whole.attached_poses(every, frames, origins)
    )
    v, a = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 5, 2))
    rates = np.zeros((2, *every.shape))
    rates[0][:, moved], rates[1][:, moved] = v, a
    efforts = whole.inverse_dynamics(every, *rates)[:, moved]
    np.testing.assert_allclose(part.inverse_dynamics(q, v, a), efforts, atol=1e-9)
    world = World([Obstacle("ball", [Sphere(0.1, [0.5, 0.2, 0.9])])])
    found = [
        CollisionModel(robot, world=world).near(at, np.inf)
        for robot, at in ((part, q), (whole, every))
    ]
    assert found[0].distances.min() == pytest.approx(found[1].distances.min())


def test_joint_matters_if_it_places_a_mass_a_shape_or_the_arm():
    robot = Robot(URDF, ARM)
    carried = {"lift", "grip", "mimic", "swivel"}
    assert set(relevant_joints(robot, pairs=False)) == carried
    assert set(relevant_joints(robot, pairs=True)) == carried | {"roll"}
    needed = relevant_joints(robot, pairs=False, links=["dial", "pan"])
    assert set(needed) == carried | {"dial", "pan"}


def test_positions_that_were_given_are_known_with_those_that_follow_from_them():
    known = Robot(URDF, ARM, locked=WHERE).locked_positions
    assert known == {**WHERE, "mimic": pytest.approx(-0.07)}
    assert Robot(URDF, ARM, locked={"mimic": 0.2}).locked_positions == {"mimic": 0.2}
    assert Robot(URDF, ("grip", *ARM)).locked_positions == {}
