# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Paces, and families of shapes that are passed through at one."""

import numpy as np
import pytest
from support.arm import arm_primitive

from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.primitives.basis import PacedBasis, legendre_values
from mp_pca_planner.primitives.in_span import request_precision
from mp_pca_planner.primitives.prediction import ConditionalModel
from mp_pca_planner.primitives.timing import KNOTS, fit_paces, time_scaling

PHASES = np.linspace(0.0, 1.0, 101)
PACE = np.array([0.1, -0.07, 0.03, 0.02])
WAY = np.array([0.4, -1.0, 0.0, 0.3])


def aligned(pace=PACE, phases=PHASES, derivative=0):
    """σ(p), or a derivative, at shares p of the duration."""
    return legendre_values(time_scaling(np.asarray(pace)), phases, derivative)


def paced(pace=PACE):
    return PacedBasis(arm_primitive().basis, WAY, time_scaling(np.asarray(pace)))


def test_the_most_uneven_pace_still_increases():
    phases = aligned([50.0, -80.0, 90.0, -70.0])
    assert np.all(np.diff(phases) > 0.0)


def warp_of(pace):
    """The inverse of a time scaling: shares of the duration at aligned phases."""
    shares = np.linspace(0.0, 1.0, 5001)
    return np.interp(KNOTS, aligned(pace, shares), shares)


def test_the_pace_of_a_way_back_is_predicted_from_those_of_the_way_there():
    """Ten ways there and nine back, in reversed time; far ways share no more than their mean."""
    rng = np.random.default_rng(2)
    ends, sizes = 3.0 * rng.normal(size=(10, 4)), rng.uniform(-1.0, 1.0, (10, 1))
    backwards = 1.0 - np.array([warp_of(size * PACE) for size in sizes])[:, ::-1]
    back = fit_paces(backwards, price=1e-12, max_jerk=np.inf)
    requests = np.vstack([ends, ends[:-1, [2, 3, 0, 1]]])
    requests = np.column_stack([requests, np.zeros(19)])
    paces, none = np.vstack([sizes * PACE, back[:-1]]), np.zeros((2, 19, 0))
    precision = request_precision(requests)
    model = ConditionalModel.fit(requests, none, np.zeros(0), paces, precision)
    found = model.predict(ends[-1, 2:], ends[-1, :2], 1.0).pace
    assert np.linalg.norm(found - back[-1]) < 0.3 * np.linalg.norm(back[-1])


def test_a_pace_is_found_again():
    found = fit_paces(warp_of(PACE)[None], price=1e-12, max_jerk=np.inf)[0]
    np.testing.assert_allclose(found, PACE, atol=2e-3)
    assert not np.any(fit_paces(KNOTS[None]))


def jerk_at_ends(pace):
    """Of a motion of length 1 in 1 s, in its first and last tenth, by finite differences."""
    p = np.linspace(0.0, 1.0, 2001)
    course = hermite_functions(aligned(pace, p))[:, 3]
    jerk = np.diff(course, 3) / p[1] ** 3
    return np.abs(jerk[np.abs(p[1:-2] - 0.5) > 0.4]).max()


def test_motions_that_are_cut_off_are_calm_at_the_ends():
    # Their path grows linearly at the start, the course of the aligned motion with the third power.
    warp = (10.0 * KNOTS**3 - 15.0 * KNOTS**4 + 6.0 * KNOTS**5)[None]
    free = jerk_at_ends(fit_paces(warp, price=1e-12, max_jerk=np.inf)[0])
    assert jerk_at_ends(fit_paces(warp)[0]) <= 300.0 * 1.01 < 0.7 * free
    for bound in (150.0, 100.0):
        found = fit_paces(np.repeat(warp, 2, axis=0), np.array([bound / 1.2, np.inf]))
        assert jerk_at_ends(found[0]) <= 1.01 * bound < jerk_at_ends(found[1])


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
