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
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from math import nan
from typing import Any, ClassVar

import numpy as np

from ...exceptions import GoalError, TrajectoryError
from ...motion.goal import Goal, JointGoal, JointState, PoseGoal, SequenceGoal
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck, check_executable, check_limits
from ...planning.plan import SOLVED, Plan
from ...planning.report import motion_remarks
from ..options import Serving
from ..threads import BusyError, IsCancelled
from ..tracking.following import UnconfirmedError
from ..tracking.measured import LateStateError
from ..tracking.published_motion import PublishedMotion, displaced
from ..tracking.start_state import MotionStart, TooLateError, choose_start, join
from .assembly import Model, unknown_positions
from .execution import Execution, GoalOutcome, Served
from .motion_monitor import MotionMonitor


@dataclass(frozen=True, eq=False)
class AdaptedPlan:
    """A displaced motion within the limits, in place of a planned one.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, with its efforts.
    limit_check : LimitCheck
        Its comparison with the limits.
    primitives : tuple of str
        Names of the primitives of the motion that was displaced; none for a stop.
    in_span_score : float
        In-span score of the motion that was displaced.
    planned_duration : float
        Duration of the planned motion that was displaced, perhaps several times [s].
    solve_time : float
        Time taken to find it [s].
    """

    trajectory: Trajectory
    limit_check: LimitCheck
    primitives: tuple[str, ...]
    in_span_score: float
    planned_duration: float
    solve_time: float
    status: ClassVar[str] = SOLVED
    message: ClassVar[str] = "the motion is continued to the new goal"

    @property
    def remarks(self) -> list[str]:
        """Sentences on what is unusual about it, as of a plan."""
        return motion_remarks(self.in_span_score, self.limit_check)

    def summary(self) -> dict[str, str | float | int]:
        """Scalar facts, by the names of the package's public interface."""
        return {
            "status": self.status,
            "message": self.message,
            "primitive": ", ".join(self.primitives) or "none",
            "duration": self.trajectory.duration,
            "effort_cost": self.trajectory.effort_cost,
            "solve_time_s": self.solve_time,
            "iterations": 0,
            "in_span_score": self.in_span_score,
            "limit_violation": self.limit_check.worst_excess,
            "start_error": 0.0,
            "goal_error": 0.0,
        }


AnyPlan = Plan | AdaptedPlan


class UnexecutablePlanError(TrajectoryError):
    """A plan that must not be published."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan.message)
        self.plan = plan


@dataclass(frozen=True, eq=False)
class GoalRequest:
    """A goal that was received.

    Attributes
    ----------
    goal : Goal
        The goal as stated.
    model : Model
        The planner and its settings.
    name : object
        Identifies the goal in the report of its execution.
    make_goal : callable, optional
        Returns the goal for a motion from a start state, if that depends on the start.
    """

    goal: Goal
    model: Model
    name: Any = None
    make_goal: Callable[[JointState], Goal] | None = None

    def goal_from(self, start: JointState) -> Goal:
        """The goal for a motion from a start state."""
        return self.goal if self.make_goal is None else self.make_goal(start)


class GoalStatistics:
    """Counts of goals and their latest times, for several threads.

    Attributes
    ----------
    counts : dict of int
        Goals by outcome.
    """

    def __init__(self) -> None:
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
            return Serving.initial_latency
        return Serving.latency_margin * float(np.percentile(recent, 90))

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
        self._clock = monitor.clock
        self._statistics, self._sleep = statistics, sleep

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
        latency = self._statistics.expected_latency(type(request.goal))
        if isinstance(request.goal, JointGoal):
            latency = max(min(latency, Serving.max_lookahead), lookahead)
        deadline, attempt = self._clock() + Serving.confirmation_timeout, 1
        while True:
            began = self._follower.motion_time
            try:
                with request.model.cancellation.by(is_cancelled):
                    return self._serve_once(request, is_cancelled, latency)
            except (UnconfirmedError, LateStateError) as error:
                # States that ceased long ago do not come back soon.
                age, is_late = self._follower.measured.age, isinstance(error, LateStateError)
                is_over = is_late and (age is None or age > Serving.late_states)
                if is_over or self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(Serving.confirmation_period)
                with suppress(BusyError):  # the thread that watches does so just now
                    self.monitor.watch(request.model)
            except TooLateError:
                # While there is time before a collision, a stop is no better than a motion.
                if attempt >= Serving.max_attempts and not lookahead:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                attempt += 1
                latency = 2.0 * max(self._follower.motion_time - began, latency)

    def avoid_obstacle(self, model: Model, is_cancelled: IsCancelled) -> tuple[str, Served | None]:
        """Replace the running motion if it would hit an obstacle; if that fails, give it up.

        The next :meth:`MotionMonitor.watch` stops the robot then.

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
        CancelledError
            If a newer goal preempts it.
        """
        served, threat = self.monitor.served, self._surroundings.threat
        if served is None or threat is None:
            return "", None
        last, reason = threat.last_time, threat.reason

        def is_over() -> bool:
            return is_cancelled() or self._follower.motion_time > last

        goal = served.rest_of_goal(self._follower.motion_time - served.motion.began)
        try:
            if is_over():
                raise CancelledError
            request = GoalRequest(goal, model, served.name)
            found = self.serve(request, is_over, lookahead=Serving.avoidance_lookahead)
        except Exception as error:  # whatever the reason, the robot must not hit the obstacle
            if is_cancelled():
                raise CancelledError from None
            # The thread that watches stops the robot: it goes before all others.
            threat.is_given_up = True
            why = str(error) or "there was no time to plan one"
            return f"{reason}, and no other motion was found: {why}", None
        return f"{reason}: another motion leads to the goal", found

    def _serve_once(
        self, request: GoalRequest, is_cancelled: IsCancelled, latency: float
    ) -> Served:
        self._surroundings.settle(is_cancelled)
        began, model, last = self._clock(), request.model, self.monitor.served
        start = choose_start(self._follower, model.settings, latency)
        goal = request.goal_from(start.state)
        under_way = last.answer(goal, start, model) if last is not None else ""
        if last is not None and under_way and self._surroundings.threat is None:
            return replace(last, under_way=under_way)
        world = self._surroundings.prepare(model)
        if unknown := unknown_positions(model, world):
            raise GoalError(unknown)
        plan = self._plan(goal, start, model, last)
        self._surroundings.settle(is_cancelled)
        world = self._surroundings.check_again(plan.trajectory, world, model)
        # A displaced motion has the primitives of the motion before.
        primitives = last.primitives if last is not None else ()
        if isinstance(plan, Plan):
            library = model.planner.primitives
            primitives = tuple(map(library.named, dict.fromkeys(plan.primitives)))
        check = self._check_joined(plan, start, model)
        with self._follower.lock:  # the only place where the motions of goals are published
            motion = self._joined(plan, start, model, check)
            served = Served(goal, plan, model, motion, request.name, primitives)
            self.monitor.publish(Execution(request.name, motion, served), world)
        self._statistics.served(type(request.goal), plan.solve_time, self._clock() - began)
        return served

    def _plan(self, goal: Goal, start: MotionStart, model: Model, last: Served | None) -> AnyPlan:
        """Plan an executable motion.

        Raises
        ------
        PlannerError
            If there is no executable plan.
        CancelledError
            If the goal is preempted.
        """
        if start.following is None or isinstance(goal, SequenceGoal):
            return _executable_plan(goal, start, model)
        adapted = self._continued(goal, start, model, last)
        return adapted or _executable_plan(goal, start, model)

    def _continued(
        self,
        goal: JointGoal | PoseGoal,
        start: MotionStart,
        model: Model,
        last: Served | None,
    ) -> AnyPlan | None:
        """Continue the motion that the robot follows to another goal; None if that is impossible.

        A planned motion takes no longer than the displaced one, so streams of goals do not delay
        the arrival. Planning ends when it is time to publish. For a goal near the end of the
        motion, the displaced motion is used, because planned motions would swing as the
        demonstrations do.
        """
        began, following = self._clock(), start.following
        assert following is not None
        if isinstance(goal, PoseGoal):
            if following.is_over:
                return None
            end = _executable_plan(goal, start, model).trajectory.positions[-1]
            end_state = JointState(start.state.joint_names, end)
            goal = JointGoal(end_state, goal.duration, goal.primitive)
        target = model.planner.target(goal, start.state)
        if model.planner.is_too_far(goal, start.state, target):
            return None
        change = float(np.abs(target.positions - following.motion.end).max())
        near = Serving.near_at_rest if following.is_over else Serving.near
        is_near = not goal.duration and goal.primitive is None and change <= near
        is_known = last is not None and last.model is model
        if following.is_over and not (is_near and is_known):
            return None
        adapted = self._displaced(target, start, model, last, began)
        if adapted is None or is_near:
            return adapted
        planned = self._plan_in_time(goal, adapted, start, model)
        if planned is None or not planned.is_executable:
            return adapted
        if not goal.duration and planned.trajectory.effort_cost > adapted.trajectory.effort_cost:
            return adapted
        return planned

    def _displaced(
        self,
        target: JointState,
        start: MotionStart,
        model: Model,
        last: Served | None,
        began: float,
    ) -> AdaptedPlan | None:
        """The running motion displaced to a target, if that keeps what motions have to."""
        assert start.following is not None
        motion, robot = start.following.motion, model.planning_robot
        period = model.settings.sample_period
        place, planned = min(start.place, motion.duration), motion.duration
        primitives, score = tuple[str, ...](), nan
        if last is not None:
            plan = last.plan
            planned = plan.trajectory.duration if isinstance(plan, Plan) else plan.planned_duration
            primitives, score = plan.primitives, plan.in_span_score
        found = displaced(motion, place, target, robot, model.limits, period, planned)
        collision = model.planner.collision
        if found is None or (collision is not None and collision.collisions(found[0])):
            return None
        for constraint in model.constraints:
            if np.any(constraint.values(robot, found[0].positions)[0] < 0.0):
                return None
        return AdaptedPlan(*found, primitives, score, planned, self._clock() - began)

    def _plan_in_time(
        self, goal: JointGoal, adapted: AdaptedPlan, start: MotionStart, model: Model
    ) -> Plan | None:
        """A plan with the duration of the displaced motion; None if it would come too late."""
        cancellation, deadline = model.cancellation, start.deadline - Serving.publishing_time
        is_cancelled = cancellation.is_cancelled
        if not goal.duration:
            goal = replace(goal, duration=adapted.trajectory.duration)

        def is_over() -> bool:
            return is_cancelled() or self._follower.motion_time > deadline

        with cancellation.by(is_over):
            plan = model.planner.plan(goal, start.state)
        if is_cancelled():
            raise CancelledError
        return None if is_over() else plan

    def _check_joined(self, plan: AnyPlan, start: MotionStart, model: Model) -> LimitCheck:
        """Compare a plan that is joined to the present motion with the limits.

        Raises
        ------
        TooLateError
            If it exceeds one there.
        """
        if not start.is_in_motion:
            return plan.limit_check
        # The trajectory that is published a moment later is a part of this one.
        motion = join(self._follower, plan.trajectory, start, model.settings)
        check = check_limits(motion.sent, model.planning_robot, model.limits)
        if check.violations:  # at another place, they join within the limits
            raise TooLateError(
                f"where the motion joins the one under way, the {check.violations[0]}; send "
                "the goal again"
            )
        return check

    def _joined(
        self, plan: AnyPlan, start: MotionStart, model: Model, check: LimitCheck
    ) -> PublishedMotion:
        """A plan joined to where the robot is, which may be published.

        Whatever can be rejected is checked here: a published motion is never rejected.
        """
        if model.cancellation():
            raise CancelledError
        motion, first = join(self._follower, plan.trajectory, start, model.settings), start.state
        if start.is_in_motion:
            threat = self._surroundings.threat
            if threat is not None and start.time >= threat.time:
                raise GoalError(f"{threat.reason} before another motion could begin")
            first = JointState(first.joint_names, motion.sent.positions[0])
        may_end_moving = model.settings.allow_nonzero_end_velocity
        check_executable(motion.sent, check, first, allow_nonzero_end_velocity=may_end_moving)
        return motion


def _executable_plan(goal: Goal, start: MotionStart, model: Model) -> Plan:
    """A plan that may be executed."""
    plan = model.planner.plan(goal, start.state)
    if model.cancellation():
        raise CancelledError
    if not plan.is_executable:
        raise UnexecutablePlanError(plan)
    return plan
