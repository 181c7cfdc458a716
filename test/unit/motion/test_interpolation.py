# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Quintics between states, against SciPy and the calculus of variations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BPoly

from mp_pca_planner.motion.interpolation import (
    BEZIER_POINTS,
    boundary_values,
    hermite_functions,
    interpolate,
)
from mp_pca_planner.motion.trajectory import Trajectory

PHASES = np.linspace(0.0, 1.0, 101)


@given(arrays(np.float64, (6, 3), elements=st.floats(-10.0, 10.0)), st.floats(0.05, 20.0))
def test_the_quintic_takes_the_requested_values_at_both_ends(state, duration):
    values = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
    for order in range(3):
        reached = hermite_functions(np.array([0.0, 1.0]), order) @ values / duration**order
        scale = 1.0 + np.abs(values).max() / duration**order
        np.testing.assert_allclose(reached, state[[order, order + 3]], atol=1e-12 * scale)


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_a_quintic_and_its_derivatives_lie_between_their_bezier_points(seed, order):
    ends = np.random.default_rng(seed).normal(size=6)
    points = BEZIER_POINTS[order, : 6 - order] @ ends
    curve = hermite_functions(PHASES, order) @ ends
    assert points.min() - 1e-9 <= curve.min() and curve.max() <= points.max() + 1e-9
    # An independent library's curve through the same points.
    np.testing.assert_allclose(curve, BPoly(points[:, None], [0.0, 1.0])(PHASES), atol=1e-9)


def test_dense_samples_are_those_of_an_independent_library():
    rng = np.random.default_rng(0)
    times = np.array([0.0, 0.11, 0.3, 0.35, 0.8])
    q, v, a = rng.normal(size=(3, 5, 4))
    dense = interpolate(Trajectory(list("abcd"), times, q, v, a), 1e-3)
    assert np.diff(dense.times).max() <= 1e-3 + 1e-12
    curve = BPoly.from_derivatives(times, np.stack([q, v, a], axis=1))
    inner = ~np.isin(np.round(dense.times, 12), times)
    for order, found in enumerate((dense.q, dense.v, dense.a, dense.jerk)):
        expected = curve.derivative(order)(dense.times) if order else curve(dense.times)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found[inner], expected[inner], atol=1e-9 * scale)
