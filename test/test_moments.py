# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Moments that are merged are those of all samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mp_pca_planner.primitives.moments import Moments


def samples(n, n_features=4, seed=0, offset=0.0):
    rng = np.random.default_rng(seed)
    scales = 10.0 ** -np.arange(n_features)
    return rng.normal(size=(n, n_features)) @ rng.normal(size=(n_features,) * 2) * scales + offset


def assert_same(found, rows):
    """Found are the moments of the rows, by NumPy's own two-pass formulas."""
    assert found.count == len(rows)
    scale = np.abs(rows - rows[0]).max() + 1e-300
    np.testing.assert_allclose(found.mean, rows.mean(axis=0), rtol=1e-13, atol=1e-13 * scale)
    expected = np.cov(rows, rowvar=False) if len(rows) > 1 else np.zeros((rows.shape[1],) * 2)
    deviations = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    rounding = 1e-15 * np.abs(rows).max() * scale
    covariance = found.factor.T @ found.factor / max(found.count - 1, 1)
    assert np.all(np.abs(covariance - expected) <= 1e-12 * deviations + rounding)
    np.testing.assert_allclose(found.variances, np.diag(covariance), rtol=1e-12)


@given(st.data(), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_any_partition_merged_in_any_tree_gives_the_moments_of_all(data, n, seed):
    rows = samples(n, seed=seed, offset=3.0)
    cuts = sorted(data.draw(st.sets(st.integers(1, n - 1)))) if n > 1 else []
    parts = [Moments.of(part) for part in np.split(rows, cuts)]
    while len(parts) > 1:
        one = parts.pop(data.draw(st.integers(0, len(parts) - 1)))
        other = parts.pop(data.draw(st.integers(0, len(parts) - 1)))
        parts.append(one.merge(other))
    assert_same(parts[0], rows)


def test_size_does_not_grow_with_the_number_of_samples():
    rows = samples(5000, n_features=6)
    merged = Moments.merged(Moments.of(row[None]) for row in rows)
    assert merged.factor.shape[0] <= 12
    assert_same(merged, rows)


def test_the_same_order_gives_the_same_bits():
    parts = [Moments.of(samples(3, seed=i)) for i in range(30)]
    one, other = Moments.merged(parts), Moments.merged(iter(parts))
    assert (
        one.mean.tobytes() + one.factor.tobytes() == other.mean.tobytes() + other.factor.tobytes()
    )


def test_small_variances_survive_beside_large_means_and_variances():
    # From the scatter matrix itself, the small variance would have no digit left.
    rows = samples(200, n_features=2) * [1.0, 1e-9] + [1e3, 0.0]
    merged = Moments.merged(Moments.of(part) for part in np.split(rows, 20))
    smallest = np.linalg.svd(rows - rows.mean(axis=0))[1][-1]
    assert np.linalg.svd(merged.factor)[1][-1] == pytest.approx(smallest, rel=1e-9)


def test_one_sample_has_no_scatter():
    found = Moments.of(np.array([[0.1, 0.2]]))
    assert found.factor.size == 0
    np.testing.assert_array_equal(found.variances, [0.0, 0.0])


def test_transformed_and_selected_moments_are_those_of_transformed_samples():
    rows = samples(40)
    matrix = samples(4, n_features=3, seed=1)
    moments = Moments.merged(Moments.of(part) for part in np.split(rows, 8))
    assert_same(moments.transform(matrix), rows @ matrix)
    assert_same(moments.select(slice(1, 3)), rows[:, 1:3])
