# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The server of goals: plans motions, joins them to the present one, and has them published.

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
from ..tracking.start_state import TooLateError, choose_start, join
from .assembly import Model, unknown_positions
from .execution import Execution, GoalOutcome, Served
from .goal_planner import AdaptedPlan, AnyPlan, GoalPlanner, GoalRequest, Planned, PlanRequest
from .motion_monitor import MotionMonitor


class GoalStatistics:
    """Counts of goals and their latest times, for several threads.

    Attributes
    ----------
    counts : dict of int
        Goals by outcome.
    """

    def __init__(self, options: ServingOptions | None = None) -> None:
        self._options = options or ServingOptions()
        self.counts = dict.fromkeys(GoalOutcome, 0)
        self._lock = threading.Lock()
        # Enough times for a 99th percentile; older ones are discarded, because they may be
        # outdated.
        self._solve_times: deque[float] = deque(maxlen=1000)
        # By kind: sequences take longer than single goals.
        self._latencies: dict[type[Goal], deque[float]] = defaultdict(lambda: deque(maxlen=100))

    def count(self, outcome: GoalOutcome) -> None:
        """Count a goal."""
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
        self.count(GoalOutcome.SERVED)
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


class MotionServer:
    """Plans motions for goals, and has them published.

    Parameters
    ----------
    monitor :
        Publishes and monitors the motions.
    statistics :
        Counts of goals and their latencies.
    sleep :
        Waits for a time [s].

    Attributes
    ----------
    monitor
        As given.
    """

    def __init__(
        self,
        monitor: MotionMonitor,
        statistics: GoalStatistics,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.monitor = monitor
        self._follower, self._surroundings = monitor.follower, monitor.surroundings
        self._clock, self._options = monitor.clock, monitor.options
        self._statistics, self._sleep = statistics, sleep
        self._planner = GoalPlanner(self._follower, self._clock, self._options)

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
        options, latency = self._options, self._statistics.expected_latency(type(request.goal))
        if isinstance(request.goal, JointGoal):
            latency = max(min(latency, options.max_lookahead), lookahead)
        deadline, attempt = self._clock() + options.confirmation_timeout, 1
        while True:
            began = self._follower.motion_time
            try:
                return self._serve_once(request, is_cancelled, latency)
            except (UnconfirmedError, LateStateError) as error:
                # States that ceased long ago do not come back soon.
                age, is_late = self._follower.measured.age, isinstance(error, LateStateError)
                is_over = is_late and (age is None or age > options.late_states)
                if is_over or self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(options.confirmation_period)
                with suppress(BusyError):  # the thread that watches does so just now
                    self.monitor.watch(request.model)
            except TooLateError:
                # While there is time before a collision, a stop is no better than a motion.
                if attempt >= options.max_attempts and not lookahead:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                attempt += 1
                latency = 2.0 * max(self._follower.motion_time - began, latency)

    def avoid_obstacle(self, model: Model, is_cancelled: IsCancelled) -> tuple[str, Served | None]:
        """Replace the running motion if it would hit an obstacle; stop the robot if that fails.

        Parameters
        ----------
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
        served, threat = self.monitor.served, self._surroundings.threat
        if served is None or threat is None:
            return "", None
        last, reason = threat.last_time(self._options), threat.reason

        def is_over() -> bool:
            return is_cancelled() or self._follower.motion_time > last

        goal = served.rest_of_goal(self._follower.motion_time - served.motion.began)
        try:
            if is_over():
                raise CancelledError
            request = GoalRequest(goal, model, served.name)
            found = self.serve(request, is_over, lookahead=self._options.avoidance_lookahead)
        except Exception as error:  # whatever the reason, the robot must not hit the obstacle
            if is_cancelled():
                raise CancelledError from None
            why = str(error) or "there was no time to plan another motion"
            return f"{reason}: {self.monitor.stop_before(threat, model)}, because {why}", None
        return f"{reason}: another motion leads to the goal", found

    def go_on(self, model: Model, is_cancelled: IsCancelled) -> tuple[str, Served | None]:
        """Go on to the goal of a motion that was stopped before an obstacle, if it is due.

        See :meth:`avoid_obstacle`; it stops nothing.
        """
        resumption = self.monitor.resumption
        if resumption is None:
            return "", None
        resumption.tried, resumption.world = self._follower.motion_time, self._surroundings.world
        try:
            request = GoalRequest(resumption.goal, model, resumption.name)
            return "the robot continues to its goal", self.serve(request, is_cancelled)
        except PlannerError as error:
            return f"the robot waits before an obstacle: {error}", None

    def _serve_once(
        self, request: GoalRequest, is_cancelled: IsCancelled, latency: float
    ) -> Served:
        self._surroundings.settle(is_cancelled)
        began, model, last = self._clock(), request.model, self.monitor.served
        start = choose_start(self._follower, model.settings, latency)
        model.cancellation.is_cancelled = is_cancelled
        goal = request.goal_from(start.state)
        under_way = last.answer(goal, start, model) if last is not None else ""
        if last is not None and under_way and self._surroundings.threat is None:
            return replace(last, under_way=under_way)
        world = self._surroundings.prepare(model)
        if unknown := unknown_positions(model, world):
            raise GoalError(unknown)
        context = PlanRequest(start, model, is_cancelled, last)
        planned = self._planner.plan(goal, context)
        self._surroundings.settle(is_cancelled)
        world = self._surroundings.check_again(planned[0].trajectory, world, model)
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
            motion = join(self._follower, plan.trajectory, start, settings)
            check = check_limits(motion.sent, model.planning_robot, model.limits)
            if check.violations:  # at another place, they join within the limits
                raise TooLateError(
                    f"where the motion joins the one under way, the {check.violations[0]}; send "
                    "the goal again"
                )
        may_end_moving = settings.allow_nonzero_end_velocity
        primitives = _primitives_of(plan, request)
        with self._follower.lock:
            if request.is_cancelled():
                raise CancelledError
            motion = join(self._follower, plan.trajectory, start, settings)
            if start.is_in_motion:
                threat = self._surroundings.threat
                if threat is not None and start.time >= threat.time:
                    raise GoalError(f"{threat.reason} before another motion could begin")
                first = JointState(first.joint_names, motion.sent.positions[0])
            check_executable(motion.sent, check, first, allow_nonzero_end_velocity=may_end_moving)
            served = Served(goal, plan, model, motion, name, trial, primitives)
            self.monitor.publish(Execution(name, motion, served), world)
        return served


def _primitives_of(plan: AnyPlan, request: PlanRequest) -> tuple[MovementPrimitive, ...]:
    """The primitives of a plan; a displaced motion has those of the motion before."""
    if isinstance(plan, AdaptedPlan):
        return () if request.last is None else request.last.primitives
    library = request.model.planner.primitives
    return tuple(map(library.named, dict.fromkeys(plan.primitives)))
