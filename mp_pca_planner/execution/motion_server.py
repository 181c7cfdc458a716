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
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ..exceptions import GoalError
from ..motion.goal import Goal, JointGoal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from .assembly import Model
from .execution_monitor import ExecutionMonitor, ExecutionReport
from .following import UnconfirmedError
from .goal_planner import AnyPlan, GoalPlanner, PlanRequest
from .measured import Clock
from .options import ServingOptions
from .preemptive_worker import CancelledError, IsCancelled
from .published_motion import Joined, PublishedMotion
from .served_goal import Served
from .start_state import StartStates, TooLateError
from .stopping import StopPlanner
from .surroundings import Surroundings


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


MakeGoal = Callable[[JointState], Goal]
"""Function that returns the goal of a motion, given its start state."""


class Publish(Protocol):
    """Sends a trajectory to the controller."""

    def __call__(
        self, trajectory: Trajectory, *, stamp: float | None, last_point_only: bool
    ) -> None:
        """Send it; it starts at the stamp [s], or when it is received if there is none."""


class MotionServer:
    """Plans motions, publishes them, and stops them.

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

    Attributes
    ----------
    states, options
        As given.
    surroundings : Surroundings
        The obstacles around the robot.
    served : Served or None
        The goal that was served last, if the robot was not stopped since.
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
        self.options, self.states = options or ServingOptions(), states
        self._statistics, self._send = statistics, publish
        self._clock, self._sleep = clock, sleep
        self._planner = GoalPlanner(states, clock, self.options)
        self._monitor = ExecutionMonitor(report, self.options)
        self.surroundings = Surroundings(states)
        self._stops = StopPlanner(states, self.surroundings, clock, self.options)
        self.served: Served | None = None
        # Goals are served in a thread of their own, stops in that of the callbacks.
        self._publishing = threading.Lock()

    def serve(
        self,
        kind: type[Goal],
        make_goal: MakeGoal,
        model: Model,
        is_cancelled: IsCancelled,
        name: Any = None,
        *,
        lookahead: float = 0.0,
    ) -> Served:
        """Plan and publish a motion.

        Parameters
        ----------
        kind :
            The kind of the goal: some take longer than others.
        make_goal :
            The goal, for a motion that starts at this state.
        model :
            The planner and its settings.
        is_cancelled :
            Whether the goal was preempted.
        name :
            Identifies the goal in the report of its execution.
        lookahead :
            Least time that is planned ahead [s].

        Raises
        ------
        PlannerError
            If the goal can't be served; nothing was published then.
        CancelledError
            If it is preempted before it is published.
        """
        options, latency = self.options, self._statistics.expected_latency(kind)
        if kind is JointGoal:
            latency = max(min(latency, options.max_lookahead), lookahead)
        deadline, attempt = self._clock() + options.confirmation_timeout, 1
        while True:
            began = self.states.motion_time
            try:
                return self._serve_once(kind, make_goal, model, is_cancelled, name, latency)
            except UnconfirmedError:
                if self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(options.confirmation_period)
                self.watch(model)
            except TooLateError:
                if attempt == options.max_attempts:
                    raise
                attempt += 1
                latency = 2.0 * max(self.states.motion_time - began, latency)

    def watch(self, model: Model) -> None:
        """Check how the robot follows its motion; call this at 10 Hz or more."""
        # No motion may be published in between: the robot would seem to follow the one before.
        with self._publishing:
            try:
                following = self.states.follow(model.settings)
            except GoalError:
                following = None
            now = self.states.motion_time
            self._monitor.update(following, now)
            if self._monitor.never_started(now):
                self.states.give_up()

    def stop(self, model: Model, reason: str = "") -> str:
        """Publish a trajectory that brings the robot to rest.

        Parameters
        ----------
        model :
            The planner and its settings.
        reason :
            Why, for the report of the execution.

        Returns
        -------
        :
            Description of the stop, one sentence.

        Raises
        ------
        PlannerError
            If the robot's state is unknown; nothing was published then.
        """
        with self._publishing:
            found = self._stops.find(model)
            motion = self._publish_joined(found.joined)
            self._monitor.stop(motion, found.joined.time, found.after(reason))
            self.served = self.surroundings.threat = None
        return found.message

    def _serve_once(
        self,
        kind: type[Goal],
        make_goal: MakeGoal,
        model: Model,
        is_cancelled: IsCancelled,
        name: Any,
        latency: float,
    ) -> Served:
        began = self._clock()
        start = self.states.choose(model.settings, latency)
        model.cancellation.is_cancelled = is_cancelled
        goal, served = make_goal(start.state), self.served
        under_way = served.answer(goal, start, model) if served is not None else ""
        if served is not None and under_way and self.surroundings.threat is None:
            return replace(served, under_way=under_way)
        world = self.surroundings.prepare(model)
        request = PlanRequest(start, model, is_cancelled, served)
        plan, trial = self._planner.plan(goal, request)
        world = self.surroundings.check_again(plan.trajectory, world, model)
        motion = self._publish(plan, request, name)
        self._statistics.served(kind, plan.solve_time, self._clock() - began)
        self.served, self.surroundings.threat = Served(goal, plan, model, motion, name, trial), None
        if self.surroundings.world is not world:
            self.surroundings.look_ahead(model, self.served)
        return self.served

    def _publish(self, plan: AnyPlan, request: PlanRequest, name: Any) -> PublishedMotion:
        """Publish a plan from where the robot is: the only place where goals are published."""
        start, model, settings = request.start, request.model, request.model.settings
        check, first = plan.limit_check, start.state
        if start.is_in_motion:
            # The trajectory that is published a moment later is a part of this one.
            joined = self.states.join(plan.trajectory, start, settings)
            check = check_limits(joined.trajectory, model.planning_robot, model.limits)
        with self._publishing:
            if request.is_cancelled():
                raise CancelledError
            joined = self.states.join(plan.trajectory, start, settings)
            if start.is_in_motion:
                first = JointState(first.joint_names, joined.trajectory.positions[0])
            check_executable(
                joined.trajectory,
                check,
                first,
                allow_nonzero_end_velocity=settings.allow_nonzero_end_velocity,
            )
            motion = self._publish_joined(joined)
            self._monitor.begin(name, motion, joined.time, self.surroundings.reason)
        return motion

    def _publish_joined(self, joined: Joined) -> PublishedMotion:
        self._send(joined.trajectory, stamp=joined.stamp, last_point_only=joined.last_point_only)
        return self.states.command(joined)
