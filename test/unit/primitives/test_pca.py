# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Principal components: equations (1) to (5) of the paper, each against its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mp_pca_planner.primitives.pca import components_for_share, fit_components


def test_equations_1_to_5_hold():
    rng = np.random.default_rng(3)
    scales = np.diag([5, 4, 3, 2, 1, 0.5, 0.2, 0.1])
    samples = rng.normal(size=(30, 8)) @ scales + rng.normal(size=8)
    found = fit_components(samples)
    values, vectors = found.explained_variance, found.components
    # (1) Orthonormal eigenvectors of the covariance, in decreasing order of their eigenvalues.
    covariance = np.cov(samples, rowvar=False)
    np.testing.assert_allclose(covariance @ vectors.T, values * vectors.T, atol=1e-12)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(8), atol=1e-13)
    assert np.all(np.diff(values) <= 0.0) and values[-1] > 0.0
    # (2) Weights are projections, (3) uncorrelated, with the eigenvalues as variances.
    y = found.transform(samples)
    np.testing.assert_allclose(samples.mean(axis=0) + y @ vectors, samples, atol=1e-12)
    np.testing.assert_allclose(np.cov(y, rowvar=False), np.diag(values), atol=1e-11)
    # (4) The variances of the features add up to the eigenvalues, of which (5) are shares.
    np.testing.assert_allclose(found.total_variance, samples.var(axis=0, ddof=1).sum())
    np.testing.assert_allclose(np.sum(values / found.total_variance), 1.0)


@given(st.integers(0, 2**32 - 1))
def test_the_entry_largest_in_magnitude_is_positive(seed):
    found = fit_components(np.random.default_rng(seed).normal(size=(6, 4)))
    for vector in found.components:
        assert vector[np.abs(vector).argmax()] > 0.0


@pytest.mark.parametrize("rows", [np.ones((5, 4)), np.ones((1, 4))])
def test_constant_samples_give_no_components(rows):
    found = fit_components(rows)
    assert found.components.shape == (0, 4)
    assert found.explained_variance.size == 0
    assert components_for_share(found, 0.99) == 0
    np.testing.assert_array_equal(found.transform(rows), np.zeros((len(rows), 0)))


@pytest.mark.parametrize(("share", "n"), [(0.5, 1), (0.55, 2), (0.8, 2), (0.80001, 3), (1.0, 3)])
def test_the_fewest_components_that_reach_a_share_are_taken(share, n):
    corners = np.vstack([np.diag([a, b, c]) for a, b, c in ((1, 1, 1), (-1, -1, -1))])
    found = fit_components(corners * np.sqrt([5.0, 3.0, 2.0]))
    np.testing.assert_allclose(found.explained_variance / found.total_variance, [0.5, 0.3, 0.2])
    assert components_for_share(found, share) == n
