# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles in frames outside of the robot are placed, or named."""

import numpy as np
import pytest

from mp_pca_planner.execution.serving.surroundings import foreign_poses, is_same, placed
from mp_pca_planner.robot.world import Box, Obstacle, Sphere

TURNED = np.array([1.0, 0.0, 0.5, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])  # 90° about z
OBSTACLES = (
    Obstacle("at base", Sphere(0.1)),
    Obstacle("on hand", Sphere(0.1), "hand"),
    Obstacle("in map", [Sphere(0.1, [2.0, 0.0, 0.0]), Box([0.1] * 3, [0.0, 1.0, 0.0])], "map"),
    Obstacle("in camera", Sphere(0.1), "camera"),
)


def test_obstacle_is_placed_where_its_frame_is_and_another_one_named():
    poses = foreign_poses(OBSTACLES, ("base", "hand"), {"map": TURNED}.get)
    assert poses.keys() == {"camera", "map"}
    found, unplaced = placed(OBSTACLES, poses)
    assert [one.name for one in found] == ["at base", "on hand", "in map"]
    assert [one.frame for one in found] == ["", "hand", ""]
    ball, box = found[2].shapes
    np.testing.assert_allclose(ball.position, [1.0, 2.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(box.position, [0.0, 0.0, 0.5], atol=1e-12)
    (reason,) = unplaced
    assert "'in camera' is stated in the frame 'camera'" in reason
    assert "fixed_frames" in reason


def test_frames_outside_of_the_robot_are_looked_up_once_each():
    asked = []
    again = [*OBSTACLES, Obstacle("also in map", Sphere(0.1), "map")]
    foreign_poses(again, ("hand",), lambda frame: asked.append(frame))
    assert sorted(asked) == ["camera", "map"]


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ({"map": TURNED + 5e-5}, True),
        ({"map": TURNED + 2e-4}, False),
        ({"map": None}, False),
        ({}, False),
        ({"camera": TURNED}, False),
    ],
)
def test_pose_that_changes_by_more_than_noise_is_another_one(other, expected):
    assert is_same({"map": TURNED}, other) is expected
    assert is_same(other, {"map": TURNED}) is expected
    assert is_same({"map": None}, {"map": None})
