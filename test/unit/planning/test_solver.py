# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The solver and its quadratic programs: right optima, honest ends."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from support.motion_programs import BASES, compile_motion

from mp_pca_planner.planning.options import SolverOptions
from mp_pca_planner.planning.program.motion_program import MotionProgram
from mp_pca_planner.planning.solver import (
    FEASIBLE,
    cholesky,
    solve,
    solve_quadratic,
    trust_region_step,
)


@dataclass
class MadeUpPoint:
    """A sum of squares with few constraints, given whole."""

    residual: np.ndarray
    jacobian: np.ndarray
    inequalities: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    rows: np.ndarray
    equalities: np.ndarray
    equality_rows: np.ndarray

    @property
    def cost(self):
        return 0.5 * float(self.residual @ self.residual)

    @property
    def gradient(self):
        return self.jacobian.T @ self.residual

    @property
    def hessian(self):
        return self.jacobian.T @ self.jacobian

    def inequality_rows(self, chosen, values=None):
        return self.rows[chosen]

    def inequalities_after(self, step):
        return self.inequalities + self.rows @ step


class Rosenbrock:
    """A curved valley as a sum of squares, with the least value 1/2 at (1, 1).

    Optionally with x₁ ≤ `wall`, and on the circle ‖x‖ = `circle`.
    """

    def __init__(self, wall=np.inf, circle=None):
        self.wall, self.circle = wall, circle

    def equalities_at(self, x):
        return self.evaluate(x).equalities

    def evaluate(self, x):
        on_circle = self.circle is not None
        return MadeUpPoint(
            residual=np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0], 1.0]),
            jacobian=np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0], [0.0, 0.0]]),
            inequalities=x[:1],
            lower=np.array([-np.inf]),
            upper=np.array([self.wall]),
            rows=np.array([[1.0, 0.0]]),
            equalities=np.array([x @ x - self.circle**2] if on_circle else []),
            equality_rows=np.array([2.0 * x]) if on_circle else np.zeros((0, 2)),
        )


def test_a_bound_in_the_valley_is_met():
    solution = solve(Rosenbrock(wall=0.5), np.array([-1.2, 1.0]), SolverOptions(tolerance=1e-12))
    assert solution.converged
    np.testing.assert_allclose(solution.unknowns, [0.5, 0.25], atol=1e-6)
    assert solution.kkt_residual < 1e-4


@settings(max_examples=50, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(0.0, 6.28))
def test_an_equality_holds_and_no_point_of_it_nearby_is_better(circle, angle):
    program = Rosenbrock(circle=circle)
    start = 2.0 * np.array([np.cos(angle), np.sin(angle)])
    solution = solve(program, start, SolverOptions(tolerance=1e-10, max_iterations=300))
    assert solution.converged
    x = solution.unknowns
    assert np.linalg.norm(x) == pytest.approx(circle, abs=1e-6)
    turns = np.arctan2(x[1], x[0]) + np.linspace(-1e-2, 1e-2, 201)
    costs = [program.evaluate(circle * np.array([np.cos(a), np.sin(a)])).cost for a in turns]
    assert solution.cost <= min(costs) * (1.0 + 1e-6)


def test_equalities_and_bounds_that_contradict_each_other_are_said():
    # The circle of radius 3 meets x₁ ≤ −4 nowhere.
    solution = solve(Rosenbrock(wall=-4.0, circle=3.0), np.array([-2.0, 1.0]))
    assert not solution.converged
    assert solution.infeasibility > 0.5


def unlimited(basis, seed=0, rho=0.0):
    """The problem of a motion without limits, and the motion."""
    segment, motion = compile_motion(basis, seed)
    segment.precision = rho * np.eye(segment.expected.size)
    return MotionProgram([segment], [[]]), motion


@pytest.mark.parametrize(
    "how",
    [
        {"options": SolverOptions(max_iterations=2)},
        {"is_late": lambda ahead: ahead > 0.0},
    ],
)
def test_running_out_of_iterations_or_time_is_said_and_never_worse_than_the_start(how):
    program, motion = unlimited(BASES["joint"])
    start = motion.weights / program.segments[0].unknowns.scales
    solution = solve(program, start, **how)
    assert not solution.converged
    assert solution.cost <= program.evaluate(start).cost


def test_an_early_end_is_at_a_point_within_the_constraints_if_one_was_passed():
    class InDisc(Rosenbrock):
        def evaluate(self, x):
            at = super().evaluate(x)
            return replace(at, inequalities=np.array([x @ x]), rows=np.array([2.0 * x]))

    disc, start = InDisc(wall=1.0), np.array([-0.6, 0.2])
    # Steps along the edge of the disc leave it.
    evaluated = []
    for n in range(1, 20):
        found = solve(disc, start, SolverOptions(max_iterations=n))
        assert found.unknowns @ found.unknowns <= 1.0 + FEASIBLE
        assert found.infeasibility == max(found.unknowns @ found.unknowns - 1.0, 0.0)
        evaluated.append(found.cost)
    assert evaluated[0] == InDisc().evaluate(start).cost
    assert np.all(np.diff(evaluated) <= 1e-6)
    best = minimize(
        lambda x: disc.evaluate(x).cost,
        start,
        constraints={"type": "ineq", "fun": lambda x: 1.0 - x @ x},
    )
    assert evaluated[-1] == pytest.approx(best.fun, rel=1e-4)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_a_trust_region_step_solves_its_subproblem(seed, radius):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    root = rng.normal(size=(n, n))
    hessian, gradient = root + root.T, rng.normal(size=n)
    step, shift = trust_region_step(hessian, gradient, radius)
    assert shift >= 0.0
    assert np.linalg.eigvalsh(hessian + shift * np.eye(n))[0] > 0.0
    assert np.linalg.norm(step) <= 1.06 * radius
    model = gradient @ step + 0.5 * step @ hessian @ step
    # No better than the best of many points in the region by more than the radius is loose.
    others = rng.normal(size=(2000, n))
    others *= (radius * rng.uniform(size=2000) ** (1 / n) / np.linalg.norm(others, axis=1))[:, None]
    values = others @ gradient + 0.5 * np.einsum("ij,jk,ik->i", others, hessian, others)
    assert model <= values.min() + 0.12 * abs(values.min())


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
