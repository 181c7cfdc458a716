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
from typing import Any, Protocol

import numpy as np

from ..exceptions import GoalError
from ..motion.goal import Goal, JointGoal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from .assembly import Model
from .execution_monitor import Execution, ExecutionReport
from .following import UnconfirmedError
from .goal_planner import GoalPlanner, GoalRequest, Planned, PlanRequest
from .measured import Clock
from .options import ServingOptions
from .preemptive_worker import CancelledError, IsCancelled
from .published_motion import Joined
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
        self.options = options or ServingOptions()
        self.states = states
        self._statistics, self._send, self._report = statistics, publish, report
        self._clock, self._sleep = clock, sleep
        self._planner = GoalPlanner(states, clock, self.options)
        self.surroundings = Surroundings(states)
        self._stops = StopPlanner(states, self.surroundings, clock, self.options)

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
            except UnconfirmedError:
                if self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(options.confirmation_period)
                self.watch(request.model)
            except TooLateError:
                if attempt == options.max_attempts:
                    raise
                attempt += 1
                latency = 2.0 * max(self.states.motion_time - began, latency)

    def watch(self, model: Model) -> None:
        """Check how the robot follows its motion; call this at 10 Hz or more.

        The robot is stopped if it would hit an obstacle soon, whatever is being planned.
        """
        with self.states.lock:
            try:
                following = self.states.follow(model.settings)
            except GoalError:
                following = None
            execution, now = self.states.execution, self.states.motion_time
            if execution is not None and self.states.commanded is None:
                self._end(execution.given_up("time was set back"))
            elif execution is not None:
                self._end(execution.update(following, now, self.options))
            threat = self.surroundings.threat
            if threat is not None and now > threat.last_time(self.options):
                self.stop(model, threat.reason)

    def expect(self, joint_names: tuple[str, ...], model: Model | None = None) -> bool:
        """Use the states of these joints; returns whether they are others.

        A running motion is stopped then, with the model before.
        """
        reason = "the joints of the primitives have changed"
        with self.states.lock:
            if joint_names == self.states.measured.joint_names:
                return False
            if model is not None:
                with suppress(GoalError):
                    self.release(model, reason)
            execution = self.states.execution
            self.states.expect(joint_names)
            if execution is not None:
                self._end(execution.given_up(reason))
        return True

    def release(self, model: Model, reason: str) -> None:
        """Stop the robot if it executes the motion of a goal, like :meth:`stop`."""
        with self.states.lock:
            execution = self.states.execution
            if execution is not None and not (execution.is_stop or execution.is_reported):
                self.stop(model, reason)

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
        with self.states.lock:
            found = self._stops.find(model)
            why = found.after(reason)
            self._commit(found.joined, Execution.of_stop(self.states.execution, found.joined, why))
        return found.message

    def _serve_once(
        self, request: GoalRequest, is_cancelled: IsCancelled, latency: float
    ) -> Served:
        began, model, last = self._clock(), request.model, self.served
        start = self.states.choose(model.settings, latency)
        model.cancellation.is_cancelled = is_cancelled
        goal = request.goal_from(start.state)
        under_way = last.answer(goal, start, model) if last is not None else ""
        if last is not None and under_way and self.surroundings.threat is None:
            return replace(last, under_way=under_way)
        world = self.surroundings.prepare(model)
        context = PlanRequest(start, model, is_cancelled, last)
        planned = self._planner.plan(goal, context)
        world = self.surroundings.check_again(planned[0].trajectory, world, model)
        served = self._publish(goal, planned, context, request.name)
        self._statistics.served(type(request.goal), served.plan.solve_time, self._clock() - began)
        if self.surroundings.world is not world:
            self.surroundings.look_ahead(model)
        return served

    def _publish(self, goal: Goal, planned: Planned, request: PlanRequest, name: Any) -> Served:
        """Publish a plan from where the robot is: the only place where goals are published."""
        start, model, settings = request.start, request.model, request.model.settings
        (plan, trial), first = planned, start.state
        check = plan.limit_check
        if start.is_in_motion:
            # The trajectory that is published a moment later is a part of this one.
            joined = self.states.join(plan.trajectory, start, settings)
            check = check_limits(joined.trajectory, model.planning_robot, model.limits)
        may_end_moving = settings.allow_nonzero_end_velocity
        with self.states.lock:
            if request.is_cancelled():
                raise CancelledError
            joined = self.states.join(plan.trajectory, start, settings)
            if start.is_in_motion:
                first = JointState(first.joint_names, joined.trajectory.positions[0])
            check_executable(
                joined.trajectory, check, first, allow_nonzero_end_velocity=may_end_moving
            )
            served = Served(goal, plan, model, joined.motion, name, trial)
            self._commit(joined, Execution(name, joined.motion, joined.time, served))
        return served

    def _commit(self, joined: Joined, execution: Execution) -> None:
        """Publish a motion, the only place where that is done; it replaces the one before."""
        old = self.states.published
        self._send(joined.trajectory, stamp=joined.stamp, last_point_only=joined.last_point_only)
        self.states.command(joined, execution)
        if old is not None and old.execution is not None and not execution.is_stop:
            self._end(old.execution.replaced(old.threat.reason if old.threat else ""))

    def _end(self, report: ExecutionReport | None) -> None:
        if report is not None:
            self._report(report)
