# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

import mp_pca_planner as mp
from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.input_limits import INPUT_LIMITS
from mp_pca_planner.robot.world import ANY

TURNED = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mp.Box((1.0, 0.0, 1.0)), "size of a box must be above 0"),
        (lambda: mp.Cylinder(1.0, 2e3), "height of a cylinder must be above 0 and at most 1000 m"),
        (lambda: mp.Sphere(1.0, (2e3, 0, 0)), "position of a sphere must be at most 1000 m"),
        (lambda: mp.Mesh(np.eye(3), [[0, 1, 3]]), "indices of its 3 vertices, from 0 to 2"),
        (lambda: mp.Mesh(np.ones((3, 3)), [[0, 1, 2]]), "but all its vertices are at one point"),
        (lambda: mp.Obstacle("", mp.Sphere(1.0)), "an obstacle must have a name"),
        (lambda: mp.World([mp.Obstacle("a", mp.Sphere(1.0))] * 2), "'a' given more than once"),
        (
            lambda: mp.World([mp.Obstacle("a", [mp.Sphere(1.0)] * (INPUT_LIMITS.shapes + 1))]),
            "shapes of a world must be .* to 1000, got 1001",
        ),
        (lambda: mp.World().without(["c"]), "no obstacle is called 'c'"),
    ],
)
def test_bad_values_are_rejected(make, message):
    with pytest.raises(WorldError, match=message):
        make()


def test_moved_shape_is_where_both_poses_lead():
    # A quarter turn about z takes x to y.
    moved = mp.Box((1, 2, 3), (1, 0, 0), TURNED).moved(np.array([0, 0, 5, *TURNED]))
    np.testing.assert_allclose(moved.position, [0, 1, 5], atol=1e-12)
    np.testing.assert_allclose(np.abs(moved.orientation), [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(moved.size, [1, 2, 3])


def test_obstacles_and_allowed_contacts_go_by_name():
    one, two = (mp.Obstacle(name, mp.Sphere(1.0)) for name in "ab")
    world = mp.World([one], [("link", "a"), ("floor", ANY)]).with_obstacles(two)
    bigger = mp.Obstacle("a", mp.Sphere(2.0))
    assert [o for o in world.with_obstacles(bigger) if o.name == "a"] == [bigger]
    world = world.without(["b"])
    assert world.names == ("a",) and len(world) == 1
    assert world.allows("a", "link") and world.allows("link", "a")
    assert world.allows("floor", "link") and world.allows("link", "floor")
    assert not world.allows("link", "b")
