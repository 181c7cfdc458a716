# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Candidates: motions for a request, sampled and checked, however they were found."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter

import numpy as np

from ...arrays import FloatArray
from ...exceptions import TrajectoryError
from ...motion.collision import Collision, CollisionModel
from ...motion.goal import JointState
from ...motion.interpolation import GRID_PERIOD
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck, check_executable, check_limits
from ..configurations import POSE_TOLERANCE, nearest_configuration
from ..context import Budget, Context
from ..motion import Motion, rank_of, samples_of
from ..options import AUTO
from ..plan import NOT_SOLVED, MotionSolution
from ..program.compile import MotionBasis, Setting, compile_program, lasting
from ..program.constraints import Findings
from ..program.motion_program import MotionProgram
from ..program.segment import GOAL_POSITION
from ..request import Request
from ..solver import Solution, SolverMemory, solve

Violation = tuple[float, float, float, float]
"""Largest relative excess over a limit, penetration [m], violation of path constraints, and error
of a target [rad or m]."""

_Start = tuple[FloatArray, SolverMemory | None]
"""Unknowns to start from, and the state of a solver there."""

# Times that constraints are refined after a check on the dense grid, at most.
_MAX_REFINEMENTS = 8
# Violation of a path constraint that counts as rounding.
_ROUNDING = 1e-6

OPTIMISED, JOINED, SLOW = "optimised", "joined", "slow"
"""How a motion was found: optimised, by joining segments, or with rests, without optimisation."""


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
    target_errors : tuple of float
        Largest distances from the targets [rad or m].
    violation : Violation
        Violations of limits, clearances and targets, for the comparison of candidates.
    duration : float
        Duration of all segments [s].
    is_valid : bool
        Whether it may be executed and reaches the targets.
    has_clearances : bool
        Whether there were clearance constraints.
    strayed : tuple of str
        Path constraints that it violates.
    refusal : str
        Why a controller must not execute it, collisions aside; empty if it may.
    blocked : str
        Which end or target that is fixed is in collision, so that nothing helps; empty if none is.
    corners : array, shape (n_corners, n_joints), or None
        Corners of a collision-free path, if one is known but no valid motion near it.
    n_stops : int
        Number of rests of a slow motion between the targets.
    how : {'optimised', 'joined', 'slow'}
        How it was found.
    """

    request: Request
    bases: tuple[MotionBasis, ...]
    motions: tuple[Motion, ...]
    solution: MotionSolution
    naturalness: float
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    target_errors: tuple[float, ...]
    violation: Violation
    duration: float
    is_valid: bool
    has_clearances: bool = False
    strayed: tuple[str, ...] = ()
    refusal: str = ""
    blocked: str = ""
    corners: FloatArray | None = None
    n_stops: int = 0
    how: str = OPTIMISED

    @property
    def meets_bodies(self) -> bool:
        """Whether it, or an earlier motion of the same program, is in collision."""
        return bool(self.collisions) or self.has_clearances


def sampled(context: Context, motions: Sequence[Motion]) -> tuple[Trajectory, LimitCheck]:
    """The points of a motion of several segments, and their comparison with the limits.

    Raises
    ------
    GoalError
        If the motion would take too long or too short; nothing is sampled then.
    """
    context.check_duration("the motion would take", sum(map(attrgetter("duration"), motions)))
    times, states, end = [], [], 0.0
    for i, motion in enumerate(motions):
        own, values = samples_of(motion, context.options.sample_period)
        end += motion.duration
        times.append(end - motion.duration + own[min(i, 1) :])
        states.append(values[:, min(i, 1) :])
    q, v, a = np.concatenate(states, axis=1)
    trajectory = Trajectory(context.robot.joint_names, np.concatenate(times), q, v, a)
    return trajectory, check_limits(trajectory, context.robot, context.limits)


def met_at(model: CollisionModel, state: JointState) -> tuple[Collision, ...]:
    """The collisions of a robot that rests in the configuration of a state, the deepest first."""
    still = Trajectory.at_rest(state.joint_names, state.positions)
    return model.collisions(still, precisely=False)


def depth_of(collisions: Sequence[Collision]) -> float:
    """How much bodies collide, for the comparison of candidates: more than nothing for each."""
    return sum([POSE_TOLERANCE + one.penetration for one in collisions])


def least_violation(found: Sequence[Candidate]) -> Candidate:
    """The first of the candidates with the least violation."""
    return min(found, key=attrgetter("violation"))


def checked(
    context: Context,
    request: Request,
    bases: tuple[MotionBasis, ...],
    motions: tuple[Motion, ...],
) -> Candidate:
    """The candidate of motions, sampled and checked; its solution is unknown.

    Collisions are not checked if limits are violated: then another motion will be checked.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    bases, motions
        See :class:`Candidate`.
    """
    robot, (trajectory, check) = context.robot, sampled(context, motions)
    moving, refusal = context.options.allow_nonzero_end_velocity, ""
    try:
        check_executable(trajectory, check, motions[0].start, allow_nonzero_end_velocity=moving)
    except TrajectoryError as error:
        refusal = str(error)
    trajectory = trajectory.with_efforts(check.efforts)
    collisions: tuple[Collision, ...] = ()
    if context.collision is not None and not check.violations:
        collisions = context.collision.collisions(trajectory, precisely=False)
    strayed = list[tuple[str, float]]()
    for constraint in context.options.constraints:
        least = float(constraint.values(robot, trajectory.positions)[0].min())
        if least < -_ROUNDING:
            strayed.append((str(constraint), -least))
    errors = []
    for segment, motion in zip(request.segments, motions, strict=True):
        reached, pose = motion.goal.positions, segment.pose
        missed = reached - segment.goal.positions
        if pose is not None:
            missed, _ = robot.pose_error(pose.frame, reached, pose.position, pose.orientation)
        errors.append(float(np.abs(missed).max()))
    violation = (
        check.worst_excess if check.violations else 0.0,
        depth_of(collisions),
        sum([excess for _, excess in strayed]),
        0.0 if max(errors) <= POSE_TOLERANCE else max(errors),
    )
    return Candidate(
        request,
        bases,
        motions,
        NOT_SOLVED,
        request.naturalness,
        trajectory,
        check,
        collisions,
        tuple(errors),
        violation,
        sum(map(attrgetter("duration"), motions)),
        is_valid=not any(violation),
        strayed=tuple(name for name, _ in strayed),
        refusal=refusal,
    )


def attempt(context: Context, request: Request, setting: Setting, budget: Budget) -> Candidate:
    """Compile and solve a request; refine its constraints until the validator finds no violation.

    A duration that the planner made free is at most the predicted one, or the least one that is
    known to keep the limits: without gravity, the slowest motion has the least effort.

    Parameters
    ----------
    context, request, setting
        What to compile.
    budget : Budget
        The time for it.
    """
    found = _solved(context, request, setting, budget)
    if setting.is_timed and not request.is_shortest and context.options.timing == AUTO:
        longest = max(request.duration, setting.initial[0].duration)
        if found.duration > longest and not budget.is_late():
            return _solved(context, request, lasting(setting, longest), budget)
    return found


def _solved(context: Context, request: Request, setting: Setting, budget: Budget) -> Candidate:
    """The solution of a program whose constraints are refined by the validator.

    A refined program continues from its last solution; with new constraints also from the original
    start, because a detour on the side of the last solution may be blocked. A motion without the
    limits that it violates is far from those within them: then only from the original starts.
    """
    refined = program = compile_program(context, request, setting)
    originals: list[_Start] = [(x, None) for x in program.starts[: context.options.n_starts]]
    starts, passes, was_touched = originals, 0, False
    for _ in range(_MAX_REFINEMENTS):
        best, n_passes = _best_of(program, starts, setting, budget)
        passes += n_passes
        motions = _motions_at(context, request, setting, program, best.unknowns)
        began = time.perf_counter()
        found = checked(context, request, setting.bases, motions)
        took = time.perf_counter() - began
        budget.whole.longest_check = max(budget.whole.longest_check, took)
        is_wrong = bool(found.check.violations or found.collisions or found.strayed)
        if budget.is_late() if is_wrong else not found.check.touched or budget.is_late():
            break
        # A limit that is only touched may be exceeded between the points of the grid. It is
        # tightened only once, because an end of the motion may be at the limit.
        is_beyond = bool(found.check.violations)
        refined = program.refined(_findings(found, touches=not was_touched), is_beyond)
        is_longer = refined.lower.size != program.lower.size
        is_cut = is_longer and is_beyond
        if refined is program or not (best.converged or is_cut):
            break
        if not is_cut:
            was_touched = not is_beyond and (was_touched or bool(found.check.touched))
        if not is_longer:
            starts = [(best.unknowns, best.memory)]
        elif is_cut and not program.has_clearances:
            starts = originals
        else:
            curvature, radius, sides = best.memory
            memory = curvature, radius, sides[:0]  # the inequalities were renumbered
            starts = [(best.unknowns, memory), originals[0]]
        program = refined
    natural = effort = expected = 0.0
    parts = program.parts(best.unknowns) or ()
    for segment, (own, _) in zip(program.segments, parts, strict=True):
        natural += segment.naturalness(own)[0]
        effort += segment.effort(own)
        expected += segment.effort(segment.expected)
    # The objective of the shortest motion is not the planner's.
    objective = float("nan") if request.is_shortest else best.cost - natural
    costs = objective, effort, natural, expected
    return replace(
        found,
        solution=MotionSolution(*costs, best.converged, passes, best.kkt_residual),
        naturalness=setting.naturalness,
        has_clearances=refined.has_clearances,
    )


def _best_of(
    program: MotionProgram, starts: Sequence[_Start], setting: Setting, budget: Budget
) -> tuple[Solution, int]:
    """The best solution from some starts, and the evaluations of all of them."""

    def is_feasible(solution: Solution) -> bool:
        return solution.infeasibility <= setting.solver.feasible

    solutions = list[Solution]()
    for x, memory in starts:
        # Among clearance constraints, the first solution that meets them is enough.
        is_clear = program.has_clearances and solutions and is_feasible(solutions[-1])
        if is_clear or (solutions and budget.is_late()):
            break
        solutions.append(solve(program, x, setting.solver, memory, budget.is_late))
    passes = sum(map(attrgetter("iterations"), solutions))
    if len(solutions) == 1:
        return solutions[0], passes
    return min(solutions, key=lambda one: (not is_feasible(one), rank_of(one.cost))), passes


def _motions_at(
    context: Context, request: Request, setting: Setting, program: MotionProgram, x: FloatArray
) -> tuple[Motion, ...]:
    """The motions that unknowns stand for, with ends that are corrected to reach poses exactly."""
    if program.links is None:
        unknowns, goal = program.segments[0].unknowns, request.goal
        if request.pose is not None:
            goal = JointState(goal.joint_names, unknowns.boundary_at(x)[GOAL_POSITION])
        states = [(request.start, 0.0), (goal, unknowns.duration_at(x))]
        weights = [(x * unknowns.scales)[: unknowns.n_weights]]
    else:
        states, weights = program.links.states(x), program.links.weights(x)
    for i, segment in enumerate(request.segments, start=1):
        if (pose := segment.pose) is not None:
            state, time = states[i]
            q, _ = nearest_configuration(context.robot, context.limits, pose, state.positions)
            states[i] = JointState(state.joint_names, q, *state.values[1:]), time
    motions, parts = [], zip(pairwise(states), setting.bases, weights, strict=True)
    for ((here, began), (there, ended)), basis, own in parts:
        motions.append(basis.motion(here, there, ended - began, own))
    return tuple(motions)


def _findings(candidate: Candidate, *, touches: bool) -> list[Findings]:
    """What was found in each segment, with times from its start."""
    trajectory, check, parts, ended = candidate.trajectory, candidate.check, [], 0.0
    for motion in candidate.motions:
        began, ended = ended, ended + motion.duration
        # At a target, a violation may belong to either segment.
        first, last = began - GRID_PERIOD, ended + GRID_PERIOD
        own = (began <= trajectory.times) & (trajectory.times <= ended)
        violations = [one for one in check.violations if first <= one.time <= last]
        touched = [one for one in check.touched if first <= one.time <= last]
        phases = (trajectory.times[own] - began) / (ended - began)
        within = [one.within(began, ended) for one in candidate.collisions]
        parts.append(
            Findings(
                ended - began,
                trajectory.positions[own],
                phases,
                violations,
                touched if violations or touches else (),
                [one for one in within if one is not None],
            )
        )
    return parts
