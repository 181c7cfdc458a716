# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Structured quasi-Newton method for nonlinear programs, by sequential quadratic programming.

The program provides the known part of its Hessian, RᵀR of a sum of squares. Gravity keeps the
residual of efforts large at the optimum, which makes plain Gauss–Newton slow. The rest S of the
Lagrangian's Hessian is estimated from the steps taken by the update of Dennis, Gay and Welsch ("An
adaptive nonlinear least-squares algorithm", ACM TOMS 7(3), 1981), inside a trust region.

Of each step, a normal part meets the equalities; the rest lies in their null space (Byrd and
Omojokun; Nocedal and Wright, "Numerical Optimization", 2006, section 18.5). Only inequalities that
the step would violate otherwise enter its quadratic program. An exact penalty judges the step.

A program is: minimise f(x) subject to l ≤ c(x) ≤ u and e(x) = 0. Its unknowns x (weights, a goal
configuration, a log duration, …) are to be scaled so that usual steps are of order 1, its
inequalities to shares of their bounds, its equalities to SI units. Inequalities of one limit along
a motion are neighbours: of several adjacent violations, only the largest is needed as a constraint.
The solver reads nothing of a :class:`.MotionProgram` but `lower`, `upper`, `evaluate` and
`equalities_at`, and all but `linear` of a :class:`.MotionPoint`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..lazy import LazyModule
from .options import SolverOptions

lapack = LazyModule("scipy.linalg.lapack")

if TYPE_CHECKING:
    from .program.motion_program import MotionPoint, MotionProgram

FEASIBLE = 1e-6
"""Sum of constraint violations that counts as rounding, in shares of the limits and SI units."""

ROUNDING = 1e-9
"""Violation of an inequality that counts as rounding."""

# Evaluations of curved equalities in the correction of a step.
_MAX_CORRECTIONS = 4
# Rounds of adding constraints to a quadratic program, and of damping a step that is too long.
_MAX_ROUNDS, _MAX_DAMPINGS = 20, 8
# Share of the trust region that a step towards the equalities may take.
_NORMAL_SHARE = 0.8
# First radius of the trust region with equalities, which may be far more curved, and the radius at
# which the search ends.
_FIRST_RADIUS_TO_EQUALITIES, _MIN_RADIUS = 10.0, 1e-9
# Share of the predicted change of the gradient in the scale of the curvature's update: it steadies
# the update as Powell's damping does. It took the fewest passes on four arms.
_EXPECTED_SHARE = 0.3
# Below this cosine of the angle between a step and the change of the gradient, the curvature is not
# updated: the update would be out of proportion.
_MIN_COSINE = 0.05
# Singular values of equalities, relative to the largest, that count as 0.
_DEPENDENT = 1e-9


SolverMemory = tuple[FloatArray, float, NDArray[np.intp]]
"""State of a solver, for a warm start.

The estimate S of the unknown part of the Lagrangian's Hessian, shape (n, n); the radius of the
trust region; the sides of the inequalities that were active, shape (n_active,), see :class:`Step`.
"""


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of the solver.

    Attributes
    ----------
    unknowns : array, shape (n,)
        The best x found.
    cost : float
        The objective there.
    infeasibility : float
        Sum of the constraint violations.
    converged : bool
        Whether the tolerance was reached within the constraints. Otherwise iterations or time
        ran out, or the constraints can't be met.
    iterations : int
        Evaluations of the program.
    kkt_residual : float
        Norm of the Lagrangian's gradient, as a share of the objective.
    start_cost : float
        Objective at the start.
    memory : SolverMemory
        State from which to continue after a small change of the program.
    """

    unknowns: FloatArray
    cost: float
    infeasibility: float
    converged: bool
    iterations: int
    kkt_residual: float
    start_cost: float
    memory: SolverMemory


def solve(
    program: MotionProgram,
    start: FloatArray,
    options: SolverOptions = SolverOptions(),
    memory: SolverMemory | None = None,
    is_late: Callable[[float], bool] = lambda ahead: False,
) -> Solution:
    """Find a local minimum within the constraints, by descent from a start.

    Parameters
    ----------
    program : MotionProgram
        The program to solve.
    start : array, shape (n,)
        Unknowns to start from; they may violate constraints.
    options : SolverOptions
        When to stop.
    memory : SolverMemory, optional
        State at an earlier solution of nearly the same program.
    is_late : callable
        Called after each step with its duration [s], because another one is expected to take as
        long; True ends the search; never unless given.

    Returns
    -------
    solution : Solution
        The solution; without constraints its cost never exceeds that of the start.
    """
    search = _Search(program, start, options, memory, is_late)
    converged = search.run()
    x, here, violated = search.x, search.here, search.violated
    if violated > options.feasible and search.feasible is not None:
        # An early end between two points within the constraints.
        x, here = search.feasible
        violated = infeasibility(program, here)
    return Solution(
        unknowns=x,
        cost=here.cost,
        infeasibility=violated,
        converged=converged,
        iterations=search.iterations,
        kkt_residual=float(np.linalg.norm(search.pull)) / max(here.cost, TINY),
        start_cost=search.start_cost,
        memory=(search.curvature, search.radius, search.sides),
    )


def _tangent(here: MotionPoint, radius: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The steps normal + directions · y, for any y, that meet the linearised equalities.

    Returns
    -------
    normal : array, shape (n,)
        The normal step, inside the trust region.
    directions : array, shape (n, n_free)
        Orthonormal directions along the equalities.
    pseudo_inverse : array, shape (n, n_equalities)
        E⁺ of the equalities' rows E.
    """
    left, singular, right = np.linalg.svd(here.equality_rows)
    rank = int(np.count_nonzero(singular > _DEPENDENT * singular[0]))
    inverse = right[:rank].T @ (left[:, :rank] / singular[:rank]).T
    normal = -inverse @ here.equalities
    # Far from the equalities, the step is shortened to the trust region.
    length = float(np.linalg.norm(normal))
    normal *= min(1.0, _NORMAL_SHARE * radius / max(length, TINY))
    return normal, right[rank:].T, inverse


@dataclass(frozen=True, eq=False)
class Step:
    """A step and the predictions of the quadratic model for it.

    Attributes
    ----------
    change : array, shape (n,)
        The step.
    decrease : float
        Predicted decrease of the objective.
    infeasibility : float
        Predicted sum of the constraint violations after it.
    sides : array of int, shape (n_active,)
        Sides of the active inequalities, see `violated_sides`.
    multipliers, equality_multipliers : array
        Lagrange multipliers of these and of the equalities.
    pull : array, shape (n,)
        Gradient of the Lagrangian at the start of the step.
    damping : float
        Value added to the diagonal of the Hessian to limit the step.
    """

    change: FloatArray
    decrease: float
    infeasibility: float
    sides: NDArray[np.intp]
    multipliers: FloatArray
    equality_multipliers: FloatArray
    pull: FloatArray
    damping: float


class Held(NamedTuple):
    """A step within few inequalities.

    Attributes
    ----------
    step : array, shape (n_free,)
        The step y of the free unknowns.
    multipliers : array, shape (n_inequalities,)
        Lagrange multipliers of the inequalities.
    damping : float
        Value added to the diagonal of the Hessian to limit the step.
    is_within : bool
        Whether the inequalities are met; otherwise they contradict each other.
    """

    step: FloatArray
    multipliers: FloatArray
    damping: float
    is_within: bool


class Subproblem:
    """The quadratic model of a program at a point, in the trust region.

    Its unknowns are y with the step `normal + directions · y`, or the step itself where there
    are no equalities.

    Parameters
    ----------
    program : MotionProgram
        The program.
    here : MotionPoint
        The point.
    hessian : array, shape (n, n)
        Hessian of the Lagrangian.
    radius : float
        Radius of the trust region.
    sides : array of int
        Sides of inequalities to consider first: those that were active in the step before.
    """

    def __init__(
        self,
        program: MotionProgram,
        here: MotionPoint,
        hessian: FloatArray,
        radius: float,
        sides: NDArray[np.intp],
    ) -> None:
        self._program, self._here, self._whole = program, here, hessian
        self._tangent = _tangent(here, radius) if here.equalities.size else None
        self._hessian, self._gradient, self._radius = hessian, here.gradient, radius
        if self._tangent is not None:
            normal, directions, _ = self._tangent
            self._hessian = directions.T @ hessian @ directions
            self._gradient = directions.T @ (here.gradient + hessian @ normal)
            self._radius = math.sqrt(max(radius**2 - float(normal @ normal), 0.0))
        self._sides = sides if self._gradient.size else sides[:0]
        self._rows, self._bounds = _at_sides(program, here, self._sides)
        # The step within the given sides alone.
        if self._sides.size:
            self._first = self._held(self._rows, self._bounds, 0.0)
        else:
            has_free = bool(self._gradient.size)
            self._first = Held(self._free[0], np.zeros(0), 0.0, has_free)

    def within_sides(self) -> tuple[float, FloatArray]:
        """What the step within the given sides alone predicts.

        Returns
        -------
        decrease : float
            Predicted decrease of the objective. Within all inequalities it is at most as large. It
            is infinite if no such step was found.
        pull : array, shape (n_free,)
            Gradient of the Lagrangian along the equalities, with the multipliers of that step.
        """
        pull = self._here.gradient + self._first.multipliers @ self._rows
        if self._tangent is not None:
            _, directions, _ = self._tangent
            pull = pull @ directions
        if not self._first.is_within:
            return math.inf, pull
        change = self._lifted(self._first.step)
        return -float((self._here.gradient + 0.5 * (self._whole @ change)) @ change), pull

    def solve(self) -> Step:
        """The step within the linearised constraints.

        Only few of the thousands of inequalities enter the quadratic program: the given sides, and
        those that the step would violate otherwise.
        """
        here, program, held = self._here, self._program, self._first
        sides, rows, bounds = self._sides, self._rows, self._bounds
        for left in reversed(range(_MAX_ROUNDS)):
            change = self._lifted(held.step)
            after = here.inequalities_after(change)
            outside = outside_bounds(program, after)
            if not (outside.max(initial=0.0) > ROUNDING and held.is_within and left):
                break
            broken = violated_sides(program, after, outside)
            added = broken[~(broken[:, None] == sides).any(axis=1)]
            if not added.size:
                break
            kept = held.multipliers > 0.0
            new_rows, new_bounds = _at_sides(program, here, added)
            sides = np.concatenate([sides[kept], added])
            rows = np.concatenate([rows[kept], new_rows])
            bounds = np.concatenate([bounds[kept], new_bounds])
            held = self._held(rows, bounds, held.damping)
        holding = held.multipliers > 0.0
        multipliers = held.multipliers[holding]
        curved = self._whole @ change
        pull = here.gradient + multipliers @ rows[holding]
        equality_multipliers, missed = np.zeros(0), 0.0
        if self._tangent is not None:
            _, _, pseudo_inverse = self._tangent
            equality_multipliers = -pseudo_inverse.T @ (pull + curved)
            missed = float(np.abs(here.equalities + here.equality_rows @ change).sum())
            pull = pull + equality_multipliers @ here.equality_rows
        return Step(
            change=change,
            decrease=-float((here.gradient + 0.5 * curved) @ change),
            infeasibility=sum_of_peaks(outside) + missed,
            sides=sides[holding],
            multipliers=multipliers,
            equality_multipliers=equality_multipliers,
            pull=pull,
            damping=held.damping if sides.size else 0.0,
        )

    def correction(self, sides: NDArray[np.intp]) -> FloatArray:
        """The shortest steps that change the equalities to first order, shape (n, n_equalities).

        They keep the values of the given sides of inequalities, if these are not too many.
        """
        equalities = self._here.equality_rows
        n_equalities, n = equalities.shape
        if n_equalities + sides.size > n:
            sides = sides[:0]
        rows = np.concatenate([equalities, self._here.inequality_rows(sides // 2)])
        changes = np.eye(len(rows))[:, :n_equalities]
        return np.asarray(np.linalg.lstsq(rows, changes, rcond=_DEPENDENT)[0])

    def _lifted(self, y: FloatArray) -> FloatArray:
        if self._tangent is None:
            return y
        normal, directions, _ = self._tangent
        return np.asarray(normal + directions @ y)

    @cached_property
    def _free(self) -> tuple[FloatArray, float]:
        """The step without inequalities, and the shift of the Hessian for it."""
        return trust_region_step(self._hessian, self._gradient, self._radius)

    @cached_property
    def _convex(self) -> tuple[FloatArray, FloatArray | None]:
        """The Hessian made positive definite, and its factor."""
        return convex_factor(self._hessian)

    def _held(self, rows: FloatArray, bounds: FloatArray, damping: float) -> Held:
        """The step within inequalities rows · step ≤ bounds of the whole step.

        The given damping is raised until the step is not much longer than the trust region. A step
        that is still longer is shortened.
        """
        if self._tangent is not None:
            normal, directions, _ = self._tangent
            rows, bounds = rows @ directions, bounds - rows @ normal
        hessian, first_factor = self._convex
        longest = 1.5 * self._radius
        for _ in range(_MAX_DAMPINGS):
            factor = cholesky(hessian, damping) if damping else first_factor
            found = solve_quadratic(factor, self._gradient, rows, bounds)
            if found is None:
                regular = hessian + damping * np.eye(len(hessian)) if damping else hessian
                step, multipliers = nearest_step(regular, self._gradient, rows, bounds)
            else:
                step, multipliers = found
            length = math.sqrt(float(step @ step))
            if length <= longest or found is None:
                break
            least = max(0.03 * self._free[1], 1e-4 * float(np.trace(hessian)) / len(hessian))
            damping = max(4.0 * damping, least)
        share = min(1.0, longest / max(length, TINY))
        return Held(share * step, multipliers, damping, found is not None)


def _at_sides(
    program: MotionProgram, at: MotionPoint, sides: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of sides of inequalities, with signs such that all are bounded above.

    With them their distances from the bounds, negative beyond them.
    """
    if not sides.size:
        return np.zeros((0, at.gradient.size)), np.zeros(0)
    index, signs = sides // 2, np.where(sides % 2, 1.0, -1.0)
    bounds = np.where(sides % 2, program.upper[index], program.lower[index])
    rows = signs[:, None] * at.inequality_rows(index, bounds)
    return rows, signs * (bounds - at.inequalities[index])


class _Search:
    """The state of a search, advanced step by step."""

    def __init__(
        self,
        program: MotionProgram,
        start: FloatArray,
        options: SolverOptions,
        memory: SolverMemory | None,
        is_late: Callable[[float], bool],
    ) -> None:
        self._program, self._options, self._is_late = program, options, is_late
        self._last_step = time.perf_counter()
        self.x, self.here = start, program.evaluate(start)
        self.violated = infeasibility(program, self.here)
        self.start_cost, self.pull = self.here.cost, self.here.gradient
        self.weight, self.iterations = 0.0, 1
        self.feasible = (self.x, self.here) if self.violated <= options.feasible else None
        if memory is None:
            curved = bool(self.here.equalities.size)
            radius = _FIRST_RADIUS_TO_EQUALITIES if curved else options.first_radius
            memory = self.here.hessian * 0.0, radius, np.zeros(0, dtype=np.intp)
        self.curvature, self.radius, self.sides = memory

    def run(self) -> bool:
        """Take steps until one is negligible, or time or iterations run out.

        Returns
        -------
        converged : bool
            Whether the last step was negligible, within the constraints.
        """
        options, converged = self._options, self.x.size == 0
        while not converged and self.iterations < options.max_iterations:
            hessian = self.here.hessian + self.curvature
            enough = options.tolerance * self.here.cost
            try:
                subproblem = Subproblem(self._program, self.here, hessian, self.radius, self.sides)
                is_feasible = self.violated <= options.feasible
                largest, pull = subproblem.within_sides()
                converged = is_feasible and largest <= enough
                if converged:
                    self.pull = pull
                    break
                step = subproblem.solve()
            except np.linalg.LinAlgError:  # numbers overflow: there is no better point from here
                break
            self.pull, self.sides = step.pull, step.sides
            # An exact penalty needs a weight above every multiplier. It may fall again (Powell, "A
            # fast algorithm for nonlinearly constrained optimization calculations", 1978).
            multipliers = np.concatenate([step.multipliers, np.abs(step.equality_multipliers)])
            least = 2.0 * float(multipliers.max(initial=0.0))
            self.weight = max(least, 0.5 * (self.weight + least))
            predicted = step.decrease + self.weight * (self.violated - step.infeasibility)
            negligible = predicted <= enough
            converged = negligible and is_feasible
            restores = self.violated - step.infeasibility > options.feasible
            stuck = (negligible and not restores) or self.radius < _MIN_RADIUS
            before, self._last_step = self._last_step, time.perf_counter()
            if converged or stuck or self._is_late(self._last_step - before):
                break
            self._take(step, subproblem, predicted)
        return converged

    def _take(self, step: Step, subproblem: Subproblem, predicted: float) -> None:
        """Evaluate a step, update the curvature, accept the step if it lowers the penalty."""
        if self.here.equalities.size:
            step = self._restored(step, subproblem)
        there = self._program.evaluate(self.x + step.change)
        self.iterations += 1
        violated = infeasibility(self._program, there)
        decrease = self.here.cost - there.cost + self.weight * (self.violated - violated)
        length = math.sqrt(float(step.change @ step.change))
        if not decrease >= 0.25 * predicted:  # a NaN must shrink the radius, too
            self.radius = 0.25 * length
        elif decrease > 0.75 * predicted and (step.damping > 0.0 or length > 0.8 * self.radius):
            self.radius = 2.0 * max(length, self.radius)
        if step.infeasibility <= self._options.feasible:  # otherwise, multipliers may be penalties
            self.curvature = self._learned(step, there)
        if decrease > 0.0:
            self.x, self.here, self.violated = self.x + step.change, there, violated
            if violated <= self._options.feasible:
                self.feasible = self.x, there

    def _restored(self, step: Step, subproblem: Subproblem) -> Step:
        """The step, corrected along the equalities where they are curved, before its evaluation.

        Corrections are kept while they shrink the error of the linear prediction.
        """
        change, longest = step.change, 0.5 * float(np.linalg.norm(step.change))
        predicted, least = self.here.equalities + self.here.equality_rows @ change, np.inf
        correction = subproblem.correction(step.sides)
        for _ in range(_MAX_CORRECTIONS):
            missed = self._program.equalities_at(self.x + change) - predicted
            error = float(np.abs(missed).sum())
            if not error < 0.5 * least:
                break
            step, least = replace(step, change=change), error
            back = -correction @ missed
            if error <= 0.1 * FEASIBLE or float(np.linalg.norm(back)) > longest:
                break
            change = change + back
        return step

    def _learned(self, step: Step, there: MotionPoint) -> FloatArray:
        """The estimate S of the curvature after the Dennis–Gay–Welsch update along a step."""
        if not np.isfinite(there.cost):
            return self.curvature
        change, curvature = step.change, self.curvature
        # The Lagrangian's gradient there, with the multipliers of the step.
        pull = there.gradient
        if step.sides.size:
            signed = np.where(step.sides % 2, step.multipliers, -step.multipliers)
            pull = pull + signed @ there.inequality_rows(step.sides // 2)
        if step.equality_multipliers.size:
            pull = pull + step.equality_multipliers @ there.equality_rows
        turned = pull - step.pull
        # S must map the step to the change of the gradient that the known part does not explain.
        known = 0.5 * ((self.here.hessian + there.hessian) @ change)
        unknown = turned - known
        curved = curvature @ change
        size = abs(float(change @ curved))
        if size > 0.0:
            # Sizing: an S that was estimated at larger residuals is too large here.
            factor = min(1.0, abs(float(change @ unknown)) / size)
            curvature, curved = curvature * factor, curved * factor
        share = _EXPECTED_SHARE
        scale = (1.0 - share) * turned + share * (known + curved)
        along = float(change @ scale)
        lengths = float(change @ change) * float(scale @ scale)
        if not along > _MIN_COSINE * math.sqrt(lengths):
            return curvature
        error = (unknown - curved) / along
        # E cᵀ + c Eᵀ − (E·step/along) c cᵀ, c the scale; the last term shared out to the others.
        half = error - (0.5 * float(error @ change) / along) * scale
        cross = half[:, None] * scale
        return np.asarray(curvature + cross + cross.T)


def infeasibility(program: MotionProgram, at: MotionPoint) -> float:
    """Sum of the violations of all constraints."""
    outside = outside_bounds(program, at.inequalities)
    return sum_of_peaks(outside) + float(np.abs(at.equalities).sum())


def outside_bounds(program: MotionProgram, values: FloatArray) -> FloatArray:
    """Distances of inequalities beyond their nearer bounds, negative within them."""
    outside: FloatArray = values - program.upper
    return np.maximum(outside, program.lower - values, out=outside)


def sum_of_peaks(outside: FloatArray) -> float:
    """Sum of the largest violations of each arc of neighbours, of distances beyond bounds."""
    where = np.flatnonzero(outside > 0.0)
    if not where.size:
        return 0.0
    starts = np.append(0, np.flatnonzero(where[1:] - where[:-1] > 1) + 1)
    return float(np.maximum.reduceat(outside[where], starts).sum())


def violated_sides(
    program: MotionProgram, values: FloatArray, outside: FloatArray
) -> NDArray[np.intp]:
    """Sides of inequalities at peaks of violation, and of their neighbours.

    The neighbours are included because a constrained peak often moves by one point. Side 2i is the
    lower bound of inequality i, 2i + 1 the upper one.
    """
    broken = np.flatnonzero(outside > ROUNDING)
    if not broken.size:
        return broken
    by, last = outside[broken], outside.size - 1
    rises = (by > outside[broken - 1]) | (broken == 0)
    peaks = broken[rises & (by >= outside[np.minimum(broken + 1, last)])]
    near = np.concatenate([peaks, peaks - 1, peaks + 1])
    near = near[(near >= 0) & (near <= last)]
    return np.asarray(2 * near + (values[near] - program.upper[near] == outside[near]))


TINY = float(np.finfo(float).tiny)
"""Avoids divisions by zero."""

# Squared distance to infeasibility that counts as rounding, in units of the scaled right-hand side.
_INFEASIBLE = 1e-12


def cholesky(matrix: FloatArray, shift: float = 0.0) -> FloatArray | None:
    """The lower factor of H + shift·I; None if that is not positive definite."""
    moved = matrix + shift * np.eye(len(matrix)) if shift else matrix
    lower, failed = lapack.dpotrf(moved, lower=1)
    return None if failed else lower


def _solved(lower: FloatArray, right: FloatArray, transposed: int = 0) -> FloatArray:
    """L⁻¹ or L⁻ᵀ times a matrix or vector."""
    found, _ = lapack.dtrtrs(lower, right, lower=1, trans=transposed)
    return np.asarray(found)


def solve_quadratic(
    factor: FloatArray | None, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Minimise ½pᵀHp + gᵀp subject to A p ≤ b.

    Parameters
    ----------
    factor : array, shape (n, n), or None
        Lower Cholesky factor of H; None if that is not positive definite.
    gradient : array, shape (n,)
        g.
    rows : array, shape (m, n)
        A.
    bounds : array, shape (m,)
        b.

    Returns
    -------
    solution : tuple of (array, shape (n,), array, shape (m,)), or None
        The minimiser, and the Lagrange multipliers of the constraints, not negative. None if the
        constraints contradict each other (or H is not positive definite).
    """
    # Imported here for a fast start of the node.
    from scipy.optimize import nnls

    if factor is None:
        return None
    n = len(gradient)
    # With u = Lᵀp + L⁻¹g the objective is ½‖u‖² up to a constant.
    whole = np.empty((n, 1 + len(bounds)), order="F")
    whole[:, 0], whole[:, 1:] = gradient, rows.T
    whole = _solved(factor, whole)
    shifted, whitened = whole[:, 0], whole[:, 1:]
    # Rows are scaled to unit length, which reduces rounding errors.
    lengths = np.maximum(np.sqrt(np.sum(whitened * whitened, axis=0)), 1e-12)
    system = np.empty((n + 1, len(bounds)))
    np.divide(whitened, -lengths, out=system[:n])
    np.divide(bounds + shifted @ whitened, -lengths, out=system[n])
    target = np.zeros(n + 1)
    target[n] = 1.0
    try:
        dual, _ = nnls(system, target)
    except (RuntimeError, ValueError):  # nearly dependent rows, or rows that are not finite
        return None
    residual = system @ dual - target
    if -residual[n] <= _INFEASIBLE:
        return None
    u = -residual[:n] / residual[n]
    step = _solved(factor, u - shifted, transposed=1)
    return step, dual / -residual[n] / lengths


def nearest_step(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A step with small violations of contradicting constraints, and their penalties."""
    broken = bounds < 0.0
    if not broken.any():  # the constraints are consistent, but the program was not solved
        step = np.asarray(np.linalg.solve(hessian, -gradient))
        broken = rows @ step > bounds
        if not broken.any():
            return step, np.zeros(len(bounds))
    matrix = rows[broken]
    penalty = 1e3 * float(np.trace(hessian)) / max(float(np.sum(matrix**2)), TINY)
    regular = hessian + penalty * matrix.T @ matrix
    step = np.asarray(np.linalg.solve(regular, penalty * matrix.T @ bounds[broken] - gradient))
    return step, np.where(broken, penalty * np.maximum(rows @ step - bounds, 0.0), 0.0)


def convex_factor(hessian: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """The matrix, if needed with the absolute values of its eigenvalues, and its lower factor."""
    factor = cholesky(hessian)
    if factor is not None:
        return hessian, factor
    eigenvalues, vectors = np.linalg.eigh(hessian)
    sizes = np.abs(eigenvalues)
    convex = np.asarray((vectors * np.maximum(sizes, 1e-10 * sizes.max())) @ vectors.T)
    return convex, cholesky(convex)


def trust_region_step(
    hessian: FloatArray, gradient: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """Minimise gᵀp + ½pᵀHp over ‖p‖ ≤ radius.

    After Moré and Sorensen (SIAM J. Sci. Stat. Comput. 4(3), 1983).

    Parameters
    ----------
    hessian : array, shape (n, n)
        Symmetric H, may be indefinite.
    gradient : array, shape (n,)
        g.
    radius : float
        Radius of the trust region.

    Returns
    -------
    step : array, shape (n,)
        The minimiser p; its length meets the radius to a few percent.
    shift : float
        The μ ≥ 0 with (H + μI)p = −g.
    """
    if not gradient.size:
        return gradient, 0.0
    _, newton, failed = lapack.dposv(hessian, gradient)
    if not failed and newton @ newton <= radius**2:
        return -newton, 0.0
    eigenvalues, vectors = np.linalg.eigh(hessian)
    rotated = vectors.T @ gradient
    margin = 1e-10 * max(float(np.abs(eigenvalues).max()), 1e-300)
    shift = lowest = max(0.0, margin - float(eigenvalues[0]))
    for _ in range(50):
        step = rotated / (eigenvalues + shift)
        length = float(np.linalg.norm(step))
        excess = length / radius - 1.0
        if abs(excess) < 0.05 or (excess < 0.0 and shift == lowest):
            break
        # Newton's method on 1/‖p(μ)‖, which is nearly linear in μ.
        slope = float(np.sum(step**2 / (eigenvalues + shift))) / length
        shift = max(lowest, shift + excess * length / slope)
    step = -rotated / (eigenvalues + shift)
    return vectors @ step, shift
