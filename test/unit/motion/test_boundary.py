# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The boundary part of a motion: the quintic between two states."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from mp_pca_planner.motion.interpolation import boundary_values, hermite_functions

states = arrays(np.float64, (6, 3), elements=st.floats(-10.0, 10.0))


@given(states, st.floats(0.05, 20.0))
def test_the_quintic_takes_the_asked_values_at_both_ends(state, duration):
    values = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
    ends = np.array([0.0, 1.0])
    for order in range(3):
        reached = hermite_functions(ends, order) @ values / duration**order
        scale = 1.0 + np.abs(values).max() / duration**order
        np.testing.assert_allclose(reached, state[[order, order + 3]], atol=1e-12 * scale)


def test_derivatives_agree_with_central_differences():
    phases, step = np.linspace(0.1, 0.9, 9), 1e-6
    for order in range(1, 4):
        above, below = (hermite_functions(phases + x, order - 1) for x in (step, -step))
        np.testing.assert_allclose(
            hermite_functions(phases, order), (above - below) / (2.0 * step), atol=1e-6
        )


def test_from_rest_to_rest_it_is_the_minimum_jerk_motion():
    # Flash and Hogan (1985), eq. for x(t): xi + (xi - xf)(15 τ⁴ - 6 τ⁵ - 10 τ³).
    tau = np.linspace(0.0, 1.0, 11)
    zero = np.zeros(1)
    values = boundary_values((np.array([2.0]), zero, zero), (np.array([5.0]), zero, zero), 1.7)
    expected = 2.0 + (2.0 - 5.0) * (15.0 * tau**4 - 6.0 * tau**5 - 10.0 * tau**3)
    np.testing.assert_allclose(hermite_functions(tau) @ values[:, 0], expected, atol=1e-14)


def test_no_admissible_change_lowers_the_jerk_of_the_quintic():
    # First variation of ½∫jerk²: zero for every change that keeps the ends.
    values = np.random.default_rng(0).normal(size=6)
    for power in range(3):

        def bump_jerk(s, power=power):
            bump = (
                np.polynomial.Polynomial([0, 1]) ** (3 + power)
                * (1 - np.polynomial.Polynomial([0, 1])) ** 3
            )
            return bump.deriv(3)(s)

        variation, _ = quad(
            lambda s, j=bump_jerk: float(hermite_functions(np.array([s]), 3)[0] @ values) * j(s),
            0.0,
            1.0,
        )
        assert abs(variation) < 1e-9
