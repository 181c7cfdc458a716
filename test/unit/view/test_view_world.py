# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that are added, moved, resized and removed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mp_pca_planner.robot.world import Box, Capsule, Cylinder, Obstacle, Sphere, World

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view.world_panel import KINDS, WorldEditor

ball, box = Obstacle("ball", Sphere(0.1, [1, 0, 0])), Obstacle("box", Box([1, 2, 3], [0, 1, 0]))
pair = Obstacle("pair", [Sphere(0.1, [0, 0, 0]), Capsule(0.1, 0.5, [2, 0, 0])])


def test_new_obstacles_have_names_of_their_own_and_the_place_asked_for():
    editor = WorldEditor(World([ball]))
    names = [editor.add(kind, [1, 2, 3], 0.2) for kind in (*KINDS, *KINDS)]
    assert len(set(names)) == 6 and editor.world.names == ("ball", *names)
    for name in names:
        np.testing.assert_allclose(editor.place(name), [1, 2, 3])


@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3))
def test_shapes_move_together_without_a_turn(place):
    editor = WorldEditor(World([ball, pair]))
    before = editor.place("pair")
    editor.move("pair", np.array(place))
    for old, new in zip(pair.shapes, editor["pair"].shapes, strict=True):
        np.testing.assert_allclose(new.position, old.position - before + place, atol=1e-9)
        np.testing.assert_allclose(new.orientation, old.orientation)
    np.testing.assert_allclose(editor.place("pair"), place, atol=1e-9)
    assert editor["ball"] is ball


@pytest.mark.parametrize(
    "shape", [Box([1, 2, 3]), Sphere(0.5), Cylinder(0.2, 1.0), Capsule(0.2, 1.0)]
)
def test_sizes_are_read_and_written(shape):
    editor = WorldEditor(World([Obstacle("it", shape)]))
    sizes = editor.sizes("it")
    editor.resize("it", [2.0 * size for size in sizes.values()])
    assert editor.sizes("it") == {name: 2.0 * size for name, size in sizes.items()}
    assert type(editor["it"].shapes[0]) is type(shape)


def test_order_and_allowed_contacts_survive_a_change():
    editor = WorldEditor(World([ball, box], [("ball", "wrist")]))
    editor.move("ball", np.zeros(3))
    assert editor.world.names == ("ball", "box") and editor.world.allows("ball", "wrist")
    editor.remove("ball")
    assert editor.world.names == ("box",)
