# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

from dataclasses import FrozenInstanceError

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
        (
            lambda: mp.Box((1.0, 0.0, 1.0)),
            "size of a box must be above 0",
        ),
        (lambda: mp.Box((1.0, 1.0)), "size of a box must have the shape"),
        (lambda: mp.Sphere(np.nan), "radius of a sphere is nan"),
        (lambda: mp.Sphere(-1.0), "radius of a sphere must be above 0"),
        (lambda: mp.Sphere("big"), "radius of a sphere must be numbers"),
        (lambda: mp.Cylinder(1.0, 2e3), "height of a cylinder must be above 0 and at most 1000 m"),
        (lambda: mp.Capsule(0.0, 1.0), "radius of a capsule must be above 0"),
        (lambda: mp.Sphere(1.0, (np.inf, 0, 0)), r"position of a sphere\[0\] is inf"),
        (lambda: mp.Sphere(1.0, (0, 0, 0), (0, 0, 0, 0)), "length 1, got one of length 0"),
        (lambda: mp.Mesh(np.eye(3), [[0, 1, 3]]), "indices of its 3 vertices, from 0 to 2"),
        (lambda: mp.Mesh(np.eye(3), [[0, 1, 0.5]]), "indices of its 3 vertices"),
        (lambda: mp.Mesh(np.eye(3), np.zeros((0, 3))), "a mesh must have 1 to"),
        (lambda: mp.Obstacle("", mp.Sphere(1.0)), "an obstacle must have a name"),
        (lambda: mp.Obstacle("a", []), "obstacle 'a' must have one or several shapes"),
        (lambda: mp.Obstacle("a", [1.0]), "obstacle 'a' must have one or several shapes"),
        (lambda: mp.World([mp.Obstacle("a", mp.Sphere(1.0))] * 2), "'a' given more than once"),
        (
            lambda: mp.World([mp.Obstacle("a", [mp.Sphere(1.0)] * (INPUT_LIMITS.shapes + 1))]),
            "1001 shapes is too large: at most 1000",
        ),
    ],
)
def test_what_can_not_be_is_refused_with_one_sentence(make, message):
    with pytest.raises(WorldError, match=message) as found:
        make()
    assert "\n" not in str(found.value)


def test_values_are_frozen():
    box = mp.Box((1, 2, 3))
    with pytest.raises(FrozenInstanceError):
        box.size = (1, 1, 1)
    with pytest.raises(ValueError, match="read-only"):
        box.size[0] = 2.0


def test_moved_shape_is_where_both_poses_lead():
    # A quarter turn about z takes x to y.
    moved = mp.Box((1, 2, 3), (1, 0, 0), TURNED).moved(np.array([0, 0, 5, *TURNED]))
    np.testing.assert_allclose(moved.position, [0, 1, 5], atol=1e-12)
    np.testing.assert_allclose(np.abs(moved.orientation), [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(moved.size, [1, 2, 3])


def test_worlds_change_by_name():
    one, two = (mp.Obstacle(name, mp.Sphere(1.0)) for name in "ab")
    world = mp.World([one]).with_obstacles(two)
    assert world.names == ("a", "b") and len(world) == 2
    bigger = mp.Obstacle("a", mp.Sphere(2.0))
    assert [o for o in world.with_obstacles(bigger) if o.name == "a"] == [bigger]
    assert world.without(["a"]).names == ("b",)
    with pytest.raises(WorldError, match="no obstacle is called 'c'"):
        world.without(["c"])


def test_allowed_contacts_hold_both_ways():
    world = mp.World(allowed=[("link", "box"), ("floor", ANY)])
    assert world.allows("box", "link") and world.allows("link", "box")
    assert world.allows("floor", "link") and world.allows("link", "floor")
    assert not world.allows("link", "ball")


def test_reprs_are_short():
    table = mp.Obstacle("table", mp.Box((1.2, 2, 0.04), (0.4, 1, 0.2)), "tool")
    assert repr(table) == "Obstacle 'table' on 'tool': Box(1.2 × 2 × 0.04) at (0.4, 1, 0.2)"
    assert repr(mp.World([table])) == "World of 'table'"
    assert repr(mp.Capsule(0.1, 1.0)) == "Capsule(radius 0.1, height 1) at (0, 0, 0)"
