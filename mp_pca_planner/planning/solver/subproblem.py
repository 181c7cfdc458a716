# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The quadratic subproblem of a step: trust region, equalities, active inequalities.

A normal step meets the equalities; the remaining step lies in their null space (Byrd and Omojokun;
Nocedal and Wright, "Numerical Optimization", 2006, section 18.5). Only inequalities that the step
would violate otherwise enter the quadratic program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ...arrays import FloatArray
from .matrices import (
    BlockMatrix,
    Factor,
    Matrix,
    as_array,
    cholesky,
    mean_diagonal,
    shifted,
)
from .program import Point, Program
from .quadratic import solve_quadratic
from .trust_region import TrustRegionStep, trust_region_step

TINY = float(np.finfo(float).tiny)
"""Avoids divisions by zero."""

# Violation of an inequality that counts as rounding.
_ROUNDING = 1e-9
# Rounds of adding constraints to a quadratic program, and of damping a step that is too long.
_MAX_ROUNDS, _MAX_DAMPINGS = 20, 8
# Share of the trust region that a step towards the equalities may take.
_NORMAL_SHARE = 0.8
# Singular values of equalities, relative to the largest, that count as 0.
_DEPENDENT = 1e-9


def infeasibility(program: Program, at: Point) -> float:
    """Sum of the violations of all constraints."""
    outside = outside_bounds(program, at.inequalities)
    return _sum_of_peaks(outside) + float(np.abs(at.equalities).sum())


def outside_bounds(program: Program, values: FloatArray) -> FloatArray:
    """Distances of inequalities beyond their nearer bounds, negative within them."""
    outside: FloatArray = values - program.upper
    return np.maximum(outside, program.lower - values, out=outside)


def _sum_of_peaks(outside: FloatArray) -> float:
    """Sum of the largest violations of each arc of neighbours."""
    where = np.flatnonzero(outside > 0.0)
    if not where.size:
        return 0.0
    starts = np.append(0, np.flatnonzero(where[1:] - where[:-1] > 1) + 1)
    return float(np.maximum.reduceat(outside[where], starts).sum())


def violated_sides(program: Program, values: FloatArray, outside: FloatArray) -> NDArray[np.intp]:
    """Sides of inequalities at peaks of violation, and of their neighbours.

    The neighbours are included because a constrained peak often moves by one point. Side 2i is the
    lower bound of inequality i, 2i + 1 the upper one.
    """
    broken = np.flatnonzero(outside > _ROUNDING)
    if not broken.size:
        return broken
    by, last = outside[broken], outside.size - 1
    rises = (by > outside[broken - 1]) | (broken == 0)
    peaks = broken[rises & (by >= outside[np.minimum(broken + 1, last)])]
    near = np.concatenate([peaks, peaks - 1, peaks + 1])
    near = near[(near >= 0) & (near <= last)]
    return np.asarray(2 * near + (values[near] - program.upper[near] == outside[near]))


class Tangent(NamedTuple):
    """Steps that meet linearised equalities: normal + directions · y for any y."""

    normal: FloatArray
    directions: FloatArray
    # E⁺ of the equalities' rows E, shape (n, n_equalities).
    pseudo_inverse: FloatArray

    @classmethod
    def at(cls, here: Point, radius: float) -> Tangent:
        """The steps at a point, with a normal step inside the trust region."""
        left, singular, right = np.linalg.svd(here.equality_rows)
        rank = int(np.count_nonzero(singular > _DEPENDENT * singular[0]))
        inverse = right[:rank].T @ (left[:, :rank] / singular[:rank]).T
        normal = -inverse @ here.equalities
        # Far from the equalities, the step is shortened to the trust region.
        length = float(np.linalg.norm(normal))
        normal *= min(1.0, _NORMAL_SHARE * radius / max(length, TINY))
        return cls(normal, right[rank:].T, inverse)


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

    @property
    def largest_multiplier(self) -> float:
        """Largest magnitude of a multiplier."""
        both = np.concatenate([self.multipliers, np.abs(self.equality_multipliers)])
        return float(both.max(initial=0.0))

    def lagrangian_gradient(self, at: Point) -> FloatArray:
        """∇f + Σ multiplier · ∇constraint at a point, with the multipliers of this step."""
        gradient = at.gradient
        if self.sides.size:
            signed = np.where(self.sides % 2, self.multipliers, -self.multipliers)
            gradient = gradient + signed @ at.inequality_rows(self.sides // 2)
        if self.equality_multipliers.size:
            gradient = gradient + self.equality_multipliers @ at.equality_rows
        return gradient


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
    program : Program
        The program.
    here : Point
        The point.
    hessian : array, shape (n, n), or BlockMatrix
        Hessian of the Lagrangian.
    radius : float
        Radius of the trust region.
    sides : array of int
        Sides of inequalities to consider first: those that were active in the step before.
    """

    def __init__(
        self,
        program: Program,
        here: Point,
        hessian: Matrix,
        radius: float,
        sides: NDArray[np.intp],
    ) -> None:
        self._program, self._here, self._whole = program, here, hessian
        self._tangent = Tangent.at(here, radius) if here.equalities.size else None
        self._hessian, self._gradient, self._radius = hessian, here.gradient, radius
        if self._tangent is not None:
            normal, directions, _ = self._tangent
            self._hessian = directions.T @ as_array(hessian) @ directions
            self._gradient = directions.T @ (here.gradient + hessian @ normal)
            self._radius = math.sqrt(max(radius**2 - float(normal @ normal), 0.0))
        self._sides = sides if self._gradient.size else sides[:0]
        self._rows, self._bounds = _at_sides(program, here, self._sides)

    @cached_property
    def _first(self) -> Held:
        """The step within the given sides alone."""
        if self._sides.size:
            return self._held(self._rows, self._bounds, 0.0)
        return Held(self._free.step, np.zeros(0), 0.0, bool(self._gradient.size))

    def largest_decrease(self) -> float:
        """Predicted decrease of the objective within the given sides alone.

        Within all inequalities it is at most as large. It is infinite if no such step was found.
        """
        if not self._first.is_within:
            return math.inf
        change = self._lifted(self._first.step)
        return -float((self._here.gradient + 0.5 * (self._whole @ change)) @ change)

    @property
    def pull(self) -> FloatArray:
        """Gradient of the Lagrangian along the equalities, with the multipliers of that step."""
        pull = self._here.gradient + self._first.multipliers @ self._rows
        return pull if self._tangent is None else np.asarray(pull @ self._tangent.directions)

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
            broken = violated_sides(program, after, outside)
            added = broken[~(broken[:, None] == sides).any(axis=1)]
            if not (added.size and held.is_within and left):
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
            equality_multipliers = -self._tangent.pseudo_inverse.T @ (pull + curved)
            missed = float(np.abs(here.equalities + here.equality_rows @ change).sum())
            pull = pull + equality_multipliers @ here.equality_rows
        return Step(
            change=change,
            decrease=-float((here.gradient + 0.5 * curved) @ change),
            infeasibility=_sum_of_peaks(outside) + missed,
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
        return np.asarray(self._tangent.normal + self._tangent.directions @ y)

    @cached_property
    def _free(self) -> TrustRegionStep:
        """The step without inequalities."""
        return trust_region_step(self._hessian, self._gradient, self._radius)

    @cached_property
    def _convex(self) -> tuple[Matrix, float]:
        """The Hessian made positive definite: a matrix and a shift of its diagonal."""
        if isinstance(self._hessian, BlockMatrix):
            return self._hessian, self._free.lowest_shift
        _, failed = lapack.dpotrf(self._hessian)
        return (_convexified(self._hessian) if failed else self._hessian), 0.0

    @cached_property
    def _factor(self) -> Factor | None:
        """The factor of the Hessian made positive definite."""
        return cholesky(*self._convex)

    def _held(self, rows: FloatArray, bounds: FloatArray, damping: float) -> Held:
        """The step within inequalities rows · step ≤ bounds of the whole step.

        The given damping is raised until the step is not much longer than the trust region. A step
        that is still longer is shortened.
        """
        if self._tangent is not None:
            normal, directions, _ = self._tangent
            rows, bounds = rows @ directions, bounds - rows @ normal
        hessian, shift = self._convex
        longest = 1.5 * self._radius
        for _ in range(_MAX_DAMPINGS):
            factor = cholesky(hessian, shift + damping) if damping else self._factor
            found = solve_quadratic(factor, self._gradient, rows, bounds)
            if found is None:
                regular = shifted(as_array(hessian), shift + damping)
                step, multipliers = _nearest(regular, self._gradient, rows, bounds)
            else:
                step, multipliers = found.step, found.multipliers
            length = math.sqrt(float(step @ step))
            if length <= longest or found is None:
                break
            least = max(0.03 * self._free.shift, 1e-4 * mean_diagonal(hessian))
            damping = max(4.0 * damping, least)
        share = min(1.0, longest / max(length, TINY))
        return Held(share * step, multipliers, damping, found is not None)


def _convexified(hessian: FloatArray) -> FloatArray:
    """The matrix with the absolute values of its eigenvalues, bounded from below."""
    eigenvalues, vectors = np.linalg.eigh(hessian)
    sizes = np.abs(eigenvalues)
    return np.asarray((vectors * np.maximum(sizes, 1e-10 * sizes.max())) @ vectors.T)


def _at_sides(
    program: Program, at: Point, sides: NDArray[np.intp]
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


def _nearest(
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
