# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Candidates: motions that were found for a request, sampled and checked."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...motion.collision import Collision
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck
from ..configurations import POSE_TOLERANCE
from ..context import Context
from ..motion import Motion
from ..plan import MotionSolution
from ..program.bases import MotionBasis, StartPoint
from ..program.compile import compile_problem, motions_at
from ..program.problem import Problem
from ..program.setting import Setting
from ..program.targets import pose_error
from ..request import Request
from ..solver.sqp import FEASIBLE, Solution, SolverMemory, solve
from .budget import Budget

Violation = tuple[float, float, float]
"""Largest relative excess over a limit, penetration [m] and error of a target [rad or m]."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion for a request and the validator's verdict on it.

    Attributes
    ----------
    request : Request
        The request.
    bases : tuple of MotionBasis
        The bases of the segments.
    motions : tuple of Motion
        The motion, segment by segment.
    solution : MotionSolution
        Result of the solver.
    naturalness : float
        The ρ used.
    trajectory : Trajectory
        Its points.
    check : LimitCheck
        Comparison with the limits.
    collisions : tuple of Collision
        Collisions; not computed if limits are violated.
    solved_at : float
        When it was found, by the clock of `time.perf_counter` [s].
    target_errors : tuple of float
        Largest distances from the targets [rad or m].
    violation : Violation
        Violations of limits, clearances and targets, for the comparison of candidates.
    has_clearances : bool
        Whether there were clearance constraints.
    memory : SolverMemory or None
        State of the solver at the end.
    corners : array, shape (n_corners, n_joints), or None
        Corners of a collision-free path, if one is known but no valid motion near it.
    n_stops : int
        Number of rests of a slow motion between the targets.
    """

    request: Request
    bases: tuple[MotionBasis, ...]
    motions: tuple[Motion, ...]
    solution: MotionSolution
    naturalness: float
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    solved_at: float
    target_errors: tuple[float, ...]
    violation: Violation
    has_clearances: bool = False
    memory: SolverMemory | None = None
    corners: FloatArray | None = None
    n_stops: int = 0

    @property
    def duration(self) -> float:
        """Duration of all segments [s]."""
        return float(sum(motion.duration for motion in self.motions))

    @property
    def is_valid(self) -> bool:
        """Whether it may be executed and reaches the targets."""
        return not any(self.violation)

    @property
    def meets_bodies(self) -> bool:
        """Whether it, or an earlier motion of the same program, is in collision."""
        return bool(self.collisions) or self.has_clearances

    @property
    def is_hopeless(self) -> bool:
        """Whether bodies collide at an end of the motion that is fixed."""
        return collision_at_end(self.collisions, self.request, self.duration) is not None


def collision_at_end(
    collisions: Sequence[Collision], request: Request, duration: float
) -> tuple[str, Collision] | None:
    """The first collision at an end that is fixed, "start" or "goal"; None if there is none."""
    for one in collisions:
        if one.first_time == 0.0:
            return "start", one
        if request.pose is None and one.last_time >= duration:
            return "goal", one
    return None


def checked(
    context: Context,
    request: Request,
    bases: tuple[MotionBasis, ...],
    motions: tuple[Motion, ...],
    solution: MotionSolution | None = None,
) -> Candidate:
    """The candidate of motions that were found without the solver.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    bases, motions
        See :class:`Candidate`.
    solution : MotionSolution, optional
        Result of an earlier attempt to solve; nothing unless given.
    """
    solution = MotionSolution.unknown() if solution is None else solution
    trajectory = context.sample(motions)
    check, now = context.check(trajectory), time.perf_counter()
    collisions = () if check.violations else context.collisions(trajectory)
    naturalness = context.options.naturalness
    return _candidate(
        context, request, bases, motions, solution, naturalness, trajectory, check, collisions, now
    )


def _candidate(
    context: Context,
    request: Request,
    bases: tuple[MotionBasis, ...],
    motions: tuple[Motion, ...],
    solution: MotionSolution,
    naturalness: float,
    trajectory: Trajectory,
    check: LimitCheck,
    collisions: tuple[Collision, ...],
    solved_at: float,
    **found: object,
) -> Candidate:
    """The candidate, with its violations."""
    errors = _target_errors(context, request, motions)
    missed = max(errors)
    violation = (
        check.worst_excess if check.violations else 0.0,
        sum(POSE_TOLERANCE + one.penetration for one in collisions),
        0.0 if missed <= POSE_TOLERANCE else missed,
    )
    return Candidate(
        request,
        bases,
        motions,
        solution,
        naturalness,
        trajectory,
        check,
        collisions,
        solved_at,
        errors,
        violation,
        **found,  # type: ignore[arg-type]
    )


def _target_errors(
    context: Context, request: Request, motions: Sequence[Motion]
) -> tuple[float, ...]:
    """Largest distances of motions from the targets [rad or m]."""
    errors = []
    for segment, motion in zip(request.segments, motions, strict=True):
        q = motion.goal.positions
        missed = q - segment.goal.positions
        if segment.pose is not None:
            missed, _ = pose_error(context.robot, segment.pose, q)
        errors.append(float(np.abs(missed).max()))
    return tuple(errors)


def attempt(context: Context, request: Request, setting: Setting, budget: Budget) -> Candidate:
    """Compile and solve a request; refine its constraints until the validator finds no violation.

    Parameters
    ----------
    context, request, setting
        What to compile.
    budget : Budget
        The time for it.
    """
    refined = problem = compile_problem(context, request, setting)
    passes, touched = 0, False
    n_starts = context.options.n_starts
    starts = problem.starts[:n_starts]
    for _ in range(context.options.search.max_refinements):
        solutions = _solutions(problem, setting, starts, budget)
        solved_at = time.perf_counter()
        passes += sum(one.iterations for one in solutions)
        best = min(solutions, key=lambda one: (one.infeasibility > FEASIBLE, one.cost))
        motions = motions_at(context, request, setting, problem, best.unknowns)
        trajectory = context.sample(motions)
        check = context.check(trajectory)
        # If limits are violated, another motion will be checked for collisions.
        collisions = () if check.violations else context.collisions(trajectory)
        if (check.violations or collisions) and budget.is_over():
            break
        ends = np.cumsum([motion.duration for motion in motions]).tolist()
        met = () if collision_at_end(collisions, request, ends[-1]) else collisions
        # A limit that is only touched may be exceeded between the points of the grid. It is
        # tightened only once, because an end of the motion may be at the limit.
        refined = problem.refined(trajectory, check, met, ends, touches=not touched)
        is_longer = refined.lower.size != problem.lower.size
        if refined is problem or not (best.converged or (is_longer and check.violations)):
            break
        if not (is_longer and check.violations):
            touched = not check.violations and (touched or bool(check.touched))
        starts = _continued(problem, best, is_longer, bool(check.violations), n_starts)
        problem = refined
    return _candidate(
        context,
        request,
        setting.bases,
        motions,
        _described(problem, setting, best, motions, passes),
        setting.naturalness,
        trajectory,
        check,
        collisions,
        solved_at,
        has_clearances=refined.has_clearances,
        memory=best.memory,
    )


def _solutions(
    problem: Problem, setting: Setting, starts: Sequence[StartPoint], budget: Budget
) -> list[Solution]:
    """The solutions from each start in turn, until the time runs out.

    Among clearance constraints, the first one that meets them is enough.
    """
    found = list[Solution]()
    options = replace(setting.solver, should_stop=budget.is_over)
    for start in starts:
        is_clear = problem.has_clearances and found and found[-1].infeasibility <= FEASIBLE
        if is_clear or (found and budget.is_over()):
            break
        found.append(solve(problem, start.unknowns, options, start.memory))
    return found


def _continued(
    problem: Problem, best: Solution, is_longer: bool, violates: bool, n_starts: int
) -> Sequence[StartPoint]:
    """Where to start after a refinement.

    The last solution; with new constraints also the original start, because a detour on the side
    of the last solution may be blocked. A motion without the limits that it violates is far from
    those within them: then only the original starts.
    """
    if not is_longer:
        return [StartPoint(best.unknowns, best.memory)]
    if violates and not problem.has_clearances:
        return problem.starts[:n_starts]
    # The inequalities were renumbered.
    return [StartPoint(best.unknowns, best.memory.curvature_alone()), problem.starts[0]]


def _described(
    problem: Problem,
    setting: Setting,
    found: Solution,
    motions: Sequence[Motion],
    passes: int,
) -> MotionSolution:
    """The result of the solver for a motion.

    The objective of the shortest motion is not the planner's; the report computes that.
    """
    parts = problem.parts(found.unknowns)
    assert parts is not None
    natural = effort = expected = 0.0
    for segment, terms, (own, _) in zip(problem.segments, problem.terms, parts, strict=True):
        course, _ = segment.at(own)
        natural += sum(term.at(course).cost for term in terms)
        effort += segment.effort(own)
        expected += segment.effort(segment.expected)
    return MotionSolution(
        weights=np.concatenate([motion.weights for motion in motions]),
        objective_cost=float("nan") if setting.is_shortest else found.cost - natural,
        effort_cost=effort,
        naturalness_cost=natural,
        start_cost=expected,
        converged=found.converged,
        iterations=passes,
        kkt_residual=found.kkt_residual,
    )
