# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles and robots as VAMP knows them."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.arm import JOINTS, arm_robot

from mp_pca_planner.evaluation.peers import vamp_method, vamp_robot, vamp_shapes
from mp_pca_planner.exceptions import MissingDependencyError, PlannerError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, World

AT = (0.3, -0.2, 0.5)
QUARTER_TURN = Rotation.from_euler("y", 90.0, degrees=True).as_quat()
TURNS = [*Rotation.random(4, random_state=0).as_quat(), QUARTER_TURN]
CONVERTED = {
    "sphere": lambda turn: Sphere(0.2, AT, turn),
    "box": lambda turn: Box((0.1, 0.4, 0.3), AT, turn),
    "capsule": lambda turn: Capsule(0.1, 0.4, AT, turn),
    "cylinder": lambda turn: Cylinder(0.1, 0.4, AT, turn),
}


def converted(shape, *, boxes=False):
    (found,) = vamp_shapes(World([Obstacle("one", shape)]), boxes=boxes)
    return found


# The conversion


@pytest.mark.parametrize("turn", TURNS)
def test_angles_are_of_turns_about_fixed_x_y_and_z(turn):
    _, (position, angles, _) = converted(Box((0.1, 0.4, 0.3), AT, turn))
    (sa, sb, sc), (ca, cb, cc) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    expected = Rotation.from_quat(turn).as_matrix()
    np.testing.assert_allclose(about_z @ about_y @ about_x, expected, atol=1e-7)
    assert position == list(AT)


def test_boxes_have_half_edges_and_cylinders_are_capsules_or_boxes():
    upright = {name: make((0, 0, 0, 1)) for name, make in CONVERTED.items()}
    pose = list(AT), [0.0, 0.0, 0.0]
    assert converted(upright["sphere"]) == ("Sphere", (list(AT), 0.2))
    assert converted(upright["box"]) == ("Cuboid", (*pose, [0.05, 0.2, 0.15]))
    assert converted(upright["cylinder"]) == ("Cylinder", (*pose, 0.1, 0.4))
    assert converted(upright["cylinder"], boxes=True) == ("Cuboid", (*pose, [0.1, 0.1, 0.2]))
    assert converted(upright["capsule"], boxes=True) == ("Cylinder", (*pose, 0.1, 0.4))


@pytest.mark.parametrize(
    ("obstacle", "reason"),
    [
        (Obstacle("plate", Mesh(np.eye(3), [[0, 1, 2]])), "VAMP has no meshes, as of .* 'plate'"),
        (
            Obstacle("tool", Sphere(0.1), frame="wrist"),
            "VAMP gets no obstacles on links, as 'tool'",
        ),
    ],
)
def test_other_obstacles_are_refused_by_name(obstacle, reason):
    with pytest.raises(PlannerError, match=reason):
        vamp_shapes(World([obstacle]), boxes=False)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", CONVERTED)
def test_vamp_finds_the_collisions_of_closed_forms(name, turn):
    pytest.importorskip("vamp.constants", reason="the extra 'vamp' is not installed")
    vamp = sys.modules["vamp"]
    shape, rng = CONVERTED[name](turn), np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (2000, 3))
    excess = np.maximum(np.abs(points) - (0.05, 0.2, 0.15), 0.0)
    beyond = points - np.array([0, 0, 1]) * np.clip(points[:, 2:], -0.2, 0.2)
    distances = {
        "sphere": np.linalg.norm(points, axis=1) - 0.2,
        "box": np.linalg.norm(excess, axis=1),
    }.get(name, np.linalg.norm(beyond, axis=1) - 0.1)
    kind, sizes = converted(shape)
    environment = vamp.Environment()
    add = {"Sphere": "add_sphere", "Cuboid": "add_cuboid", "Cylinder": "add_capsule"}[kind]
    getattr(environment, add)(getattr(vamp, kind)(*sizes))
    vamp.sphere.set_radius(0.05)
    placed = Rotation.from_quat(turn).apply(points) + AT
    hits = np.array([not vamp.sphere.validate(point.tolist(), environment) for point in placed])
    clear = np.abs(distances - 0.05) > 1e-4
    np.testing.assert_array_equal(hits[clear], (distances < 0.05)[clear])
    assert 0 < hits.sum() < len(hits)


# The robots


def with_model(joints, offset=(0.0, 0.0, 0.0)):
    """A library with one robot: the human-like arm, with its hand displaced."""
    robot = arm_robot()

    def hand_pose(q):
        pose = np.eye(4)
        pose[:3, 3] = robot.frame_positions(np.array([q]), ["wrist"])[0, 0] + offset
        return pose

    model = SimpleNamespace(
        joint_names=lambda: joints, end_effector=lambda: "wrist", eefk=hand_pose
    )
    return SimpleNamespace(robots=["arm"], arm=model)


def test_robots_are_known_by_their_joints_and_the_place_of_the_hand():
    robot = arm_robot()
    assert vamp_robot(with_model(JOINTS), robot) == "arm"
    with pytest.raises(PlannerError, match=f"{JOINTS[-1]} in this order; it has arm: {JOINTS[-1]}"):
        vamp_robot(with_model(JOINTS[::-1]), robot)
    with pytest.raises(PlannerError, match="'arm' has 'wrist' 0.1 m from here"):
        vamp_robot(with_model(JOINTS, (0.0, 0.1, 0.0)), robot)


def test_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "vamp.constants", None)
    robot = arm_robot()
    scene = SimpleNamespace(robot=robot, collision=CollisionModel(robot))
    with pytest.raises(MissingDependencyError, match=r"'vamp_toppra' needs .* 'vamp'.*\[vamp\]"):
        vamp_method(scene, 1.0)
