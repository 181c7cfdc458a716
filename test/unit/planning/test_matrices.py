# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Matrices of overlapping blocks do what the dense ones do."""

import numpy as np
import pytest

from mp_pca_planner.planning.solver.matrices import BlockMatrix, as_array, cholesky, mean_diagonal
from mp_pca_planner.planning.solver.quadratic import solve_quadratic
from mp_pca_planner.planning.solver.trust_region import trust_region_step

SLICES = (slice(0, 4), slice(2, 7), slice(5, 9))


def random_blocks(seed, shift=0.0):
    rng = np.random.default_rng(seed)
    blocks = []
    for where in SLICES:
        root = rng.normal(size=(where.stop - where.start,) * 2)
        blocks.append(root @ root.T + 0.1 * np.eye(len(root)) - shift * np.eye(len(root)))
    return BlockMatrix(SLICES, tuple(blocks)), rng


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_factors_of_blocks_solve_the_dense_system(shift):
    matrix, rng = random_blocks(0)
    dense, right = matrix.dense() + shift * np.eye(9), rng.normal(size=(9, 3))
    factor = cholesky(matrix, shift)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(dense, right), rtol=1e-9)
    np.testing.assert_allclose(factor.solve(right[:, 0]), factor.solve(right)[:, 0], rtol=1e-12)
    np.testing.assert_allclose(matrix @ right[:, 0], matrix.dense() @ right[:, 0], rtol=1e-12)
    assert mean_diagonal(matrix) == pytest.approx(np.trace(matrix.dense()) / 9)


def test_blocks_that_are_not_positive_definite_have_no_factor():
    matrix, _ = random_blocks(0, shift=50.0)
    assert cholesky(matrix) is None
    assert np.linalg.eigvalsh(as_array(matrix))[0] < 0.0


def test_quadratic_programs_of_blocks_have_the_dense_solution():
    matrix, rng = random_blocks(1)
    gradient, rows, bounds = rng.normal(size=9), rng.normal(size=(5, 9)), np.full(5, 0.1)
    found, dense = (
        solve_quadratic(cholesky(h), gradient, rows, bounds) for h in (matrix, matrix.dense())
    )
    np.testing.assert_allclose(found.step, dense.step, atol=1e-8)
    np.testing.assert_allclose(found.multipliers, dense.multipliers, atol=1e-8)


@pytest.mark.parametrize("shift", [0.0, 3.0])
@pytest.mark.parametrize("radius", [0.1, 1e3])
def test_trust_region_steps_of_blocks_stay_inside_and_decrease_the_model(shift, radius):
    matrix, rng = random_blocks(2, shift)
    gradient = rng.normal(size=9)
    found = trust_region_step(matrix, gradient, radius)
    assert np.linalg.norm(found.step) <= 1.06 * radius
    assert found.predicted > 0.0
    dense = trust_region_step(matrix.dense(), gradient, radius)
    if shift == 0.0:
        assert found.predicted == pytest.approx(dense.predicted, rel=0.1)
