# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Principal components: equations (1) to (5) of the paper, each against its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mp_pca_planner.primitives.pca import components_for_share, fit_components


@pytest.fixture
def samples():
    rng = np.random.default_rng(3)
    return rng.normal(size=(30, 8)) @ np.diag([5, 4, 3, 2, 1, 0.5, 0.2, 0.1]) + rng.normal(size=8)


def test_equation_1_components_are_orthonormal_eigenvectors_of_the_covariance(samples):
    found = fit_components(samples)
    covariance = np.cov(samples, rowvar=False)
    for value, vector in zip(found.explained_variance, found.components, strict=True):
        np.testing.assert_allclose(covariance @ vector, value * vector, atol=1e-12)
    np.testing.assert_allclose(found.components @ found.components.T, np.eye(8), atol=1e-13)
    assert np.all(np.diff(found.explained_variance) <= 0.0)
    assert found.explained_variance[-1] > 0.0


def test_equation_2_weights_are_projections_on_the_components(samples):
    found = fit_components(samples)
    y = found.transform(samples)
    for i in range(8):
        by_hand = sum(found.components[i, j] * (samples[:, j] - found.mean[j]) for j in range(8))
        np.testing.assert_allclose(y[:, i], by_hand, atol=1e-12)


def test_equation_3_weights_have_the_eigenvalues_as_variances_and_are_uncorrelated(samples):
    found = fit_components(samples)
    covariance = np.cov(found.transform(samples), rowvar=False)
    np.testing.assert_allclose(covariance, np.diag(found.explained_variance), atol=1e-11)


def test_equation_4_variances_add_up_to_the_eigenvalues(samples):
    found = fit_components(samples)
    total = samples.var(axis=0, ddof=1).sum()
    np.testing.assert_allclose(found.explained_variance.sum(), total)
    np.testing.assert_allclose(found.transform(samples).var(axis=0, ddof=1).sum(), total)
    np.testing.assert_allclose(found.total_variance, total)


def test_equation_5_shares_are_variances_over_their_sum(samples):
    found = fit_components(samples)
    total = samples.var(axis=0, ddof=1).sum()
    expected = found.transform(samples).var(axis=0, ddof=1) / total
    shares = found.explained_variance / found.total_variance
    np.testing.assert_allclose(shares, expected)
    np.testing.assert_allclose(shares.sum(), 1.0)


def test_all_components_give_the_samples_back(samples):
    found = fit_components(samples)
    restored = found.mean + found.transform(samples) @ found.components
    np.testing.assert_allclose(restored, samples, atol=1e-12)


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


def test_samples_of_low_rank_give_as_many_components_as_they_have():
    rng = np.random.default_rng(0)
    found = fit_components(rng.normal(size=(20, 2)) @ rng.normal(size=(2, 9)))
    assert len(found.components) == 2


@pytest.mark.parametrize(("share", "n"), [(0.5, 1), (0.55, 2), (0.8, 2), (0.80001, 3), (1.0, 3)])
def test_the_fewest_components_that_reach_a_share_are_taken(share, n):
    corners = np.vstack([np.diag([a, b, c]) for a, b, c in ((1, 1, 1), (-1, -1, -1))])
    found = fit_components(corners * np.sqrt([5.0, 3.0, 2.0]))
    np.testing.assert_allclose(found.explained_variance / found.total_variance, [0.5, 0.3, 0.2])
    assert components_for_share(found, share) == n
