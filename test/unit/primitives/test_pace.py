# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Paces, and families of shapes that are passed through at one."""

import numpy as np
import pytest
from arm import arm_primitive

from mp_pca_planner.primitives.alignment import KNOTS, aligned_phases
from mp_pca_planner.primitives.basis import PolynomialBasis
from mp_pca_planner.primitives.boundary import hermite_functions
from mp_pca_planner.primitives.pace import PacedBasis, fit_paces, reversed_paces

PHASES = np.linspace(0.0, 1.0, 101)
PACE = np.array([0.5, -0.7, 0.3, 0.2])
WAY = np.array([0.4, -1.0, 0.0, 0.3])


def nothing(n_joints=1):
    """A family without functions and with the mean 0."""
    return PolynomialBasis(np.zeros((n_joints, 8)), np.zeros((0, n_joints, 8)), np.zeros(0))


def paced(pace=PACE):
    return PacedBasis(arm_primitive().basis, WAY, np.asarray(pace))


def test_a_pace_increases_from_0_to_1():
    phases = paced().aligned_phases(PHASES)
    assert phases[0] == pytest.approx(0.0, abs=1e-12)
    assert phases[-1] == pytest.approx(1.0, abs=1e-12)
    assert np.all(np.diff(phases) > 0.0)


def test_the_logarithm_of_the_rate_is_the_polynomial():
    rate = paced().aligned_phases(PHASES, 1)
    x = 2.0 * PHASES - 1.0
    g = np.polynomial.legendre.legval(x, [0.0, *PACE])
    np.testing.assert_allclose(np.log(rate) - g, np.log(rate[0]) - g[0], atol=1e-9)


def test_a_reversed_pace_runs_backwards():
    (backwards,) = reversed_paces(PACE[None])
    found = paced(backwards).aligned_phases(PHASES)
    np.testing.assert_allclose(found, 1.0 - paced().aligned_phases(PHASES)[::-1], atol=1e-9)


def test_the_most_uneven_pace_still_increases():
    phases = paced([50.0, -80.0, 90.0, -70.0]).aligned_phases(PHASES)
    assert np.all(np.diff(phases) > 0.0)


@pytest.mark.parametrize("power", [0.7, 1.0, 1.6])
def test_a_fitted_pace_comes_near_to_the_warp(power):
    warp = KNOTS**power
    (pace,) = fit_paces(warp[None])
    found = PacedBasis(nothing(), np.zeros(1), pace).aligned_phases(PHASES)
    assert np.abs(found - aligned_phases(warp, PHASES)).max() < 0.05
    assert np.any(pace) == (power != 1.0)


def test_a_pace_is_found_again():
    basis = PacedBasis(nothing(), np.zeros(1), PACE)
    # The warp is the inverse: shares of the duration at aligned phases.
    warp = np.interp(KNOTS, basis.aligned_phases(np.linspace(0, 1, 5001)), np.linspace(0, 1, 5001))
    np.testing.assert_allclose(fit_paces(warp[None], end_price=0.0)[0], PACE, atol=0.02)


def test_motions_that_are_cut_off_have_no_fast_ends():
    # Their path grows linearly at the start, the course of the aligned motion with the third power.
    warp = (10.0 * KNOTS**3 - 15.0 * KNOTS**4 + 6.0 * KNOTS**5)[None]

    def rate_at_ends(pace):
        return PacedBasis(nothing(), np.zeros(1), pace).aligned_phases(np.array([0.0, 1.0]), 1)

    free, priced = (rate_at_ends(fit_paces(warp, end_price=x)[0]).max() for x in (0.0, 3e-4))
    assert priced < 0.6 * free
    assert priced == pytest.approx(rate_at_ends(fit_paces(warp)[0]).max())


def test_an_even_pace_changes_nothing():
    basis, weights = arm_primitive().basis, np.array([0.3, -0.2, 0.1, 0.4])
    for d in range(4):
        np.testing.assert_allclose(
            paced(np.zeros(4)).shape(weights, PHASES, d), basis.shape(weights, PHASES, d), atol=1e-8
        )


def test_a_paced_motion_goes_the_same_way():
    basis, weights = arm_primitive().basis, np.array([0.3, -0.2, 0.1, 0.4])
    family = paced()
    even = family.aligned_phases(PHASES)
    there = hermite_functions(PHASES)[:, 3:4] * WAY + family.shape(weights, PHASES)
    here = hermite_functions(even)[:, 3:4] * WAY + basis.shape(weights, even)
    np.testing.assert_allclose(there, here, atol=1e-12)


@pytest.mark.parametrize("derivative", [1, 2, 3])
def test_derivatives_are_those_of_finite_differences(derivative):
    family, weights, step = paced(), np.array([0.3, -0.2, 0.1, 0.4]), 1e-5
    inside = PHASES[1:-1]
    for values in (lambda s, d: family.shape(weights, s, d), family.functions):
        ahead, behind = (values(inside + h, derivative - 1) for h in (step, -step))
        exact = values(inside, derivative)
        scale = np.abs(exact).max()
        np.testing.assert_allclose(
            (ahead - behind) / (2 * step), exact, rtol=1e-4, atol=1e-6 * scale
        )


def test_what_a_paced_motion_adds_vanishes_at_both_ends_with_two_derivatives():
    family, ends = paced(), np.array([0.0, 1.0])
    for d in range(3):
        np.testing.assert_allclose(family.functions(ends, d), 0.0, atol=1e-8)
        np.testing.assert_allclose(family.shape(np.ones(4), ends, d), 0.0, atol=1e-8)


def test_a_fourth_derivative_is_refused():
    with pytest.raises(ValueError, match="0 to 3, got 4"):
        paced().functions(PHASES, 4)
