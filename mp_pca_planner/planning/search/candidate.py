# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Candidates: motions that were found for a request, sampled and checked."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...motion.collision import Collision
from ...motion.trajectory import Trajectory
from ...motion.validation import GRID_PERIOD, LimitCheck
from ..configurations import POSE_TOLERANCE
from ..context import Context
from ..motion import Motion
from ..objectives import Effort
from ..plan import MotionSolution
from ..program.bases import MotionBasis
from ..program.compile import compile_problem
from ..program.constraints import Findings
from ..program.costs import cost_of, rank_of
from ..program.motions import motions_at
from ..program.problem import Problem
from ..program.setting import Setting
from ..program.targets import pose_error
from ..request import Request
from ..solver.program import FEASIBLE
from ..solver.sqp import Solution, SolverMemory, solve
from .budget import Budget
from .examine import Examined, examine

Violation = tuple[float, float, float, float]
"""Largest relative excess over a limit, penetration [m], violation of path constraints, and error
of a target [rad or m]."""

_Start = tuple[FloatArray, SolverMemory | None]
"""Unknowns to start from, and the state of a solver there."""


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
    duration : float
        Duration of all segments [s].
    is_valid : bool
        Whether it may be executed and reaches the targets.
    end_collision : tuple or None
        A collision at an end that is fixed, see :func:`collision_at_end`.
    has_clearances : bool
        Whether there were clearance constraints.
    strayed : tuple of str
        Path constraints that it violates.
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
    duration: float
    is_valid: bool
    end_collision: tuple[str, Collision] | None
    has_clearances: bool = False
    strayed: tuple[str, ...] = ()
    corners: FloatArray | None = None
    n_stops: int = 0

    @property
    def meets_bodies(self) -> bool:
        """Whether it, or an earlier motion of the same program, is in collision."""
        return bool(self.collisions) or self.has_clearances

    @property
    def is_hopeless(self) -> bool:
        """Whether bodies collide at an end of the motion that is fixed."""
        return self.end_collision is not None


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
    found, naturalness = examine(context, motions), context.options.naturalness
    solution = MotionSolution.unknown() if solution is None else solution
    now = time.perf_counter()
    return candidate(context, request, bases, motions, solution, naturalness, found, now)


def candidate(
    context: Context,
    request: Request,
    bases: tuple[MotionBasis, ...],
    motions: tuple[Motion, ...],
    solution: MotionSolution,
    naturalness: float,
    found: Examined,
    solved_at: float,
    *,
    has_clearances: bool = False,
) -> Candidate:
    """The candidate of a motion that was examined."""
    trajectory, check, collisions, strayed = found
    errors = []
    for segment, motion in zip(request.segments, motions, strict=True):
        missed = motion.goal.positions - segment.goal.positions
        if segment.pose is not None:
            missed, _ = pose_error(context.robot, segment.pose, motion.goal.positions)
        errors.append(float(np.abs(missed).max()))
    duration = float(sum([motion.duration for motion in motions]))
    violation = (
        check.worst_excess if check.violations else 0.0,
        sum([POSE_TOLERANCE + one.penetration for one in collisions]),
        sum([excess for _, excess in strayed]),
        0.0 if max(errors) <= POSE_TOLERANCE else max(errors),
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
        tuple(errors),
        violation,
        duration,
        is_valid=not any(violation),
        end_collision=collision_at_end(collisions, request, duration) if collisions else None,
        has_clearances=has_clearances,
        strayed=tuple([str(constraint) for constraint, _ in strayed]),
    )


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
    n_starts, passes, touched = context.options.n_starts, 0, False
    starts: Sequence[_Start] = [(x, None) for x in problem.starts[:n_starts]]
    for _ in range(context.options.search.max_refinements):
        solutions = list[Solution]()
        for x, memory in starts:
            # Among clearance constraints, the first solution that meets them is enough.
            is_clear = problem.has_clearances and solutions and _is_feasible(solutions[-1])
            if is_clear or (solutions and budget.is_over()):
                break
            solutions.append(solve(problem, x, setting.solver, memory, budget.deadline))
        best = solutions[0]
        if len(solutions) > 1:
            best = min(solutions, key=lambda one: (not _is_feasible(one), rank_of(one.cost)))
        solved_at = time.perf_counter()
        passes += sum([one.iterations for one in solutions])
        motions = motions_at(context, request, setting, problem, best.unknowns)
        found = examine(context, motions)
        is_wrong = bool(found.check.violations or found.collisions or found.strayed)
        if (is_wrong and budget.is_over()) or not (is_wrong or found.check.touched):
            break
        # A limit that is only touched may be exceeded between the points of the grid. It is
        # tightened only once, because an end of the motion may be at the limit.
        refined = problem.refined(
            _findings(request, motions, found, touches=not touched), bool(found.check.violations)
        )
        is_longer = refined.lower.size != problem.lower.size
        is_cut = is_longer and bool(found.check.violations)
        if refined is problem or not (best.converged or is_cut):
            break
        if not is_cut:
            touched = not found.check.violations and (touched or bool(found.check.touched))
        starts = _continued(problem, best, is_longer, is_cut, n_starts)
        problem = refined
    solution = _described(problem, setting, best, motions, passes)
    return candidate(
        context,
        request,
        setting.bases,
        motions,
        solution,
        setting.naturalness,
        found,
        solved_at,
        has_clearances=refined.has_clearances,
    )


def with_costs(context: Context, found: Candidate) -> Candidate:
    """A candidate whose costs are known, also if its motion was not optimised."""
    if np.isfinite(found.solution.objective_cost):
        return found
    objective = effort = 0.0
    for motion, basis in zip(found.motions, found.bases, strict=True):
        objectives = context.options.objectives
        objective += cost_of(context.robot, motion, basis.tables, objectives)
        effort += cost_of(context.robot, motion, basis.tables, [(1.0, Effort())])
    solution = replace(found.solution, objective_cost=objective, effort_cost=effort)
    return replace(found, solution=solution)


def _is_feasible(solution: Solution) -> bool:
    return solution.infeasibility <= FEASIBLE


def _findings(
    request: Request, motions: Sequence[Motion], found: Examined, *, touches: bool
) -> list[Findings]:
    """What was found in each segment, with times from its start.

    Nothing is done about collisions at an end that is fixed.
    """
    trajectory, check, collisions, _ = found
    ends = np.cumsum([0.0, *(motion.duration for motion in motions)]).tolist()
    if collision_at_end(collisions, request, ends[-1]):
        collisions = ()
    parts = []
    for began, ended in pairwise(ends):
        # At a target, a violation may belong to either segment.
        first, last = began - GRID_PERIOD, ended + GRID_PERIOD
        own = (began <= trajectory.times) & (trajectory.times <= ended)
        violations = [one for one in check.violations if first <= one.time <= last]
        touched = [one for one in check.touched if first <= one.time <= last]
        within = [one.within(began, ended) for one in collisions]
        parts.append(
            Findings(
                ended - began,
                trajectory.positions[own],
                (trajectory.times[own] - began) / (ended - began),
                violations,
                touched if violations or touches else (),
                [one for one in within if one is not None],
            )
        )
    return parts


def _continued(
    problem: Problem, best: Solution, is_longer: bool, is_cut: bool, n_starts: int
) -> Sequence[_Start]:
    """Where to start after a refinement.

    The last solution; with new constraints also the original start, because a detour on the side
    of the last solution may be blocked. A motion without the limits that it violates is far from
    those within them: then only the original starts.
    """
    if not is_longer:
        return [(best.unknowns, best.memory)]
    if is_cut and not problem.has_clearances:
        return [(x, None) for x in problem.starts[:n_starts]]
    # The inequalities were renumbered.
    return [(best.unknowns, best.memory.curvature_alone()), (problem.starts[0], None)]


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
        for term in terms:
            natural += term.at(course).cost
        effort += segment.effort(own)
        expected += segment.effort(segment.expected)
    weights = [motion.weights for motion in motions]
    return MotionSolution(
        weights=np.concatenate(weights),
        objective_cost=float("nan") if setting.is_shortest else found.cost - natural,
        effort_cost=effort,
        naturalness_cost=natural,
        start_cost=expected,
        converged=found.converged,
        iterations=passes,
        kkt_residual=found.kkt_residual,
    )
