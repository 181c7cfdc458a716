# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time alignment against motions whose timing is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arm import arm_demonstrations
from support.bags import minimum_jerk

from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.primitives.timing import (
    arc_length_warp,
    own_phases,
)

PHASES = np.linspace(0.0, 1.0, 101)


def test_arc_length_alignment_goes_its_way_at_the_pace_of_minimum_jerk():
    for demonstration in arm_demonstrations():
        warp = arc_length_warp(demonstration.time_normalised(1001))
        motion = demonstration.at(demonstration.duration * own_phases(warp, PHASES))
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion, axis=0), axis=1))])
        # The share of time that the warp mixes in keeps it from being exact.
        np.testing.assert_allclose(way / way[-1], minimum_jerk(0.0, 1.0, 101), atol=0.03)


@pytest.mark.parametrize(("method", "coupling"), [("linear", "joint"), ("arc_length", "arm")])
def test_weights_and_warp_give_a_demonstration_back_in_its_own_time(method, coupling):
    demonstrations = arm_demonstrations()
    options = PrimitiveOptions(align=method, coupling=coupling, n_components=5)
    primitive = build_primitive(demonstrations, "x", options)
    assert not np.any(primitive.boundary_states[:, [1, 2, 4, 5]])  # all count as at rest there
    for i, demonstration in enumerate(demonstrations):
        warp = primitive.warps[i]
        # At the aligned phases, to the residual that is stated ...
        times = demonstration.duration * own_phases(warp, PHASES)
        truth = demonstration.at(times)
        error = primitive.reproduction(i, times) - truth
        np.testing.assert_allclose(
            np.sqrt(np.mean(error**2, axis=0)), primitive.fit_residual[i], rtol=1e-6, atol=1e-9
        )
        # ... and at evenly spaced times to much the same.
        error = primitive.reproduction(i, demonstration.times) - demonstration.positions
        assert np.sqrt(np.mean(error**2)) < 2.0 * np.sqrt(np.mean(primitive.fit_residual[i] ** 2))
        assert np.abs(error[[0, -1]]).max() < 1e-9


ROW = st.lists(st.sampled_from([0.0, 0.0, 1e-9, 0.1, -0.3, 2.0]), min_size=2, max_size=2)


@given(st.lists(ROW, min_size=2, max_size=12))
def test_the_warp_of_any_motion_increases_from_0_to_1(positions):
    warp = arc_length_warp(np.array(positions))
    assert warp[0] == 0.0 and warp[-1] == 1.0
    assert np.diff(warp).min() > 0.0


@pytest.mark.filterwarnings("ignore:8 of 8 motions")
def test_motions_that_are_cut_while_they_move_are_predicted_along_their_path():
    """Circles in the plane at constant speed, aligned by time."""
    times = np.linspace(0.0, 1.0, 101)
    angles = [a + b * times for a in (0.0, 0.2, 0.4) for b in (1.8, 2.0, 2.2)]
    circles = [np.column_stack([np.cos(x), np.sin(x)]) for x in angles]
    start, goal = circles.pop(4)[[0, -1]]
    primitive = MovementPrimitive.fit(circles, times=times, align="linear")
    found = primitive.predict(start, goal, 1.0).positions
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 0.05
