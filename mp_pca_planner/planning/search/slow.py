# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Slow motions without optimisation, for requests without an optimised motion within the limits.

A moving robot is braked first; then the motion leads from rest to rest, see :mod:`.stop_and_go`. It
takes a few milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, TrajectoryError
from ...motion.goal import JointState
from ..context import Context, check_duration
from ..options import SHORTEST
from ..plan import MotionSolution
from ..program.bases import MotionBasis
from ..program.tables import Tables
from ..request import Request
from ..time_scaling import slowdown
from .budget import Budget
from .candidate import Candidate, checked, sampled
from .detours import corners_of, paths
from .stop_and_go import StopAndGo, stop_and_go

Corners = tuple[FloatArray, ...]
"""Points between the ends of each segment at which a motion rests, shape (n_corners, n_joints)."""


@dataclass(frozen=True, eq=False)
class Slow:
    """Result of a search for a slow motion.

    Attributes
    ----------
    candidate : Candidate or None
        The motion, within the limits and without collisions; None if there is none with the
        requested duration.
    duration : float
        A feasible duration [s]; NaN if none is known.
    reason : str
        Why there is no motion in any duration; empty if there is one.
    is_blocked : bool
        Whether a collision is the reason.
    """

    candidate: Candidate | None = None
    duration: float = float("nan")
    reason: str = ""
    is_blocked: bool = False


def slow_motion(
    context: Context,
    requests: Iterable[Request],
    failed: Candidate,
    earlier: Sequence[Candidate],
    budget: Budget,
) -> Slow:
    """Find a slow motion for the first request that has one.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    requests : iterable of Request
        Requests for one goal, with several configurations or several primitives.
    failed : Candidate
        The best of the candidates that failed.
    earlier : sequence of Candidate
        All of them, with corners of paths that are known.
    budget : Budget
        The time for further paths.
    """
    feasible, reason, is_blocked, done = float("inf"), "", False, list[JointState]()
    for request in requests:
        if request.goal in done:  # requests for one configuration differ in their primitives only
            continue
        done.append(request.goal)
        path = next(
            (
                c.corners
                for c in earlier
                if c.request.goal is request.goal and c.corners is not None
            ),
            None,
        )
        for usual in _usual_durations(context, request):
            try:
                found = _around(context, request, failed, usual, path, budget)
            except (GoalError, TrajectoryError) as error:
                reason = reason or str(error)
                continue
            if found.collisions:
                is_blocked = is_blocked or not reason
                reason = reason or str(found.collisions[0])
                continue
            if found.strayed:
                reason = reason or f"it does not keep {found.strayed[0]}"
                continue
            asked = float(usual.sum())
            if request.duration_is_free or found.duration <= asked * (1.0 + 1e-9):
                return Slow(found)
            feasible = min(feasible, found.duration)
    if np.isfinite(feasible):
        return Slow(duration=feasible)
    return Slow(reason=reason, is_blocked=is_blocked)


def _usual_durations(context: Context, request: Request) -> list[FloatArray]:
    """Durations of the segments to try, not below the least ones [s]."""
    usual = np.array([segment.duration for segment in request.segments])
    if request.mode:
        return [usual]
    if request.duration_is_free:
        return [0.0 * usual if request.timing == SHORTEST else usual]
    return [usual, 0.0 * usual]


def _around(
    context: Context,
    request: Request,
    failed: Candidate,
    usual: FloatArray,
    path: FloatArray | None,
    budget: Budget,
) -> Candidate:
    """The slow motion of a request, around obstacles if paths are known or found."""
    none = np.zeros((0, context.robot.n_joints))
    if path is not None:
        return _slow(context, request, failed, usual, (path[1:-1],))
    found = _slow(context, request, failed, usual, (none,) * len(request.segments))
    if not (request.mode and found.collisions):  # paths of one segment were searched before
        return found
    corners = []
    for segment in request.segments:
        ends = segment.start.positions, segment.goal.positions
        around = next(paths(context, ends, budget), None)
        if around is None:
            return found
        corners.append(corners_of(context, around)[1:-1])
    try:
        other = _slow(context, request, failed, usual, tuple(corners))
    except (GoalError, TrajectoryError):
        return found
    return other if other.is_valid else found


def _slow(
    context: Context, request: Request, failed: Candidate, usual: FloatArray, corners: Corners
) -> Candidate:
    """The slow motion that rests at all targets and corners.

    Raises
    ------
    GoalError, TrajectoryError
        If it would take too long, or no durations keep the limits.
    """
    route, period = _route(context, request, corners), context.options.sample_period
    counts = [1 + len(part) for part in corners]
    if route.moves_at_ends:  # the knots of a brake are points of the trajectory
        first = _durations(context, request, route, counts, usual)[: counts[0]].sum()
        step = float(first / np.ceil(first / period - 1e-9))
        route = _route(context, request, corners, step)
    for _ in range(context.options.braking.max_stretches):
        durations = _durations(context, request, route, counts, usual)
        motions = route.motions(durations, counts)
        _, check = sampled(context, motions)
        if not check.violations:
            break
        route = route.slowed(slowdown(check.violations))
    else:
        raise TrajectoryError(str(check.violations[0]))
    n_nodes = context.options.n_nodes
    bases = tuple(MotionBasis.fixed(Tables(motion.basis, n_nodes)) for motion in motions)
    found = checked(context, request, bases, motions)
    solution = _not_optimised(failed.solution)
    return replace(found, solution=solution, n_stops=sum(map(len, corners)))


def _route(
    context: Context, request: Request, corners: Corners, step: float | None = None
) -> StopAndGo:
    """The fastest motion with rests at targets and corners."""
    states = [request.start]
    for segment, points in zip(request.segments, corners, strict=True):
        states += [JointState(context.robot.joint_names, q) for q in points]
        states.append(segment.goal)
    step = context.options.sample_period if step is None else step
    return stop_and_go(context.robot, context.limits, states, step, context.options.braking)


def _durations(
    context: Context, request: Request, route: StopAndGo, counts: Sequence[int], usual: FloatArray
) -> FloatArray:
    """Durations of the legs, which share out those of the segments, shape (n_legs,) [s]."""
    legs, firsts = route.durations, np.cumsum([0, *counts[:-1]])
    least = np.add.reduceat(legs, firsts)
    if request.mode:
        durations = request.resting_durations(least, usual)
    else:
        durations = np.maximum(least, usual)
    if route.moves_at_ends and not (request.mode and request.groups[0][1]):
        # Between other points, the controller's quintics would exceed the jerk of the brake.
        durations[0] = route.step * np.ceil(durations[0] / route.step - 1e-9)
    check_duration(context, "the slow motion would take", float(durations.sum()))
    return legs * np.repeat(durations / least, counts)


def _not_optimised(failed: MotionSolution) -> MotionSolution:
    """The result of the solver for a slow motion; its costs are computed in the report."""
    unknown = float("nan")
    return replace(
        failed,
        weights=np.zeros(0),
        objective_cost=unknown,
        effort_cost=unknown,
        naturalness_cost=0.0,
        converged=False,
    )
