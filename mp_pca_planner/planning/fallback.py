# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Slow motions without optimisation, for requests without an optimised motion within the limits.

A moving robot is braked first; then the motion leads from rest to rest, see :mod:`.stop_and_go`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.goal import JointState
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .attempt import Attempt, checked
from .bases import fixed_basis
from .budget import Budget
from .conditions import PoseTarget, Target
from .motion import Motion
from .paths import PathFinder
from .plan import SHORTEST
from .pose_search import configurations_at
from .request import Request
from .sequence_request import SequenceRequest, fit_durations, passing_phases
from .setup import Setup
from .states import unwrapped
from .stop_and_go import StopAndGo, stop_and_go
from .unknowns import QuadratureTables

Paths = dict[int, FloatArray]
"""Corners of collision-free paths, shape (n_corners, n_joints), by the `id` of the goal state."""


@dataclass(frozen=True)
class Fallback:
    """Result of a search for a slow motion.

    Attributes
    ----------
    attempt : Attempt or None
        The motion, within the limits and without collisions; None if there is none with the
        requested duration.
    duration : float
        A feasible duration [s]; NaN if none is known.
    reason : str
        Why there is no motion in any duration; empty if there is one.
    n_corners : int
        Number of the corners of a known path at which the motion rests.
    """

    attempt: Attempt | None = None
    duration: float = float("nan")
    reason: str = ""
    n_corners: int = 0


@dataclass(frozen=True)
class Route:
    """States of a motion with rests between them.

    Attributes
    ----------
    states : list of JointState
        The states, the start first.
    phases : list of (float or None)
        Phase at the end of each segment, None where it is free.
    targets : list of int
        The segments that end at vias and at the goal; others end at corners around obstacles.
    """

    states: list[JointState]
    phases: list[float | None]
    targets: list[int]

    @property
    def n_corners(self) -> int:
        """Number of the corners around obstacles."""
        return len(self.phases) - len(self.targets)


class FallbackPlanner:
    """Search for slow motions, which takes a few milliseconds.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self._finder = setup, PathFinder(setup)

    @property
    def hint(self) -> str:
        """Which extra is missing for further paths; empty if none."""
        return self._finder.hint

    def serve(
        self, requests: Sequence[Request], failed: Attempt, paths: Paths, budget: Budget
    ) -> Fallback:
        """Find a slow motion for the first request that has one.

        Parameters
        ----------
        requests : sequence of Request
            Requests for one goal, with several configurations or several primitives.
        failed : Attempt
            The best attempt to optimise a motion.
        paths : dict
            Collision-free paths that are known.
        budget : Budget
            The time for further paths, between vias.
        """
        feasible, reason = float("inf"), ""
        configurations: dict[int, Request] = {}
        for request in requests:  # requests for one configuration differ in their primitives only
            configurations.setdefault(id(request.goal), request)
        for request in configurations.values():
            for at_least, step in self._timings(request):
                try:
                    route = _route(self._setup, request, paths.get(id(request.goal)))
                    attempt = self._attempt(request, failed, at_least, step, route)
                    blocked = attempt.collisions and request.n_vias
                    around = self._around(route, budget) if blocked else None
                    if around is not None:
                        route = around
                        attempt = self._attempt(request, failed, at_least, step, route)
                except (GoalError, TrajectoryError) as error:
                    reason = reason or str(error)
                    continue
                if attempt.collisions:
                    reason = reason or str(attempt.collisions[0])
                    continue
                duration = attempt.duration
                if request.duration_is_free or duration <= at_least * (1.0 + 1e-9):
                    return Fallback(attempt, n_corners=route.n_corners)
                feasible = min(feasible, duration)
        return Fallback(duration=feasible) if np.isfinite(feasible) else Fallback(reason=reason)

    def _timings(self, request: Request) -> list[tuple[float, float]]:
        """Least durations to try, each with the time between the points of its trajectory [s]."""
        duration, period = request.usual_duration, self._setup.options.sample_period
        if request.duration_is_free:
            return [(0.0 if self._setup.options.timing == SHORTEST else duration, period)]
        n_steps = max(np.ceil(duration / period - 1e-9), 1.0)
        return [(duration, duration / n_steps), (0.0, period)]

    def serve_sequence(self, request: SequenceRequest, failed: Attempt, budget: Budget) -> Fallback:
        """Find a motion that rests at each target of a sequence, and where obstacles demand it."""
        period = self._setup.options.sample_period
        try:
            route = stop_and_go(self._setup.robot, self._setup.limits, request.states, period)
            if route.moves_at_ends:  # the knots of a brake are points of the trajectory
                first = request.resting_durations(route.durations, route.step)[0]
                step = first / float(np.ceil(first / period - 1e-9))
                route = stop_and_go(self._setup.robot, self._setup.limits, request.states, step)
            durations = route.slowed(
                self._setup.robot,
                self._setup.limits,
                lambda slower: request.resting_durations(slower.durations, slower.step),
                lambda times: self._setup.sample(route.segments(times)),
            )
        except (GoalError, TrajectoryError) as error:
            return Fallback(reason=str(error))
        phases = passing_phases(durations)
        attempt = self._attempt_of(request, failed, route.segments(durations), phases)
        if not attempt.collisions:
            return Fallback(attempt)
        try:
            around = self._legs_around(request, budget)
        except (GoalError, TrajectoryError):
            around = None
        if around is not None:
            phases = passing_phases([motion.duration for motion, _ in around])
            motions = tuple(motion for motion, _ in around)
            found = self._attempt_of(request, failed, motions, phases)
            if found.is_valid:
                return Fallback(found, n_corners=sum(n for _, n in around))
        return Fallback(reason=str(attempt.collisions[0]))

    def _legs_around(
        self, request: SequenceRequest, budget: Budget
    ) -> list[tuple[Motion, int]] | None:
        """Motions from target to target around obstacles, each with the number of its corners.

        None unless the robot is at rest, all times are free and there are paths.
        """
        moves = np.any([request.start.velocities, request.start.accelerations])
        if moves or any(is_fixed for _, is_fixed in request.groups):
            return None
        legs = []
        for here, there in pairwise(request.states):
            route = self._around(Route([here, there], [1.0], [0]), budget)
            if route is None:
                return None
            legs.append((_leg(self._setup, route.states), route.n_corners))
        return legs

    def _around(self, route: Route, budget: Budget) -> Route | None:
        """A route with corners between its states; None if it has some, or none are found."""
        if route.n_corners:
            return None
        states, phases, targets = route.states[:1], list[float | None](), []
        for (here, there), phase in zip(pairwise(route.states), route.phases, strict=True):
            ends = here.positions, there.positions
            corners = self._finder.corners_between(ends, budget)
            if corners is None:
                return None
            states += [*(JointState(here.joint_names, q) for q in corners[1:-1]), there]
            phases += [*(None for _ in corners[1:-1]), phase]
            targets.append(len(phases) - 1)
        return Route(states, phases, targets)

    def _attempt(
        self, request: Request, failed: Attempt, at_least: float, step: float, route: Route
    ) -> Attempt:
        resting = stop_and_go(self._setup.robot, self._setup.limits, route.states, step)
        durations = resting.slowed(
            self._setup.robot,
            self._setup.limits,
            lambda slower: self._durations(slower, route.phases, at_least),
            lambda times: self._setup.sample([resting.motion(times)]),
        )
        found = resting.motion(durations)
        ends = np.cumsum(durations)[route.targets[:-1]] / found.duration
        reached = (*map(float, ends), 1.0)[: len(request.conditions)]
        return self._attempt_of(request, failed, (found,), reached)

    def _attempt_of(
        self,
        request: Request | SequenceRequest,
        failed: Attempt,
        motions: tuple[Motion, ...],
        phases: tuple[float, ...],
    ) -> Attempt:
        """The attempt of a slow motion, which replaces a failed one."""
        n_nodes = self._setup.options.n_nodes
        bases = tuple(fixed_basis(QuadratureTables(motion.basis, n_nodes)) for motion in motions)
        # The costs are computed in the assembly of the plan.
        unknown = float("nan")
        solution = replace(
            failed.solution,
            weights=np.zeros(0),
            objective_cost=unknown,
            effort_cost=unknown,
            naturalness_cost=0.0,
            converged=False,
        )
        return checked(self._setup, request, bases, motions, solution, phases)

    def _durations(
        self, motion: StopAndGo, phases: Sequence[float | None], at_least: float
    ) -> tuple[float, ...]:
        """Durations of the segments, which end at the given phases."""
        total, least = at_least, motion.durations
        began, first = 0.0, 0
        for i, phase in enumerate(phases):
            if phase is not None:
                total = max(total, float(least[first : i + 1].sum()) / (phase - began))
                began, first = phase, i + 1
        if motion.moves_at_ends:
            # The knots of a brake are points of the trajectory: between others, the controller's
            # quintics would exceed the jerk of the brake.
            total = motion.step * float(np.ceil(total / motion.step - 1e-9))
        self._setup.check_duration("the slow motion would take", total)
        times = [None if phase is None else phase * total for phase in phases]
        return fit_durations(least, times)


def _leg(setup: Setup, states: Sequence[JointState]) -> Motion:
    """The motion through some states with a rest at each."""
    route = stop_and_go(setup.robot, setup.limits, states, setup.options.sample_period)
    durations = route.slowed(
        setup.robot,
        setup.limits,
        lambda slower: tuple(slower.durations),
        lambda times: setup.sample([route.motion(times)]),
    )
    return route.motion(durations)


def _route(setup: Setup, request: Request, path: FloatArray | None) -> Route:
    """The route of a request, along a path if one is known."""
    if path is not None:
        corners = [JointState(request.start.joint_names, q) for q in path[1:-1]]
        states = [request.start, *corners, request.goal]
        return Route(states, [*(None for _ in corners), 1.0], [len(corners)])
    states = _targets(setup.robot, setup.limits, request)
    vias = request.conditions[: request.n_vias]
    return Route(states, [*(via.phase for via in vias), 1.0], list(range(len(vias) + 1)))


def _targets(robot: Robot, limits: JointLimits, request: Request) -> list[JointState]:
    """The states of a request: start, vias at rest, goal."""
    states = [request.start]
    for via in request.conditions[: request.n_vias]:
        q = _configuration(robot, limits, via.target, states[-1], request.goal)
        states.append(JointState(robot.joint_names, q))
    return [*states, request.goal]


def _configuration(
    robot: Robot, limits: JointLimits, target: Target, before: JointState, after: JointState
) -> FloatArray:
    """Positions that meet a target, shape (n_joints,), near those of two states.

    Raises
    ------
    GoalError
        If no configuration within the limits reaches a pose.
    """
    if isinstance(target, PoseTarget):
        starts = [before.positions, after.positions]
        return unwrapped(configurations_at(robot, limits, target.pose, starts)[0], before, robot)
    error, rows = target.error(before.positions)
    return np.asarray(before.positions - rows.T @ error)
