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
The solver calls `evaluate` and `equalities_at` of a :class:`.MotionProgram`, and reads all but
`linear` of a :class:`.MotionPoint`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

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
    memory : SolverMemory
        State from which to continue after a small change of the program.
    """

    unknowns: FloatArray
    cost: float
    infeasibility: float
    converged: bool
    iterations: int
    kkt_residual: float
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
    x, here, iterations, weight = start, program.evaluate(start), 1, 0.0
    violated, pull = infeasibility(here), here.gradient
    feasible = (x, here) if violated <= options.feasible else None
    if memory is None:
        radius = _FIRST_RADIUS_TO_EQUALITIES if here.equalities.size else options.first_radius
        memory = here.hessian * 0.0, radius, np.zeros(0, dtype=np.intp)
    curvature, radius, sides = memory
    converged, last_step = x.size == 0, time.perf_counter()
    before_step: tuple[FloatArray, MotionPoint] | None = None
    while not converged and iterations < options.max_iterations:
        is_feasible, enough = violated <= options.feasible, options.tolerance * here.cost
        hessian = here.hessian + curvature
        try:
            step = next_step(here, hessian, radius, sides, enough if is_feasible else -math.inf)
        except np.linalg.LinAlgError:  # numbers overflow: there is no better point from here
            break
        pull, converged = step.pull, step.is_negligible
        if converged:
            break
        sides = step.sides
        # An exact penalty needs a weight above every multiplier. It may fall again (Powell, "A
        # fast algorithm for nonlinearly constrained optimization calculations", 1978).
        multipliers = np.concatenate([step.multipliers, np.abs(step.equality_multipliers)])
        least = 2.0 * float(multipliers.max(initial=0.0))
        weight = max(least, 0.5 * (weight + least))
        predicted = step.decrease + weight * (violated - step.infeasibility)
        converged = predicted <= enough and is_feasible
        restores = violated - step.infeasibility > options.feasible
        stuck = (predicted <= enough and not restores) or radius < _MIN_RADIUS
        before, last_step = last_step, time.perf_counter()
        back = before_step if stuck and options.goes_back and not is_feasible else None
        if converged or (stuck and back is None) or is_late(last_step - before):
            break
        if back is not None:  # from here, the linearised constraints contradict each other
            away, (x, here), before_step = x - back[0], back, None
            violated, radius = infeasibility(here), 0.25 * math.sqrt(float(away @ away))
            continue
        if here.equalities.size:
            step = _restored(program, x, here, step)
        there = program.evaluate(x + step.change)
        iterations, after = iterations + 1, infeasibility(there)
        decrease = here.cost - there.cost + weight * (violated - after)
        length = math.sqrt(float(step.change @ step.change))
        if not decrease >= 0.25 * predicted:  # a NaN must shrink the radius, too
            radius = 0.25 * length
        elif decrease > 0.75 * predicted and (step.damping > 0.0 or length > 0.8 * radius):
            radius = 2.0 * max(length, radius)
        if step.infeasibility <= options.feasible:  # otherwise, multipliers may be penalties
            curvature = _learned(curvature, here, step, there)
        if decrease > 0.0:
            before_step = x, here
            x, here, violated = x + step.change, there, after
            if violated <= options.feasible:
                feasible = x, there
    if violated > options.feasible and feasible is not None:
        # An early end between two points within the constraints.
        x, here = feasible
        violated = infeasibility(here)
    residual = float(np.linalg.norm(pull)) / max(here.cost, TINY)
    memory = curvature, radius, sides
    return Solution(x, here.cost, violated, converged, iterations, residual, memory)


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
    is_negligible : bool
        Whether the objective decreases by too little to go on.
    """

    change: FloatArray
    decrease: float
    infeasibility: float
    sides: NDArray[np.intp]
    multipliers: FloatArray
    equality_multipliers: FloatArray
    pull: FloatArray
    damping: float
    is_negligible: bool = False


def next_step(
    here: MotionPoint,
    hessian: FloatArray,
    radius: float,
    sides: NDArray[np.intp],
    enough: float,
) -> Step:
    """The step within the linearised constraints.

    Only few of the thousands of inequalities enter the quadratic program: the given sides, and
    those that the step would violate otherwise.

    Parameters
    ----------
    here : MotionPoint
        The point.
    hessian : array, shape (n, n)
        Hessian of the Lagrangian.
    radius : float
        Radius of the trust region.
    sides : array of int
        Sides of inequalities to consider first: those that were active in the step before.
    enough : float
        The step is negligible if the objective decreases by at most this within the given sides
        alone. Within all inequalities it decreases at most as much.
    """
    model = _Model(here, hessian, radius)
    sides = sides if model.gradient.size else sides[:0]
    rows, bounds = _at_sides(here, sides)
    change, multipliers, damping, is_within = model.step_within(rows, bounds, 0.0)
    decrease = -float((here.gradient + 0.5 * (hessian @ change)) @ change)
    if is_within and decrease <= enough:
        pull = model.along(here.gradient + multipliers @ rows)
        none = np.zeros(0)
        return Step(change, decrease, 0.0, sides, multipliers, none, pull, damping, True)
    for left in reversed(range(_MAX_ROUNDS)):
        after = here.inequalities_after(change)
        outside = outside_bounds(here, after)
        if not (outside.max(initial=0.0) > ROUNDING and is_within and left):
            break
        broken = violated_sides(here, after, outside)
        added = broken[~(broken[:, None] == sides).any(axis=1)]
        if not added.size:
            break
        kept = multipliers > 0.0
        new_rows, new_bounds = _at_sides(here, added)
        sides = np.concatenate([sides[kept], added])
        rows = np.concatenate([rows[kept], new_rows])
        bounds = np.concatenate([bounds[kept], new_bounds])
        change, multipliers, damping, is_within = model.step_within(rows, bounds, damping)
    holding = multipliers > 0.0
    multipliers, curved = multipliers[holding], hessian @ change
    pull = here.gradient + multipliers @ rows[holding]
    equality_multipliers, missed = np.zeros(0), 0.0
    if here.equalities.size:
        equality_multipliers = -model.inverse.T @ (pull + curved)
        missed = float(np.abs(here.equalities + here.equality_rows @ change).sum())
        pull = pull + equality_multipliers @ here.equality_rows
    return Step(
        change,
        -float((here.gradient + 0.5 * curved) @ change),
        sum_of_peaks(outside) + missed,
        sides[holding],
        multipliers,
        equality_multipliers,
        pull,
        damping if sides.size else 0.0,
    )


class _Model:
    """The quadratic model of a program at a point, in the trust region.

    Its unknowns are y with the step `normal + directions · y` along the linearised equalities, or
    the step itself where there are no equalities.
    """

    def __init__(self, here: MotionPoint, hessian: FloatArray, radius: float) -> None:
        self.hessian, self.gradient, self._radius = hessian, here.gradient, radius
        self._has_equalities = bool(here.equalities.size)
        if self._has_equalities:
            left, singular, right = np.linalg.svd(here.equality_rows)
            rank = int(np.count_nonzero(singular > _DEPENDENT * singular[0]))
            self.inverse = right[:rank].T @ (left[:, :rank] / singular[:rank]).T
            normal = -self.inverse @ here.equalities
            # Far from the equalities, the step is shortened to the trust region.
            length = float(np.linalg.norm(normal))
            normal *= min(1.0, _NORMAL_SHARE * radius / max(length, TINY))
            self._normal, self._directions = normal, right[rank:].T
            self.hessian = self._directions.T @ hessian @ self._directions
            self.gradient = self.along(here.gradient + hessian @ normal)
            self._radius = math.sqrt(max(radius**2 - float(normal @ normal), 0.0))

    def along(self, gradient: FloatArray) -> FloatArray:
        """A gradient by y."""
        return np.asarray(gradient @ self._directions) if self._has_equalities else gradient

    def _whole(self, y: FloatArray) -> FloatArray:
        return np.asarray(self._normal + self._directions @ y) if self._has_equalities else y

    @cached_property
    def _free(self) -> tuple[FloatArray, float]:
        """The step without inequalities, and the shift of the Hessian for it."""
        return trust_region_step(self.hessian, self.gradient, self._radius)

    @cached_property
    def _convex(self) -> tuple[FloatArray, FloatArray | None]:
        """The Hessian, if needed with the absolute values of its eigenvalues, and its factor."""
        factor = cholesky(self.hessian)
        if factor is not None:
            return self.hessian, factor
        eigenvalues, vectors = np.linalg.eigh(self.hessian)
        sizes = np.abs(eigenvalues)
        convex = np.asarray((vectors * np.maximum(sizes, 1e-10 * sizes.max())) @ vectors.T)
        return convex, cholesky(convex)

    def step_within(
        self, rows: FloatArray, bounds: FloatArray, damping: float
    ) -> tuple[FloatArray, FloatArray, float, bool]:
        """The step within inequalities rows · step ≤ bounds.

        The given damping is raised until the step is not much longer than the trust region. A step
        that is still longer is shortened.

        Returns
        -------
        step : array, shape (n,)
            The step.
        multipliers : array, shape (n_inequalities,)
            Lagrange multipliers of the inequalities.
        damping : float
            Value added to the diagonal of the Hessian to limit the step.
        is_within : bool
            Whether the inequalities are met; otherwise they contradict each other.
        """
        if not bounds.size:
            return self._whole(self._free[0]), bounds, 0.0, bool(self.gradient.size)
        if self._has_equalities:
            rows, bounds = rows @ self._directions, bounds - rows @ self._normal
        hessian, first_factor = self._convex
        longest = 1.5 * self._radius
        for _ in range(_MAX_DAMPINGS):
            factor = cholesky(hessian, damping) if damping else first_factor
            found = solve_quadratic(factor, self.gradient, rows, bounds)
            if found is None:
                regular = hessian + damping * np.eye(len(hessian)) if damping else hessian
                y, multipliers = nearest_step(regular, self.gradient, rows, bounds)
            else:
                y, multipliers = found
            length = math.sqrt(float(y @ y))
            if length <= longest or found is None:
                break
            least = max(0.03 * self._free[1], 1e-4 * float(np.trace(hessian)) / len(hessian))
            damping = max(4.0 * damping, least)
        share = min(1.0, longest / max(length, TINY))
        return self._whole(share * y), multipliers, damping, found is not None


def _at_sides(at: MotionPoint, sides: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Derivatives of sides of inequalities, with signs such that all are bounded above.

    With them their distances from the bounds, negative beyond them.
    """
    if not sides.size:
        return np.zeros((0, at.gradient.size)), np.zeros(0)
    index, signs = sides // 2, np.where(sides % 2, 1.0, -1.0)
    bounds = np.where(sides % 2, at.upper[index], at.lower[index])
    rows = signs[:, None] * at.inequality_rows(index, bounds)
    return rows, signs * (bounds - at.inequalities[index])


def _restored(program: MotionProgram, x: FloatArray, here: MotionPoint, step: Step) -> Step:
    """The step, corrected along the equalities where they are curved, before its evaluation.

    Corrections are the shortest, and keep the values of the active inequalities unless these are
    too many. They are kept while they shrink the error of the linear prediction.
    """
    change, longest = step.change, 0.5 * float(np.linalg.norm(step.change))
    predicted, least = here.equalities + here.equality_rows @ change, np.inf
    n_equalities, n = here.equality_rows.shape
    sides = step.sides if n_equalities + step.sides.size <= n else step.sides[:0]
    rows = np.concatenate([here.equality_rows, here.inequality_rows(sides // 2)])
    changes = np.eye(len(rows))[:, :n_equalities]
    correction = np.linalg.lstsq(rows, changes, rcond=_DEPENDENT)[0]
    for _ in range(_MAX_CORRECTIONS):
        missed = program.equalities_at(x + change) - predicted
        error = float(np.abs(missed).sum())
        if not error < 0.5 * least:
            break
        step, least = replace(step, change=change), error
        back = -correction @ missed
        if error <= 0.1 * FEASIBLE or float(np.linalg.norm(back)) > longest:
            break
        change = change + back
    return step


def _learned(
    curvature: FloatArray, here: MotionPoint, step: Step, there: MotionPoint
) -> FloatArray:
    """The estimate S of the curvature after the Dennis–Gay–Welsch update along a step."""
    if not np.isfinite(there.cost):
        return curvature
    # The Lagrangian's gradient there, with the multipliers of the step.
    change, pull = step.change, there.gradient
    if step.sides.size:
        signed = np.where(step.sides % 2, step.multipliers, -step.multipliers)
        pull = pull + signed @ there.inequality_rows(step.sides // 2)
    if step.equality_multipliers.size:
        pull = pull + step.equality_multipliers @ there.equality_rows
    turned = pull - step.pull
    # S must map the step to the change of the gradient that the known part does not explain.
    known = 0.5 * ((here.hessian + there.hessian) @ change)
    unknown = turned - known
    curved = curvature @ change
    size = abs(float(change @ curved))
    if size > 0.0:
        # Sizing: an S that was estimated at larger residuals is too large here.
        factor = min(1.0, abs(float(change @ unknown)) / size)
        curvature, curved = curvature * factor, curved * factor
    scale = (1.0 - _EXPECTED_SHARE) * turned + _EXPECTED_SHARE * (known + curved)
    along = float(change @ scale)
    lengths = float(change @ change) * float(scale @ scale)
    if not along > _MIN_COSINE * math.sqrt(lengths):
        return curvature
    error = (unknown - curved) / along
    # E cᵀ + c Eᵀ − (E·step/along) c cᵀ, c the scale; the last term shared out to the others.
    half = error - (0.5 * float(error @ change) / along) * scale
    cross = half[:, None] * scale
    return np.asarray(curvature + cross + cross.T)


def infeasibility(at: MotionPoint) -> float:
    """Sum of the violations of all constraints."""
    outside = outside_bounds(at, at.inequalities)
    return sum_of_peaks(outside) + float(np.abs(at.equalities).sum())


def outside_bounds(at: MotionPoint, values: FloatArray) -> FloatArray:
    """Distances of inequalities beyond their nearer bounds, negative within them."""
    outside: FloatArray = values - at.upper
    return np.maximum(outside, at.lower - values, out=outside)


def sum_of_peaks(outside: FloatArray) -> float:
    """Sum of the largest violations of each arc of neighbours, of distances beyond bounds."""
    where = np.flatnonzero(outside > 0.0)
    if not where.size:
        return 0.0
    starts = np.append(0, np.flatnonzero(where[1:] - where[:-1] > 1) + 1)
    return float(np.maximum.reduceat(outside[where], starts).sum())


def violated_sides(at: MotionPoint, values: FloatArray, outside: FloatArray) -> NDArray[np.intp]:
    """Sides of inequalities at peaks of violation, and of their neighbours.

    The neighbours are included because a constrained peak often moves by one point. Side 2i is the
    lower bound of inequality i, 2i + 1 the upper one.
    """
    broken = np.flatnonzero(outside > ROUNDING)
    by, last = outside[broken], outside.size - 1
    rises = (by > outside[broken - 1]) | (broken == 0)
    peaks = broken[rises & (by >= outside[np.minimum(broken + 1, last)])]
    near = np.concatenate([peaks, peaks - 1, peaks + 1])
    near = near[(near >= 0) & (near <= last)]
    return np.asarray(2 * near + (values[near] - at.upper[near] == outside[near]))


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
