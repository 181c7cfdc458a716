# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One attempt at a request: compile and solve it, sample the motion, and check that."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..motion.collision import Collision
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from .bases import MotionBasis
from .budget import Budget
from .motion import Motion
from .objectives import Effort
from .plan import MotionSolution
from .pose_search import POSE_TOLERANCE
from .problem import PlanningProblem, collision_at_end
from .request import Request
from .selection import cost_of, rank_of
from .sequence_request import SequenceRequest
from .setup import Setup
from .solver import FEASIBLE, Solution, SolverMemory, solve
from .starts import StartPoint

Violation = tuple[float, float, float]
"""Largest relative excess over a limit, penetration [m] and error of a condition [rad or m]."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One solved program and the validator's verdict on its motion.

    Attributes
    ----------
    request : Request or SequenceRequest
        What was attempted.
    bases : tuple of MotionBasis
        The bases of the segments.
    motions : tuple of Motion
        The motion found, segment by segment.
    solution : MotionSolution
        Result of the solver.
    naturalness : float
        The ρ used.
    phases : tuple of float
        Phases of the conditions.
    trajectory : Trajectory
        Its points.
    check : LimitCheck
        Comparison with the limits.
    collisions : tuple of Collision
        Collisions; not computed if limits are violated.
    solved_at : float
        When the solver was done, by the clock of `time.perf_counter` [s].
    has_clearances : bool
        Whether there were clearance constraints.
    memory : SolverMemory or None
        State of the solver at the end.
    """

    request: Request | SequenceRequest
    bases: tuple[MotionBasis, ...]
    motions: tuple[Motion, ...]
    solution: MotionSolution
    naturalness: float
    phases: tuple[float, ...]
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    solved_at: float
    has_clearances: bool = False
    memory: SolverMemory | None = None

    @property
    def duration(self) -> float:
        """Duration of all segments [s]."""
        return sum(motion.duration for motion in self.motions)

    @cached_property
    def condition_errors(self) -> FloatArray:
        """Residuals of the conditions, shape (n_errors,) [rad or m]."""
        places = [motion.goal.positions for motion in self.motions]
        if len(self.motions) == 1 and self.phases:
            motion = self.motions[0]
            places = list(motion.evaluate(motion.duration * np.array(self.phases))[0])
        conditions = self.request.conditions
        errors = [one.target.error(q)[0] for one, q in zip(conditions, places, strict=False)]
        return np.concatenate([np.zeros(0), *errors])

    @cached_property
    def violation(self) -> Violation:
        """Violations of limits, clearances and conditions, for the comparison of attempts."""
        missed = largest(self.condition_errors)
        return (
            self.check.worst_excess if self.check.violations else 0.0,
            sum(POSE_TOLERANCE + one.penetration for one in self.collisions),
            0.0 if missed <= POSE_TOLERANCE else missed,
        )

    @property
    def rank(self) -> tuple[Violation, float]:
        """The order among attempts for one goal, the best first; unknown costs come last."""
        return self.violation, rank_of(self.solution.cost)

    @property
    def is_valid(self) -> bool:
        """Whether it may be executed and meets the conditions."""
        return not any(self.violation)

    @property
    def meets_bodies(self) -> bool:
        """Whether it, or an earlier motion of the same program, is in collision."""
        return bool(self.collisions) or self.has_clearances

    @property
    def is_hopeless(self) -> bool:
        """Whether bodies collide at an end of the motion that is fixed."""
        return self.collision_at_end is not None

    @cached_property
    def collision_at_end(self) -> tuple[str, Collision] | None:
        """The name of a fixed end in collision, and the collision; None if there is none."""
        return collision_at_end(self.collisions, self.request, self.duration)


def checked(
    setup: Setup,
    request: Request | SequenceRequest,
    bases: tuple[MotionBasis, ...],
    motions: tuple[Motion, ...],
    solution: MotionSolution,
    phases: tuple[float, ...],
) -> Attempt:
    """Make an attempt of motions that were found without the solver.

    Parameters
    ----------
    setup : Setup
        The planner's.
    request, bases, motions, solution, phases
        See :class:`Attempt`.
    """
    naturalness, trajectory = setup.options.naturalness, setup.sample(motions)
    check, now = setup.check(trajectory), time.perf_counter()
    collisions = () if check.violations else setup.collisions(trajectory)
    return Attempt(
        request, bases, motions, solution, naturalness, phases, trajectory, check, collisions, now
    )


def with_costs(found: Attempt, setup: Setup) -> Attempt:
    """An attempt whose costs are known, also if its motion was not optimised."""
    if np.isfinite(found.solution.objective_cost):
        return found
    objective, effort = (
        sum(
            cost_of(setup.robot, motion, basis.tables, objectives)
            for motion, basis in zip(found.motions, found.bases, strict=True)
        )
        for objectives in (setup.options.objectives, [(1.0, Effort())])
    )
    solution = replace(found.solution, objective_cost=objective, effort_cost=effort)
    return replace(found, solution=solution)


def attempt(
    problem: PlanningProblem,
    budget: Budget,
    *,
    n_starts: int = 1,
) -> Attempt:
    """Solve a problem, and refine its constraints until the validator finds no violation.

    Parameters
    ----------
    problem : PlanningProblem
        The problem.
    budget : Budget
        The time for it.
    n_starts : int
        Largest number of starts.
    """
    setup, passes, touched = problem.setup, 0, False
    problem.bound(fully=not problem.is_near_expected)
    first = starts = problem.starts[:n_starts]
    for _ in range(setup.options.search.max_refinements):
        solutions = _solutions(problem, starts, budget)
        solved_at = time.perf_counter()
        passes += sum(one.iterations for one in solutions)
        best = min(solutions, key=lambda one: (one.infeasibility > FEASIBLE, rank_of(one.cost)))
        motions = problem.motions(best.unknowns)
        trajectory = setup.sample(motions)
        check = setup.check(trajectory)
        # If limits are violated, another motion will be checked for collisions.
        collisions = () if check.violations else setup.collisions(trajectory)
        if (check.violations or collisions) and budget.is_over():
            break
        if not problem.covers(check.violations, motions):
            problem.bound(fully=True)
            starts = _continued(problem, best, first[0]) if problem.has_clearances else first
            continue
        # A limit that is only touched may be exceeded between the points of the grid. It is
        # tightened only once, because an end of the motion may be at the limit.
        touches = check.touched and not touched and problem.covers(check.touched, motions)
        apart = problem.separate(collisions, motions)
        if not (check.violations or touches or apart) or not best.converged:
            break
        if check.violations or touches:
            problem.tighten(check.touched, motions)
            touched = not check.violations
        starts = _continued(problem, best, first[0] if apart else None)
    return Attempt(
        problem.request,
        problem.bases,
        motions,
        _described(problem, best, motions, passes),
        problem.naturalness,
        problem.phases(best.unknowns),
        trajectory,
        check,
        collisions,
        solved_at,
        problem.has_clearances,
        best.memory,
    )


def _solutions(
    problem: PlanningProblem,
    starts: Sequence[StartPoint],
    budget: Budget,
) -> list[Solution]:
    """The solutions from each start in turn, until the time runs out.

    Among clearance constraints, the first one that meets them is enough.
    """
    program, found = problem.program(), list[Solution]()
    for start in starts:
        options = replace(problem.setup.options.solver, should_stop=budget.pacer())
        is_clear = problem.has_clearances and found and found[-1].infeasibility <= FEASIBLE
        if is_clear or (found and budget.is_over()):
            break
        found.append(solve(program, start.unknowns, options, start.memory))
    return found


def _continued(
    problem: PlanningProblem, best: Solution, first: StartPoint | None
) -> list[StartPoint]:
    """The last solution as a start; with new clearance constraints also the original start.

    A detour on the side of the last solution may be blocked.
    """
    if first is None:
        return [StartPoint(best.unknowns, best.memory)]
    # The inequalities were renumbered.
    return [StartPoint(best.unknowns, best.memory.curvature_alone()), first]


def _described(
    problem: PlanningProblem, found: Solution, motions: Sequence[Motion], passes: int
) -> MotionSolution:
    """The result of the solver for a motion."""
    x = found.unknowns
    natural, (effort, start_effort) = problem.naturalness_cost(x), problem.efforts(x)
    return MotionSolution(
        weights=np.concatenate([motion.weights for motion in motions]),
        objective_cost=found.cost - natural,
        effort_cost=effort,
        naturalness_cost=natural,
        start_cost=start_effort,
        converged=found.converged,
        iterations=passes,
        kkt_residual=found.kkt_residual,
    )


def largest(errors: FloatArray) -> float:
    """The largest magnitude, 0 of none."""
    return float(np.abs(errors).max(initial=0.0))
