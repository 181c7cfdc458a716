# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Structured quasi-Newton method for nonlinear programs, by sequential quadratic programming.

The program tells the part of its Hessian that is known, as RᵀR of a sum of squares. Gravity
keeps the residual of efforts large at the optimum, which makes plain Gauss–Newton slow; the
rest S of the Lagrangian's Hessian is estimated from the steps taken by the update of Dennis,
Gay and Welsch ("An adaptive nonlinear least-squares algorithm", ACM TOMS 7(3), 1981), inside
a trust region (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4(3), 1983). Equalities are met
by a step normal to them, the rest moves in their null space (Byrd and Omojokun; Nocedal and
Wright, "Numerical Optimization", 2006, section 18.5). Inequalities make each step a quadratic
program of the few that it would break otherwise; an exact penalty judges the steps.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ..arrays import FloatArray
from .program import Point, Program
from .quadratic import solve_quadratic

# The unknowns are scaled to about 1, but where efforts alone count, optima lie tens of usual
# weights away, and a model of efforts is good that far. Equalities may be far more curved.
_FIRST_RADIUS, _FIRST_RADIUS_TO_EQUALITIES = 30.0, 4.0
_SMALLEST_RADIUS = 1e-9
_TINY = float(np.finfo(float).tiny)
FEASIBLE = 1e-7
"""Sum of what is out of bounds, in shares of the limits, and of the equalities: rounding."""

# By how much an inequality must be broken to be added to a quadratic program.
_ROUNDING = 1e-9
# Rounds of adding constraints to a quadratic program.
_MOST_ROUNDS = 20
# Times that a step which is too long is damped.
_MOST_DAMPINGS = 8
# Share of a step's damping that the next one begins with.
_LESS_DAMPING = 0.25
# Share of the trust region that a step towards the equalities may take.
_NORMAL_SHARE = 0.8
# The update of the curvature takes its scale from the change of the gradient along a step. A share
# of the change that was expected makes that steadier (as Powell's damping does); this one took
# the fewest passes on four arms. Below this cosine of the angle between both, an update would be
# out of proportion.
_EXPECTED_SHARE = 0.3
_LEAST_COSINE = 0.05
# Singular values of equalities, relative to the largest, that are taken for 0.
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class SolverOptions:
    """When to stop.

    Attributes
    ----------
    tolerance : float
        Stop when a step is predicted to lower the objective by less than this share of it.
    max_iterations : int
        Most evaluations of the program.
    max_time : float
        Longest time [s].
    """

    tolerance: float = 3e-5
    max_iterations: int = 60
    max_time: float = float("inf")


@dataclass(frozen=True, eq=False)
class SolverMemory:
    """What a solver has learned of a program, to go on where it stopped.

    Attributes
    ----------
    curvature : array, shape (n, n)
        Estimate S of the unknown part of the Lagrangian's Hessian.
    radius : float
        Radius of the trust region.
    sides : array of int, shape (n_held,)
        Sides of inequalities that held the last step, see `_peaks`.
    damping : float
        What had to be added to the Hessian to keep that step short.
    """

    curvature: FloatArray
    radius: float
    sides: NDArray[np.intp]
    damping: float

    @classmethod
    def blank(cls, start: Point) -> SolverMemory:
        """Of a program that is new."""
        radius = _FIRST_RADIUS_TO_EQUALITIES if start.equalities.size else _FIRST_RADIUS
        return cls(np.zeros_like(start.hessian), radius, np.zeros(0, dtype=np.intp), 0.0)

    def curvature_alone(self) -> SolverMemory:
        """For a program that is similar, but may meet other limits."""
        return replace(self, sides=self.sides[:0], damping=0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped.

    Attributes
    ----------
    unknowns : array, shape (n,)
        The best x found.
    cost : float
        The objective there.
    infeasibility : float
        Sum of what is out of bounds and of the equalities' magnitudes.
    converged : bool
        Whether the tolerance was reached within the constraints; otherwise iterations or time
        ran out, or the constraints can't be met.
    iterations : int
        Evaluations of the program.
    kkt_residual : float
        Norm of the Lagrangian's gradient, as a share of the objective.
    start_cost : float
        Objective at the start.
    memory : SolverMemory
        To go on from here after the program has changed a little.
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
    program: Program,
    start: FloatArray,
    options: SolverOptions = SolverOptions(),
    memory: SolverMemory | None = None,
) -> Solution:
    """Find a local minimum within the constraints, downhill from a start.

    Parameters
    ----------
    program : Program
        What to minimise.
    start : array, shape (n,)
        Unknowns to start from; they may break constraints.
    options : SolverOptions
        When to stop.
    memory : SolverMemory, optional
        Of an earlier solution of nearly the same program.

    Returns
    -------
    solution : Solution
        Without constraints never worse than the start.
    """
    deadline = time.perf_counter() + options.max_time
    x, here, weight = start, program.evaluate(start), 0.0
    memory = memory or SolverMemory.blank(here)
    curvature, radius, sides = memory.curvature, memory.radius, memory.sides
    damping = memory.damping
    broken = _infeasibility(program, here)
    start_cost, pull = here.cost, here.gradient
    iterations, converged = 1, start.size == 0
    while not converged and iterations < options.max_iterations:
        subproblem = _Subproblem(program, here, here.hessian + curvature, radius)
        less = _LESS_DAMPING * damping
        step = subproblem.solve(sides, less)
        pull, sides, damping = step.pull, step.sides, step.damping
        # An exact penalty needs a weight above every multiplier.
        weight = max(weight, 2.0 * step.largest_multiplier)
        predicted = step.decrease + weight * (broken - step.infeasibility)
        negligible = predicted <= options.tolerance * here.cost
        if negligible and less > 0.0:
            damping = 0.0  # it may have been too much, and nothing else makes the step small
            continue
        converged = negligible and broken <= FEASIBLE
        mends = broken - step.infeasibility > FEASIBLE
        stuck = (negligible and not mends) or radius < _SMALLEST_RADIUS
        if converged or stuck or time.perf_counter() > deadline:
            break
        there = program.evaluate(x + step.change)
        iterations += 1
        broken_there = _infeasibility(program, there)
        decrease = here.cost - there.cost + weight * (broken - broken_there)
        if not decrease >= 0.25 * predicted and here.equalities.size:
            # A step along curved equalities leaves them: back to them, before it is given up.
            step = replace(step, change=step.change + subproblem.way_back(there))
            there = program.evaluate(x + step.change)
            iterations += 1
            broken_there = _infeasibility(program, there)
            decrease = here.cost - there.cost + weight * (broken - broken_there)
        turned = step.lagrangian_gradient(there) - pull
        curvature = _updated(curvature, step.change, turned, here.hessian + there.hessian)
        length = float(np.linalg.norm(step.change))
        if not decrease >= 0.25 * predicted:  # a NaN must shrink it too
            radius = 0.25 * length
        elif decrease > 0.75 * predicted and (step.damping > 0.0 or length > 0.8 * radius):
            radius = 2.0 * max(length, radius)
        if decrease > 0.0:
            x, here, broken = x + step.change, there, broken_there
    return Solution(
        unknowns=x,
        cost=here.cost,
        infeasibility=broken,
        converged=converged,
        iterations=iterations,
        kkt_residual=float(np.linalg.norm(pull)) / max(here.cost, _TINY),
        start_cost=start_cost,
        memory=SolverMemory(curvature, radius, sides, damping),
    )


def _infeasibility(program: Program, at: Point) -> float:
    outside = _outside(program, at.inequalities)
    return float(np.maximum(outside, 0.0).sum() + np.abs(at.equalities).sum())


def _outside(program: Program, values: FloatArray) -> FloatArray:
    """How far inequalities are out of their nearer bounds, negative within them."""
    outside: FloatArray = values - program.upper
    return np.maximum(outside, program.lower - values, out=outside)


def _peaks(program: Program, values: FloatArray, outside: FloatArray) -> NDArray[np.intp]:
    """Sides of inequalities that are broken: where most so, and the points on either side.

    To where it is held, a peak often moves by a point. The side 2i is the lower one of
    inequality i, 2i + 1 the upper one.
    """
    broken = outside > _ROUNDING
    if not broken.any():
        return np.zeros(0, dtype=np.intp)
    broken[1:] &= outside[1:] > outside[:-1]
    broken[:-1] &= outside[:-1] >= outside[1:]
    peaks = np.flatnonzero(broken)
    near = np.concatenate([peaks, peaks - 1, peaks + 1])
    near = near[(near >= 0) & (near < outside.size)]
    return np.asarray(2 * near + (values[near] - program.upper[near] == outside[near]))


class _Tangent(NamedTuple):
    """Steps that meet linearised equalities: normal + directions · y for any y."""

    normal: FloatArray
    directions: FloatArray
    # E⁺ of the equalities' rows E, shape (n, n_equalities).
    pseudo_inverse: FloatArray

    @classmethod
    def at(cls, here: Point, radius: float) -> _Tangent:
        left, singular, right = np.linalg.svd(here.equality_rows)
        rank = int(np.count_nonzero(singular > _DEPENDENT * singular[0]))
        inverse = right[:rank].T @ (left[:, :rank] / singular[:rank]).T
        normal = -inverse @ here.equalities
        # Far from the equalities only as much of the way as the trust region allows.
        length = float(np.linalg.norm(normal))
        normal *= min(1.0, _NORMAL_SHARE * radius / max(length, _TINY))
        return cls(normal, right[rank:].T, inverse)


@dataclass(frozen=True, eq=False)
class _Step:
    """A step, what the model predicts of it, and the multipliers that hold it."""

    change: FloatArray
    decrease: float
    infeasibility: float
    sides: NDArray[np.intp]
    multipliers: FloatArray
    equality_multipliers: FloatArray
    # ∇f + Σ multiplier · ∇constraint where it starts.
    pull: FloatArray
    damping: float

    @property
    def largest_multiplier(self) -> float:
        both = np.concatenate([self.multipliers, np.abs(self.equality_multipliers)])
        return float(both.max(initial=0.0))

    def lagrangian_gradient(self, at: Point) -> FloatArray:
        """∇f + Σ multiplier · ∇constraint at a point, with the multipliers of this step."""
        gradient = at.gradient
        if self.sides.size:
            gradient = gradient + self.multipliers @ _rows_of_sides(at, self.sides)
        if self.equality_multipliers.size:
            gradient = gradient + self.equality_multipliers @ at.equality_rows
        return gradient


class _Subproblem:
    """The quadratic model of a program at a point, in the trust region.

    Its unknowns are y with the step `normal + directions · y`, or the step itself where there
    are no equalities.
    """

    def __init__(self, program: Program, here: Point, hessian: FloatArray, radius: float) -> None:
        self._program, self._here, self._whole = program, here, hessian
        self._tangent = _Tangent.at(here, radius) if here.equalities.size else None
        self._hessian, self._gradient, self._radius = hessian, here.gradient, radius
        if self._tangent is not None:
            normal, directions, _ = self._tangent
            self._hessian = directions.T @ hessian @ directions
            self._gradient = directions.T @ (here.gradient + hessian @ normal)
            self._radius = math.sqrt(max(radius**2 - float(normal @ normal), 0.0))

    def solve(self, sides: NDArray[np.intp], damping: float) -> _Step:
        """The step within the linearised constraints.

        Only those sides of inequalities that held the step before (given), and those that the
        step would break otherwise, go into the quadratic program: of the thousands there are,
        few matter. Constraints keep most steps short: it begins with little damping (given).
        """
        here, program = self._here, self._program
        multipliers, feasible = np.zeros(0), bool(self._gradient.size)
        sides = sides if feasible else sides[:0]
        if not sides.size:
            y = self._free.step
        rows, bounds = _rows_of_sides(here, sides), _room_at_sides(program, here, sides)
        for left in reversed(range(_MOST_ROUNDS)):
            if sides.size:
                reduced = self._reduced(rows, bounds)
                y, multipliers, damping, feasible = self._held(damping, *reduced)
            change = self._lifted(y)
            after = here.inequalities_after(change)
            outside = _outside(program, after)
            broken = _peaks(program, after, outside)
            added = broken[~(broken[:, None] == sides).any(axis=1)]
            if not (added.size and feasible and left):
                break
            kept = multipliers > 0.0
            sides = np.concatenate([sides[kept], added])
            rows = np.concatenate([rows[kept], _rows_of_sides(here, added)])
            bounds = np.concatenate([bounds[kept], _room_at_sides(program, here, added)])
        holding = multipliers > 0.0
        curved = self._whole @ change
        pull = here.gradient + multipliers[holding] @ rows[holding]
        equality_multipliers, missed = np.zeros(0), 0.0
        if self._tangent is not None:
            equality_multipliers = -self._tangent.pseudo_inverse.T @ (pull + curved)
            missed = float(np.abs(here.equalities + here.equality_rows @ change).sum())
            pull = pull + equality_multipliers @ here.equality_rows
        return _Step(
            change=change,
            decrease=-float((here.gradient + 0.5 * curved) @ change),
            infeasibility=float(np.maximum(outside, 0.0).sum()) + missed,
            sides=sides[holding],
            multipliers=multipliers[holding],
            equality_multipliers=equality_multipliers,
            pull=pull,
            damping=damping if sides.size else 0.0,
        )

    def way_back(self, there: Point) -> FloatArray:
        """The shortest step that mends the equalities at a point near by, to first order."""
        assert self._tangent is not None
        return np.asarray(-self._tangent.pseudo_inverse @ there.equalities)

    def _lifted(self, y: FloatArray) -> FloatArray:
        if self._tangent is None:
            return y
        return np.asarray(self._tangent.normal + self._tangent.directions @ y)

    def _reduced(self, rows: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inequalities on the step as such on y."""
        if self._tangent is None:
            return rows, bounds
        return rows @ self._tangent.directions, bounds - rows @ self._tangent.normal

    @cached_property
    def _free(self) -> TrustRegionStep:
        """The step without inequalities."""
        return trust_region_step(self._hessian, self._gradient, self._radius)

    @cached_property
    def _convex(self) -> FloatArray:
        """The Hessian if it is positive definite, or one like it that is."""
        _, failed = lapack.dpotrf(self._hessian)
        return _convexified(self._hessian) if failed else self._hessian

    def _held(
        self, damping: float, rows: FloatArray, bounds: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, bool]:
        """The y within rows · y ≤ bounds, its multipliers, the damping, and whether there is any.

        The damping given is raised until the step is not much longer than the trust region. What
        is still longer then, to mend what is broken, goes only a part of the way.
        """
        hessian, n = self._convex, len(self._convex)
        longest = 1.5 * self._radius
        for _ in range(_MOST_DAMPINGS):
            regular = hessian + damping * np.eye(n) if damping else hessian
            found = solve_quadratic(regular, self._gradient, rows, bounds)
            if found is None:
                return *_nearest(regular, self._gradient, rows, bounds), damping, False
            step, multipliers = found.step, found.multipliers
            length = math.sqrt(float(step @ step))
            if length <= longest:
                return step, multipliers, damping, True
            least = max(0.03 * self._free.shift, 1e-4 * float(np.trace(hessian)) / n)
            damping = max(4.0 * damping, least)
        return longest / length * step, multipliers, damping, True


def _convexified(hessian: FloatArray) -> FloatArray:
    """The same curvature, but upwards, where it is downwards."""
    eigenvalues, vectors = np.linalg.eigh(hessian)
    sizes = np.abs(eigenvalues)
    return np.asarray((vectors * np.maximum(sizes, 1e-10 * sizes.max())) @ vectors.T)


def _rows_of_sides(at: Point, sides: NDArray[np.intp]) -> FloatArray:
    """Derivatives of sides of inequalities, all turned so that they are bounded above."""
    signs = np.where(sides % 2, 1.0, -1.0)
    return np.asarray(signs[:, None] * at.inequality_rows(sides // 2))


def _room_at_sides(program: Program, at: Point, sides: NDArray[np.intp]) -> FloatArray:
    """How far sides of inequalities are from their bounds, negative beyond."""
    index = sides // 2
    values = at.inequalities[index]
    return np.where(sides % 2, program.upper[index] - values, values - program.lower[index])


def _nearest(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A step that breaks contradicting constraints as little as it can, and their penalties."""
    broken = bounds < 0.0
    if not broken.any():  # no contradiction, but too hard a program
        step = np.asarray(np.linalg.solve(hessian, -gradient))
        broken = rows @ step > bounds
        if not broken.any():
            return step, np.zeros(len(bounds))
    matrix = rows[broken]
    penalty = 1e3 * float(np.trace(hessian)) / max(float(np.sum(matrix**2)), _TINY)
    regular = hessian + penalty * matrix.T @ matrix
    step = np.asarray(np.linalg.solve(regular, penalty * matrix.T @ bounds[broken] - gradient))
    return step, np.where(broken, penalty * np.maximum(rows @ step - bounds, 0.0), 0.0)


def _updated(
    curvature: FloatArray, change: FloatArray, gradient_change: FloatArray, hessians: FloatArray
) -> FloatArray:
    """Dennis–Gay–Welsch update of S along a step, with the sum of known Hessians at its ends."""
    # S must map the step to that change of the gradient that the known part leaves open.
    known = 0.5 * (hessians @ change)
    wanted = gradient_change - known
    curved = curvature @ change
    size = abs(float(change @ curved))
    if size > 0.0:
        # Sizing: S estimated far away, where residuals were larger, is too large here.
        factor = min(1.0, abs(float(change @ wanted)) / size)
        curvature, curved = curvature * factor, curved * factor
    scale = (1.0 - _EXPECTED_SHARE) * gradient_change + _EXPECTED_SHARE * (known + curved)
    along = float(change @ scale)
    lengths = float(change @ change) * float(scale @ scale)
    if not along > _LEAST_COSINE * math.sqrt(lengths):
        return curvature
    error = (wanted - curved) / along
    # E cᵀ + c Eᵀ − (E·step/along) c cᵀ, c the scale; the last term shared out to the two others.
    half = error - (0.5 * float(error @ change) / along) * scale
    cross = half[:, None] * scale
    return np.asarray(curvature + cross + cross.T)


class TrustRegionStep(NamedTuple):
    """Minimiser of a quadratic model in a ball.

    Attributes
    ----------
    step : array, shape (n,)
        The minimiser p (the radius is met to a few percent).
    predicted : float
        By how much it lowers the model.
    shift : float
        The μ ≥ 0 with (H + μI)p = −g.
    lowest_shift : float
        The least μ ≥ 0 that makes H + μI positive definite.
    """

    step: FloatArray
    predicted: float
    shift: float
    lowest_shift: float


def trust_region_step(hessian: FloatArray, gradient: FloatArray, radius: float) -> TrustRegionStep:
    """Minimise gᵀp + ½pᵀHp over ‖p‖ ≤ radius.

    Parameters
    ----------
    hessian : array, shape (n, n)
        Symmetric H, may be indefinite.
    gradient : array, shape (n,)
        g.
    radius : float
        Radius of the trust region.
    """
    if not gradient.size:
        return TrustRegionStep(gradient, 0.0, 0.0, 0.0)
    _, newton, failed = lapack.dposv(hessian, gradient)
    if not failed and newton @ newton <= radius**2:
        return TrustRegionStep(-newton, 0.5 * float(newton @ gradient), 0.0, 0.0)
    eigenvalues, vectors = np.linalg.eigh(hessian)
    rotated = vectors.T @ gradient
    lowest = _lowest_shift(eigenvalues)
    shift = _shift(eigenvalues, rotated, radius, lowest)
    step = -rotated / (eigenvalues + shift)
    predicted = -float(rotated @ step + 0.5 * step @ (eigenvalues * step))
    return TrustRegionStep(vectors @ step, predicted, shift, lowest)


def _lowest_shift(eigenvalues: FloatArray) -> float:
    margin = 1e-10 * max(float(np.abs(eigenvalues).max()), 1e-300)
    return max(0.0, margin - float(eigenvalues[0]))


def _shift(eigenvalues: FloatArray, rotated: FloatArray, radius: float, lowest: float) -> float:
    """The μ ≥ `lowest` with ‖(H + μI)⁻¹g‖ about the radius."""
    shift = lowest
    for _ in range(50):
        step = rotated / (eigenvalues + shift)
        length = float(np.linalg.norm(step))
        excess = length / radius - 1.0
        if abs(excess) < 0.05 or (excess < 0.0 and shift == lowest):
            break
        # Newton's method on 1/‖p(μ)‖, which is nearly linear in μ.
        slope = float(np.sum(step**2 / (eigenvalues + shift))) / length
        shift = max(lowest, shift + excess * length / slope)
    return shift
