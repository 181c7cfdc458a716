# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The server of goals: plans, joins, publishes, monitors and stops motions.

This is the core of the node; it knows nothing of ROS.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..exceptions import GoalError, TrajectoryError
from ..motion.goal import Goal, JointGoal, JointState, PoseGoal, SequenceGoal
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from ..planning.plan import Plan
from ..planning.sequence import SequencePlan
from .adaptation import AdaptedPlan, displaced, effort_cost
from .assembly import Model
from .commanded import CommandedMotion
from .execution_monitor import ExecutionMonitor, ExecutionReport
from .following import UnconfirmedError
from .goal_statistics import GoalStatistics
from .joined import Joined
from .measured import Clock
from .newest_goal import CancelledError, IsCancelled
from .same_goal import is_same_configuration, is_same_goal
from .start_state import Start, StartStates, TooLateError
from .stop_planner import StopPlanner

if TYPE_CHECKING:
    from .trial_book import ServedTrial, TrialBook

MakeGoal = Callable[[JointState], Goal]
"""Makes the goal of a motion that starts at a state."""

AnyPlan = Plan | SequencePlan | AdaptedPlan

# Times that a motion is planned again because the robot had moved on, each time with twice the
# time that it took before.
_MAX_ATTEMPTS = 3
# A motion that continues another one is planned for at most this time ahead [s]: by then, the
# displaced motion is published.
_LONGEST_LOOKAHEAD = 0.25
# Changes of a goal [rad or m] up to which the motion is displaced: while it runs, and at its end.
_NEAR, _NEAR_REST = 0.15, 0.03
# Of that time, this much is left for the checks before publishing [s].
_TIME_TO_PUBLISH = 0.02
# How long it may take to see that a controller has taken a motion, and how often it is asked [s].
_LONGEST_CONFIRMATION, _CONFIRMATION_PERIOD = 1.5, 0.01


class UnexecutablePlanError(TrajectoryError):
    """A plan that must not be published."""

    def __init__(self, plan: Plan | SequencePlan) -> None:
        super().__init__(plan.message)
        self.plan = plan


class Publish(Protocol):
    """Sends a trajectory to the controller."""

    def __call__(
        self, trajectory: Trajectory, *, stamp: float | None, last_point_only: bool
    ) -> None:
        """Send it; it starts at the stamp [s], or when it is received if there is none."""


@dataclass(frozen=True, eq=False)
class Served:
    """A goal whose motion was published, or is under way already.

    Attributes
    ----------
    goal : Goal
        The goal.
    plan : Plan, SequencePlan or AdaptedPlan
        The plan.
    model : Model
        What it was made with.
    motion : CommandedMotion
        What was published.
    trial : ServedTrial or None
        The trial that it is, if the goal is learned by trials.
    under_way : str
        Why nothing was published for a goal that repeats; empty if a motion was.
    """

    goal: Goal
    plan: AnyPlan
    model: Model
    motion: CommandedMotion
    trial: ServedTrial | None = None
    under_way: str = ""


class MotionServer:
    """Plans motions, publishes them, and stops them.

    Parameters
    ----------
    states :
        Where motions start.
    statistics :
        Counts goals, and knows how long they take.
    publish :
        Sends a trajectory to the controller.
    clock :
        The clock of planning times [s]: never set back.
    report :
        Called with what became of each published motion.
    sleep :
        Waits for a time [s].
    """

    def __init__(
        self,
        states: StartStates,
        statistics: GoalStatistics,
        publish: Publish,
        clock: Clock,
        report: Callable[[ExecutionReport], None] = lambda _: None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._states = states
        self._statistics = statistics
        self._send = publish
        self._clock = clock
        self._sleep = sleep
        self._stops = StopPlanner(states)
        self._monitor = ExecutionMonitor(report)
        self._served: Served | None = None
        self._trials: TrialBook | None = None
        # Goals are served in a thread of their own, stops in that of the callbacks.
        self._publishing = threading.Lock()

    def serve(
        self,
        kind: type[Goal],
        make_goal: MakeGoal,
        model: Model,
        is_cancelled: IsCancelled,
        name: Any = None,
    ) -> Served:
        """Plan and publish a motion.

        Parameters
        ----------
        kind :
            The kind of the goal: some take longer than others.
        make_goal :
            The goal, for a motion that starts at this state.
        model :
            What to plan with.
        is_cancelled :
            Whether the goal was preempted.
        name :
            Identifies the goal in the report of its execution.

        Raises
        ------
        PlannerError
            If the goal can't be served; nothing was published then.
        CancelledError
            If it is cancelled before it is published.
        """
        latency = self._statistics.expected_latency(kind)
        if kind is JointGoal:
            latency = min(latency, _LONGEST_LOOKAHEAD)
        deadline = self._clock() + _LONGEST_CONFIRMATION
        attempt = 1
        while True:
            began = self._states.motion_time
            try:
                return self._serve_once(kind, make_goal, model, is_cancelled, latency, name)
            except UnconfirmedError:
                if self._clock() > deadline:
                    raise
                if is_cancelled():
                    raise CancelledError from None
                self._sleep(_CONFIRMATION_PERIOD)
                self.watch(model)
            except TooLateError:
                if attempt == _MAX_ATTEMPTS:
                    raise
                attempt += 1
                latency = 2.0 * max(self._states.motion_time - began, latency)

    def watch(self, model: Model) -> None:
        """Check how the robot follows its motion; call this at 10 Hz or more."""
        settings = model.settings
        try:
            following = self._states.follow(settings.state_timeout, settings.commanded_tolerance)
        except GoalError:
            following = None
        now = self._states.motion_time
        self._monitor.update(following, now)
        if self._monitor.never_started(now):
            self._states.give_up()

    def stop(self, model: Model) -> str:
        """Publish a trajectory that brings the robot to rest.

        Returns
        -------
        :
            How it stops, one sentence.

        Raises
        ------
        PlannerError
            If it isn't known where the robot is; nothing was published then.
        """
        with self._publishing:
            said, joined, last_point_only = self._stops.find(model)
            self._publish_joined(joined, last_point_only=last_point_only)
            self._monitor.stop(self._states.command(joined), joined.time)
            self._served = None
        return said

    def _serve_once(
        self,
        kind: type[Goal],
        make_goal: MakeGoal,
        model: Model,
        is_cancelled: IsCancelled,
        latency: float,
        name: Any,
    ) -> Served:
        settings = model.settings
        began = self._clock()
        start = self._states.choose(
            settings.start_from, settings.state_timeout, latency, settings.commanded_tolerance
        )
        model.cancellation.is_cancelled = is_cancelled
        goal = make_goal(start.state)
        under_way = self._under_way(goal, start, model)
        if under_way is not None:
            return under_way
        plan = self._plan(goal, start, model, is_cancelled)
        trial = None
        may_learn = settings.learn_trials and not start.is_in_motion
        if may_learn and isinstance(goal, JointGoal) and isinstance(plan, Plan):
            plan, trial = self._trial_book().vary(goal, plan, model)
        motion = self._publish(plan, start, model, is_cancelled, name)
        self._statistics.served(kind, plan.solve_time, self._clock() - began)
        self._served = Served(goal, plan, model, motion, trial)
        return self._served

    # Goals that come while the robot moves

    def _under_way(self, goal: Goal, start: Start, model: Model) -> Served | None:
        """The goal served before, if the same is requested again; else None."""
        served, following = self._served, start.following
        if served is None or following is None or served.motion is not following.motion:
            return None
        if (
            served.model is not model
        ):  # with other primitives or parameters the motion may be another
            return None
        if following.is_running:
            rate = max(following.progress.rate, 0.01)
            left = (following.motion.duration - following.progress.place) / rate
            said = f"the goal is under way: the robot arrives in {left:.2g} s"
            return replace(served, under_way=said) if is_same_goal(goal, served.goal) else None
        if isinstance(goal, SequenceGoal):
            return None
        same = is_same_goal(goal, served.goal)
        if isinstance(goal, JointGoal) and not same:
            model.planner.check(goal)
            target = model.planner.target(goal, start.state)
            same = is_same_configuration(target, start.state)
        error = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        said = f"the robot is at the goal: the largest error is {error}"
        return replace(served, under_way=said) if same else None

    def _plan(self, goal: Goal, start: Start, model: Model, is_cancelled: IsCancelled) -> AnyPlan:
        """An executable plan."""
        if not isinstance(goal, SequenceGoal) and start.following and not goal.vias:
            adapted = self._adapt(goal, start, model, is_cancelled)
            if adapted is not None:
                return adapted
        return self._executable_plan(goal, start, model, is_cancelled)

    @staticmethod
    def _executable_plan(goal: Goal, start: Start, model: Model, is_cancelled: IsCancelled) -> Plan:
        plan = model.planner.plan(goal, start.state, model.settings.sequence_mode)
        if is_cancelled():
            raise CancelledError
        if not plan.is_executable:
            raise UnexecutablePlanError(plan)
        return plan

    def _adapt(
        self, goal: JointGoal | PoseGoal, start: Start, model: Model, is_cancelled: IsCancelled
    ) -> Plan | AdaptedPlan | None:
        """Continue the motion that the robot follows to another goal; None if that is not possible.

        A planned motion takes no longer than the displaced one, so that streams of goals do not
        delay the arrival; planning ends when it is time to publish. To a goal near the end of the
        motion, the displaced one is the answer: planned motions swing as demonstrated ones do.
        """
        following, began = start.following, self._clock()
        assert following is not None
        if isinstance(goal, PoseGoal):
            if following.is_over:
                return None
            posed = self._executable_plan(goal, start, model, is_cancelled)
            end = posed.trajectory.positions[-1]
            goal = JointGoal(
                JointState(start.state.joint_names, end), goal.duration, goal.primitive
            )
        target = model.planner.target(goal, start.state)
        change = float(np.abs(target.positions - following.motion.end).max())
        is_open = not goal.duration and goal.primitive is None
        is_near = is_open and change <= (_NEAR_REST if following.is_over else _NEAR)
        is_known = self._served is not None and self._served.model is model
        if following.is_over and not (is_near and is_known):
            return None
        found = displaced(
            following.motion,
            min(start.place, following.motion.duration),
            target,
            model.planning_robot,
            model.limits,
            model.settings.sample_period,
        )
        if found is None or self._collides(found[0], model):
            return None
        trajectory, check = found
        last = None if self._served is None else self._served.plan
        adapted = AdaptedPlan(
            trajectory,
            check,
            "none" if last is None else getattr(last, "primitive", "none"),
            float("nan") if last is None else last.in_span_score,
            "the motion is continued to the new goal",
            self._clock() - began,
        )
        if is_near:
            return adapted
        asked = goal if goal.duration else replace(goal, duration=trajectory.duration)
        planned = self._plan_in_time(asked, start, model, is_cancelled)
        if planned is None or not planned.is_executable:
            return adapted
        if not goal.duration and effort_cost(planned.trajectory) > adapted.effort_cost:
            return adapted
        return planned

    def _plan_in_time(
        self, goal: JointGoal, start: Start, model: Model, is_cancelled: IsCancelled
    ) -> Plan | None:
        """A plan, or None if the robot would reach its start before."""
        deadline = start.deadline - _TIME_TO_PUBLISH

        def is_over() -> bool:
            return is_cancelled() or self._states.motion_time > deadline

        model.cancellation.is_cancelled = is_over
        try:
            plan = model.planner.plan(goal, start.state)
        finally:
            model.cancellation.is_cancelled = is_cancelled
        if is_cancelled():
            raise CancelledError
        return None if is_over() else plan

    @staticmethod
    def _collides(trajectory: Trajectory, model: Model) -> bool:
        collision = model.planner.collision
        return collision is not None and bool(collision.collisions(trajectory))

    def _trial_book(self) -> TrialBook:
        # Takes long to import, and few nodes learn.
        from .trial_book import TrialBook

        if self._trials is None:
            self._trials = TrialBook()
        return self._trials

    # Publishing

    def _publish(
        self, plan: AnyPlan, start: Start, model: Model, is_cancelled: IsCancelled, name: Any
    ) -> CommandedMotion:
        """Publish a plan from where the robot is: the only place where goals are published."""
        settings = model.settings
        request = plan.trajectory, start, settings.state_timeout, settings.commanded_tolerance
        check, first = plan.limit_check, start.state
        if start.is_in_motion:
            # What is published a moment later is the end of the same trajectory.
            joined = self._states.join(*request, may_stamp=settings.stamp_trajectories)
            check = check_limits(joined.trajectory, model.planning_robot, model.limits)
        with self._publishing:
            if is_cancelled():
                raise CancelledError
            joined = self._states.join(*request, may_stamp=settings.stamp_trajectories)
            if start.is_in_motion:
                first = JointState(first.joint_names, joined.trajectory.positions[0])
            check_executable(
                joined.trajectory,
                check,
                first,
                allow_nonzero_end_velocity=settings.allow_nonzero_end_velocity,
            )
            self._publish_joined(joined)
            motion = self._states.command(joined)
            self._monitor.begin(name, motion, joined.time)
        return motion

    def _publish_joined(self, joined: Joined, *, last_point_only: bool = False) -> None:
        stamp = joined.time if joined.is_timed else None
        self._send(joined.trajectory, stamp=stamp, last_point_only=last_point_only)
