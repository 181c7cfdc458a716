# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Warps increase and leave both ends as they are, whatever their parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mp_pca_planner.learning.refined_motion import evaluate_warp

PHASES = np.linspace(0.0, 1.0, 201)
parameters = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array)


@given(parameters)
@settings(max_examples=100, deadline=None)
def test_a_warp_increases_and_keeps_its_ends(c):
    s, rate, bend, _ = evaluate_warp(c, PHASES)
    assert np.all(rate > 0.0)
    assert np.all(np.diff(s) > 0.0)
    np.testing.assert_allclose(s[[0, -1]], [0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(rate[[0, -1]], 1.0, atol=1e-10)
    np.testing.assert_allclose(bend[[0, -1]], 0.0, atol=1e-7)


def test_no_parameters_are_the_identity():
    s, rate, bend, _ = evaluate_warp(np.zeros(3), PHASES)
    np.testing.assert_allclose(s, PHASES, atol=1e-14)
    np.testing.assert_allclose(rate, 1.0, atol=1e-13)
    np.testing.assert_allclose(bend, 0.0, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    c, phases, step = rng.uniform(-2, 2, 3), np.linspace(0.05, 0.95, 19), 1e-6
    ahead, behind = (evaluate_warp(c, phases + x) for x in (step, -step))
    slope = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(slope[:3], evaluate_warp(c, phases)[1:], rtol=1e-6, atol=1e-6)
