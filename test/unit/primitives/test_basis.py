# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Families of shapes: polynomials and B-splines that vanish at both ends."""

import numpy as np
import pytest
from numpy.polynomial import legendre
from support.arm import arm_primitive

from mp_pca_planner.primitives.basis import (
    BSplineBasis,
    legendre_derivatives,
    legendre_values,
)

BASES = [arm_primitive("arm").basis, arm_primitive("joint").basis, BSplineBasis(4)]


@pytest.mark.parametrize("basis", BASES, ids=["arm", "joint", "bspline"])
def test_shapes_vanish_at_both_ends_are_linear_and_have_the_derivatives_of_differences(basis):
    phases, step = np.linspace(0.03, 0.97, 31), 1e-6
    weights = np.linspace(-2.0, 2.0, basis.n_weights) * basis.scales
    for order in range(3):
        found = basis.shape(weights, phases, order)
        ends = basis.shape(weights, np.array([0.0, 1.0]), order)
        np.testing.assert_allclose(ends, 0.0, atol=1e-11 * np.abs(found).max())
        mean = basis.shape(np.zeros(basis.n_weights), phases, order)
        weighted = mean + basis.functions(phases, order) @ weights
        np.testing.assert_allclose(found, weighted, atol=1e-9)
        if order > 0:
            above, below = (basis.shape(weights, phases + x, order - 1) for x in (step, -step))
            slope, tolerance = (above - below) / (2.0 * step), 1e-6 * np.abs(found).max()
            np.testing.assert_allclose(found, slope, atol=tolerance)


@pytest.mark.parametrize("degree", [6, 26])
def test_series_agree_with_those_of_an_independent_library(degree):
    series = np.random.default_rng(degree).normal(size=(3, 2, degree + 1))
    phases = np.linspace(0.0, 1.0, 41)
    found = legendre_derivatives(series, phases, 3)
    for order in range(4):
        # dx/ds = 2
        derived = legendre.legder(series, order, scl=2.0, axis=2)
        expected = legendre.legval(2.0 * phases - 1.0, np.moveaxis(derived, 2, 0))
        tolerance = 1e-12 * np.abs(expected).max()
        for values in (found[order], legendre_values(series, phases, order)):
            np.testing.assert_allclose(values, np.moveaxis(expected, 2, 0), atol=tolerance)
