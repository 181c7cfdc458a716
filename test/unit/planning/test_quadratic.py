# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Quadratic programs: optimality conditions, an independent solver, contradictions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mp_pca_planner.planning.solver import cholesky, solve_quadratic


def random_program(seed):
    """A feasible program, some of whose constraints are active."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 9)), int(rng.integers(1, 15))
    root = rng.normal(size=(n, n))
    rows = rng.normal(size=(m, n)) * 10.0 ** rng.integers(-3, 4, size=(m, 1))
    inside = rng.normal(size=n)
    room = rng.uniform(0.0, 0.5, size=m) * np.linalg.norm(rows, axis=1)
    return root @ root.T + 0.05 * np.eye(n), rng.normal(size=n), rows, rows @ inside + room


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_solution_meets_the_optimality_conditions(seed):
    hessian, gradient, rows, bounds = random_program(seed)
    found = solve_quadratic(cholesky(hessian), gradient, rows, bounds)
    lengths = np.linalg.norm(rows, axis=1)
    assert np.all(rows @ found[0] - bounds <= 1e-7 * lengths)
    assert np.all(found[1] >= 0.0)
    scale = 1.0 + np.abs(gradient).max() + np.abs(hessian @ found[0]).max()
    stationary = hessian @ found[0] + gradient + rows.T @ found[1]
    assert np.abs(stationary).max() <= 1e-6 * scale
    slack = (bounds - rows @ found[0]) * found[1]
    assert np.abs(slack).max() <= 1e-6 * scale


def test_contradictions_are_told_apart():
    rows = np.array([[1.0], [-1.0]])
    assert solve_quadratic(cholesky(np.eye(1)), np.zeros(1), rows, np.array([-1.0, -1.0])) is None
    assert solve_quadratic(cholesky(np.eye(1)), np.zeros(1), rows, np.array([1.0, -1.0]))[0] == [
        pytest.approx(1.0)
    ]
