# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The server of goals: plans, joins, publishes, monitors and stops motions.

This is the core of the node; it is independent of ROS.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ...exceptions import GoalError, PlannerError
from ...motion.goal import Goal, JointGoal, JointState
from ...motion.validation import check_executable, check_limits
from ...primitives.primitive import MovementPrimitive
from ...robot.world import World
from ..options import ServingOptions
from ..threads import BusyError, CancelledError, IsCancelled
from ..tracking.following import UnconfirmedError
from ..tracking.measured import LateStateError
from ..tracking.start_state import StartStates, TooLateError
from ..tracking.state_sources import Clock
from .assembly import Model, unknown_positions
from .execution import Execution, ExecutionReport, Served
from .goal_planner import AdaptedPlan, AnyPlan, GoalPlanner, GoalRequest, Planned, PlanRequest
from .motion_monitor import MotionMonitor, Publish


class GoalStatistics:
    """Counts of goals and their latest times, for several threads.

    Attributes
    ----------
    counts : dict of int
        Goals by outcome: with a published motion, without one, the same as the one under way, and
        preempted by newer ones or by a stop.
    """

    def __init__(self, options: ServingOptions | None = None) -> None:
        self._options = options or ServingOptions()
        self.counts = {"served": 0, "refused": 0, "under_way": 0, "overtaken": 0}
        self._lock = threading.Lock()
        # Enough times for a 99th percentile; older ones are discarded, because they may be
        # outdated.
        self._solve_times: deque[float] = deque(maxlen=1000)
        # By kind: sequences take longer than single goals.
        self._latencies: dict[type[Goal], deque[float]] = defaultdict(lambda: deque(maxlen=100))

    def count(self, outcome: str) -> None:
        """Count a goal with one of the outcomes of `counts`."""
        with self._lock:
            self.counts[outcome] += 1

    def served(self, kind: type[Goal], solve_time: float, latency: float) -> None:
        """Count a goal whose motion was published.

        Parameters
        ----------
        kind : type
            Kind of the goal.
        solve_time : float
            Time that the planner took [s].
        latency : float
            Time from choosing the start to publishing [s].
        """
        self.count("served")
        with self._lock:
            self._solve_times.append(solve_time)
            self._latencies[kind].append(latency)

    def expected_latency(self, kind: type[Goal]) -> float:
        """Time from choosing a start to publishing that few goals of a kind exceed [s]."""
        with self._lock:
            recent = list(self._latencies[kind])
        if not recent:
            return self._options.initial_latency
        return self._options.latency_margin * float(np.percentile(recent, 90))

    def solve_time_percentiles(self) -> dict[str, float]:
        """Percentiles of the latest solve times by name [s]; none before the first goal."""
        with self._lock:
            times = list(self._solve_times)
        if not times:
            return {}
        return {f"solve_time_p{rank}_s": float(np.percentile(times, rank)) for rank in (50, 90, 99)}


class MotionServer(MotionMonitor):
    """Plans motions for goals and publishes them.

    Parameters
    ----------
    states :
        Source of the start states of motions.
    statistics :
        Counts of goals and their latencies.
    publish :
        Sends a trajectory to the controller.
    clock :
        The clock of planning times [s]: never set back.
    report :
        Called with the outcome of each published motion.
    sleep :
        Waits for a time [s].
    options :
        Parameters.
    """

    def __init__(
        self,
        states: StartStates,
        statistics: GoalStatistics,
        publish: Publish,
        clock: Clock,
        report: Callable[[ExecutionReport], None] = lambda _: None,
        sleep: Callable[[float], None] = time.sleep,
        options: ServingOptions | None = None,
    ) -> None:
        super().__init__(states, publish, clock, report, options)
        self._statistics, self._clock, self._sleep = statistics, clock, sleep
        self._planner = GoalPlanner(states, clock, self.options)

    @property
    def served(self) -> Served | None:
        """The goal that was served last; None if the robot was stopped since."""
        execution = self.states.execution
        return None if execution is None else execution.served

    def serve(
        self, request: GoalRequest, is_cancelled: IsCancelled, *, lookahead: float = 0.0
    ) -> Served:
        """Plan and publish a motion.

        Parameters
        ----------
        request :
            The goal.
        is_cancelled :
            Whether the goal was preempted.
        lookahead :
            Least time that is planned ahead [s].

        Raises
        ------
        PlannerError
            If the goal can't be served; nothing was published then.
        CancelledError
            If it is preempted before it is published.
        """
        options, latency = self.options, self._statistics.expected_latency(type(request.goal))
        if isinstance(request.goal, JointGoal):
            latency = max(min(latency, options.max_lookahead), lookahead)
        deadline, attempt = self._clock() + options.confirmation_timeout, 1
        while True:
            began = self.states.motion_time
            try:
                return self._serve_once(request, is_cancelled, latency)
            except (UnconfirmedError, LateStateError) as error:
                # States that ceased long ago do not come back soon.
                age, is_late = self.states.measured.age, isinstance(error, LateStateError)
                is_over = is_late and (age is None or age > options.late_states)
                if is_over or self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(options.confirmation_period)
                with suppress(BusyError):  # the thread that watches does so just now
                    self.watch(request.model)
            except TooLateError:
                # While there is time before a collision, a stop is no better than a motion.
                if attempt >= options.max_attempts and not lookahead:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                attempt += 1
                latency = 2.0 * max(self.states.motion_time - began, latency)

    def _serve_once(
        self, request: GoalRequest, is_cancelled: IsCancelled, latency: float
    ) -> Served:
        self.surroundings.settle(is_cancelled)
        began, model, last = self._clock(), request.model, self.served
        start = self.states.choose(model.settings, latency)
        model.cancellation.is_cancelled = is_cancelled
        goal = request.goal_from(start.state)
        under_way = last.answer(goal, start, model) if last is not None else ""
        if last is not None and under_way and self.surroundings.threat is None:
            return replace(last, under_way=under_way)
        world = self.surroundings.prepare(model)
        if unknown := unknown_positions(model, world):
            raise GoalError(unknown)
        context = PlanRequest(start, model, is_cancelled, last)
        planned = self._planner.plan(goal, context)
        self.surroundings.settle(is_cancelled)
        world = self.surroundings.check_again(planned[0].trajectory, world, model)
        served = self._publish(goal, planned, context, request.name, world)
        self._statistics.served(type(request.goal), served.plan.solve_time, self._clock() - began)
        return served

    def _publish(
        self, goal: Goal, planned: Planned, request: PlanRequest, name: Any, world: World
    ) -> Served:
        """Publish a plan from where the robot is: the only place where goals are published.

        Whatever can be rejected is checked before: a published motion is never rejected.
        """
        start, model, settings = request.start, request.model, request.model.settings
        (plan, trial), first = planned, start.state
        check = plan.limit_check
        if start.is_in_motion:
            # The trajectory that is published a moment later is a part of this one.
            joined = self.states.join(plan.trajectory, start, settings)
            check = check_limits(joined.trajectory, model.planning_robot, model.limits)
            if check.violations:  # at another place, they join within the limits
                raise TooLateError(
                    f"where the motion joins the one under way, the {check.violations[0]}; send "
                    "the goal again"
                )
        may_end_moving = settings.allow_nonzero_end_velocity
        primitives = _primitives_of(plan, request)
        with self.states.lock:
            if request.is_cancelled():
                raise CancelledError
            joined = self.states.join(plan.trajectory, start, settings)
            if start.is_in_motion:
                threat = self.surroundings.threat
                if threat is not None and start.time >= threat.time:
                    raise GoalError(f"{threat.reason} before another motion could begin")
                first = JointState(first.joint_names, joined.trajectory.positions[0])
            check_executable(
                joined.trajectory, check, first, allow_nonzero_end_velocity=may_end_moving
            )
            served = Served(goal, plan, model, joined.motion, name, trial, primitives)
            self._commit(joined, Execution(name, joined.motion, joined.time, served), world)
        return served


def _primitives_of(plan: AnyPlan, request: PlanRequest) -> tuple[MovementPrimitive, ...]:
    """The primitives of a plan; a displaced motion has those of the motion before."""
    if isinstance(plan, AdaptedPlan):
        return () if request.last is None else request.last.primitives
    library = request.model.planner.primitives
    return tuple(map(library.named, dict.fromkeys(plan.primitives)))


def avoid_obstacle(
    server: MotionServer, model: Model, is_cancelled: IsCancelled
) -> tuple[str, Served | None]:
    """Replace the running motion if it would hit an obstacle; stop the robot if that fails.

    Call this in the thread that serves goals.

    Parameters
    ----------
    server : MotionServer
        Serves the goals of the motions.
    model : Model
        The planner and its settings.
    is_cancelled : callable
        Whether a newer goal came.

    Returns
    -------
    message : str
        What was done, one sentence; empty if there is nothing to avoid.
    served : Served or None
        The new motion, if there is one.

    Raises
    ------
    PlannerError
        If the robot could not even be stopped.
    CancelledError
        If a newer goal preempts it.
    """
    states, options = server.states, server.options
    served, threat = server.served, server.surroundings.threat
    if served is None or threat is None:
        return "", None
    last, reason = threat.last_time(options), threat.reason

    def is_over() -> bool:
        return is_cancelled() or states.motion_time > last

    goal = served.rest_of_goal(states.motion_time - served.motion.began)
    try:
        if is_over():
            raise CancelledError
        request = GoalRequest(goal, model, served.name)
        found = server.serve(request, is_over, lookahead=options.avoidance_lookahead)
    except Exception as error:  # whatever the reason, the robot must not hit the obstacle
        if is_cancelled():
            raise CancelledError from None
        why = str(error) or "there was no time to plan another motion"
        return f"{reason}: {server.stop_before(threat, model)}, because {why}", None
    return f"{reason}: another motion leads to the goal", found


def go_on(
    server: MotionServer, model: Model, is_cancelled: IsCancelled
) -> tuple[str, Served | None]:
    """Go on to the goal of a motion that was stopped before an obstacle, if it is due.

    Call this in the thread that serves goals.

    Parameters
    ----------
    server, model, is_cancelled :
        See :func:`avoid_obstacle`.

    Returns
    -------
    message : str
        What was done, one sentence; empty if there is nothing to do.
    served : Served or None
        The new motion, if there is one.

    Raises
    ------
    CancelledError
        If a newer goal preempts it.
    """
    resumption = server.resumption
    if resumption is None:
        return "", None
    resumption.tried, resumption.world = server.states.motion_time, server.surroundings.world
    try:
        request = GoalRequest(resumption.goal, model, resumption.name)
        return "the robot goes on to its goal", server.serve(request, is_cancelled)
    except PlannerError as error:
        return f"the robot waits before an obstacle: {error}", None
