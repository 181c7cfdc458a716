# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Structured quasi-Newton method for nonlinear programs, by sequential quadratic programming.

The program provides the known part of its Hessian, RᵀR of a sum of squares. Gravity keeps the
residual of efforts large at the optimum, which makes plain Gauss–Newton slow. The rest S of the
Lagrangian's Hessian is estimated from the steps taken by the update of Dennis, Gay and Welsch ("An
adaptive nonlinear least-squares algorithm", ACM TOMS 7(3), 1981), inside a trust region. Steps are
found by :mod:`.subproblem`; an exact penalty judges them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ..options import SolverOptions
from .matrices import BlockMatrix, Matrix, added, as_array
from .program import BlockPoint, Point, Program
from .subproblem import TINY, Step, Subproblem, infeasibility

FEASIBLE = 1e-6
"""Sum of constraint violations that counts as rounding, in shares of the limits and SI units."""

# Evaluations of curved equalities in the correction of a step.
_MAX_CORRECTIONS = 4


@dataclass(frozen=True, eq=False)
class SolverMemory:
    """State of a solver, for a warm start.

    Attributes
    ----------
    curvature : array, shape (n, n), or BlockMatrix
        Estimate S of the unknown part of the Lagrangian's Hessian.
    radius : float
        Radius of the trust region.
    sides : array of int, shape (n_active,)
        Sides of the inequalities that were active, see :class:`.subproblem.Step`.
    """

    curvature: Matrix
    radius: float
    sides: NDArray[np.intp]

    def curvature_alone(self) -> SolverMemory:
        """The memory for a similar program, whose active limits may differ."""
        return replace(self, sides=self.sides[:0])


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
    program: Program,
    start: FloatArray,
    options: SolverOptions = SolverOptions(),
    memory: SolverMemory | None = None,
    should_stop: Callable[[], bool] = bool,
) -> Solution:
    """Find a local minimum within the constraints, by descent from a start.

    Parameters
    ----------
    program : Program
        The program to solve.
    start : array, shape (n,)
        Unknowns to start from; they may violate constraints.
    options : SolverOptions
        When to stop.
    memory : SolverMemory, optional
        State at an earlier solution of nearly the same program.
    should_stop : callable
        Called after each step; True ends the search, because time ran out or it was cancelled.

    Returns
    -------
    solution : Solution
        The solution; without constraints its cost never exceeds that of the start.
    """
    return _Search(program, start, options, memory, should_stop).run()


class _Search:
    """The state of a search, advanced step by step."""

    def __init__(
        self,
        program: Program,
        start: FloatArray,
        options: SolverOptions,
        memory: SolverMemory | None,
        should_stop: Callable[[], bool],
    ) -> None:
        self._program, self._options, self._should_stop = program, options, should_stop
        self.x, self.here = start, program.evaluate(start)
        self.violated = infeasibility(program, self.here)
        self.start_cost, self.pull = self.here.cost, self.here.gradient
        self.weight, self.iterations = 0.0, 1
        self.feasible = (self.x, self.here) if self.violated <= FEASIBLE else None
        if memory is None:
            curved = bool(self.here.equalities.size)
            radius = options.first_radius_to_equalities if curved else options.first_radius
            memory = SolverMemory(self.here.hessian * 0.0, radius, np.zeros(0, dtype=np.intp))
        self.curvature, self.radius, self.sides = memory.curvature, memory.radius, memory.sides

    def run(self) -> Solution:
        """Take steps until one is negligible, or time or iterations run out."""
        options, converged = self._options, self.x.size == 0
        while not converged and self.iterations < options.max_iterations:
            hessian = added(self.here.hessian, self.curvature)
            enough = options.tolerance * self.here.cost
            try:
                subproblem = Subproblem(self._program, self.here, hessian, self.radius, self.sides)
                converged = self.violated <= FEASIBLE and subproblem.largest_decrease() <= enough
                if converged:
                    self.pull = subproblem.pull
                    break
                step = subproblem.solve()
            except np.linalg.LinAlgError:  # numbers overflow: there is no better point from here
                break
            self.pull, self.sides = step.pull, step.sides
            # An exact penalty needs a weight above every multiplier. It may fall again (Powell, "A
            # fast algorithm for nonlinearly constrained optimization calculations", 1978).
            least = 2.0 * step.largest_multiplier
            self.weight = max(least, 0.5 * (self.weight + least))
            predicted = step.decrease + self.weight * (self.violated - step.infeasibility)
            negligible = predicted <= enough
            converged = negligible and self.violated <= FEASIBLE
            restores = self.violated - step.infeasibility > FEASIBLE
            stuck = (negligible and not restores) or self.radius < options.min_radius
            if converged or stuck or self._should_stop():
                break
            self._take(step, subproblem, predicted)
        return self._solution(converged)

    def _take(self, step: Step, subproblem: Subproblem, predicted: float) -> None:
        """Evaluate a step, update the curvature, accept the step if it lowers the penalty."""
        step = self._restored(step, subproblem)
        there, violated, decrease = self._evaluated(step)
        length = math.sqrt(float(step.change @ step.change))
        if not decrease >= 0.25 * predicted:  # a NaN must shrink the radius, too
            self.radius = 0.25 * length
        elif decrease > 0.75 * predicted and (step.damping > 0.0 or length > 0.8 * self.radius):
            self.radius = 2.0 * max(length, self.radius)
        if step.infeasibility <= FEASIBLE:  # otherwise, multipliers may be penalties
            self.curvature = self._learned(step, there)
        if decrease > 0.0:
            self.x, self.here, self.violated = self.x + step.change, there, violated
            if violated <= FEASIBLE:
                self.feasible = self.x, there

    def _restored(self, step: Step, subproblem: Subproblem) -> Step:
        """The step, corrected along the equalities where they are curved, before its evaluation.

        Corrections are kept while they shrink the error of the linear prediction.
        """
        if not self.here.equalities.size:
            return step
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

    def _evaluated(self, step: Step) -> tuple[Point, float, float]:
        """The point after a step, its infeasibility, and the decrease of the penalty function."""
        there = self._program.evaluate(self.x + step.change)
        self.iterations += 1
        violated = infeasibility(self._program, there)
        decrease = self.here.cost - there.cost + self.weight * (self.violated - violated)
        return there, violated, decrease

    def _learned(self, step: Step, there: Point) -> Matrix:
        """The estimate of the curvature, updated along a step; block by block if it has blocks."""
        curvature, options = self.curvature, self._options
        if not np.isfinite(there.cost):
            return curvature
        if not isinstance(curvature, BlockMatrix):
            hessians = as_array(self.here.hessian) + as_array(there.hessian)
            turned = step.lagrangian_gradient(there) - step.pull
            return _updated(curvature, step.change, turned, hessians @ step.change, options)
        assert isinstance(self.here, BlockPoint)
        assert isinstance(there, BlockPoint)
        multipliers = step.sides, step.multipliers, step.equality_multipliers
        before, after = (at.block_gradients(*multipliers) for at in (self.here, there))
        sums = added(self.here.hessian, there.hessian)
        assert isinstance(sums, BlockMatrix)
        blocks = []
        for i, where in enumerate(curvature.slices):
            change = step.change[where]
            known = sums.blocks[i] @ change
            blocks.append(
                _updated(curvature.blocks[i], change, after[i] - before[i], known, options)
            )
        return replace(curvature, blocks=tuple(blocks))

    def _solution(self, converged: bool) -> Solution:
        if self.violated > FEASIBLE and self.feasible is not None:
            # An early end between two points within the constraints.
            self.x, self.here = self.feasible
            self.violated = infeasibility(self._program, self.here)
        return Solution(
            unknowns=self.x,
            cost=self.here.cost,
            infeasibility=self.violated,
            converged=converged,
            iterations=self.iterations,
            kkt_residual=float(np.linalg.norm(self.pull)) / max(self.here.cost, TINY),
            start_cost=self.start_cost,
            memory=SolverMemory(self.curvature, self.radius, self.sides),
        )


def _updated(
    curvature: FloatArray,
    change: FloatArray,
    gradient_change: FloatArray,
    known_changes: FloatArray,
    options: SolverOptions,
) -> FloatArray:
    """Dennis–Gay–Welsch update of S along a step.

    Parameters
    ----------
    curvature : array, shape (n, n)
        S.
    change, gradient_change : array, shape (n,)
        The step, and the change of the Lagrangian's gradient along it.
    known_changes : array, shape (n,)
        The sum of the known Hessians at both ends of the step, times the step.
    options : SolverOptions
        Options of the scaling.
    """
    expected_share = options.expected_share
    # S must map the step to the change of the gradient that the known part does not explain.
    known = 0.5 * known_changes
    unknown = gradient_change - known
    curved = curvature @ change
    size = abs(float(change @ curved))
    if size > 0.0:
        # Sizing: an S that was estimated at larger residuals is too large here.
        factor = min(1.0, abs(float(change @ unknown)) / size)
        curvature, curved = curvature * factor, curved * factor
    scale = (1.0 - expected_share) * gradient_change + expected_share * (known + curved)
    along = float(change @ scale)
    lengths = float(change @ change) * float(scale @ scale)
    if not along > options.min_cosine * math.sqrt(lengths):
        return curvature
    error = (unknown - curved) / along
    # E cᵀ + c Eᵀ − (E·step/along) c cᵀ, c the scale; the last term shared out to the two others.
    half = error - (0.5 * float(error @ change) / along) * scale
    cross = half[:, None] * scale
    return np.asarray(curvature + cross + cross.T)
