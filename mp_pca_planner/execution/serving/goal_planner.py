# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning for goals: new motions, or continuations of the motion that the robot follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...exceptions import TrajectoryError
from ...input_limits import INPUT_LIMITS
from ...motion.goal import Goal, JointGoal, JointState, PoseGoal, SequenceGoal
from ...motion.interpolation import hermite_functions
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck, check_limits
from ...planning.plan import SOLVED, Plan
from ...robot.limits import JointLimits
from ...robot.model import Robot
from ..options import ServingOptions
from ..threads import CancelledError, IsCancelled
from ..tracking.following import MotionFollower
from ..tracking.published_motion import MIN_STEP, PublishedMotion
from ..tracking.start_state import MotionStart
from ..tracking.state_sources import Clock
from .assembly import Model

if TYPE_CHECKING:
    from .execution import Served
    from .trial_store import ServedTrial, TrialStore


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


# Duration of a displaced motion in durations of the planned one.
_SLOWEST = 2.0


def displaced(
    motion: PublishedMotion,
    place: float,
    goal: JointState,
    robot: Robot,
    limits: JointLimits,
    period: float,
    planned_duration: float,
) -> tuple[Trajectory, LimitCheck] | None:
    """Displace the end of a motion, within the limits and without shortening it.

    The displacement is the minimum-jerk polynomial from 0 to the change of the goal, similar to how
    dynamic movement primitives adapt to changed goals. No motion starts anew, so goals that repeat
    or drift are reached at any rate.

    Parameters
    ----------
    motion : PublishedMotion
        The motion.
    place : float
        Place on the motion at which the displacement begins [s].
    goal : JointState
        The new end, with its velocities; of the joints of the motion.
    robot, limits :
        Of the same joints.
    period : float
        Longest time between points [s].
    planned_duration : float
        Duration of the planned motion [s]. Each motion of a stream of goals displaces the one
        before, and would take ever longer without a bound.

    Returns
    -------
    trajectory, check :
        The displaced motion from the place on with its efforts, and its comparison with the
        limits; None if every displacement breaks a limit or takes too long.
    """
    change = np.abs(goal.positions - motion.end)
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    # Of the minimum-jerk polynomial from 0 to 1 in unit time.
    peaks = (1.875, 5.7735, 60.0)
    needed = [
        float(np.max(peak * change / bound)) ** (1.0 / order)
        for order, (peak, bound) in enumerate(zip(peaks, bounds, strict=True), start=1)
    ]
    # Small displacements are smooth, too, if they take a quarter of a second.
    shortest = max(0.25, *needed)
    duration = max(motion.duration - place, shortest)
    longest = min(_SLOWEST * max(planned_duration, shortest), INPUT_LIMITS.longest_motion(period))
    # Longer ones are tried, because the sum with the motion must keep the limits.
    while duration <= longest:
        trajectory = _displaced_in(duration, motion, place, goal, period)
        check = check_limits(trajectory, robot, limits)
        if not check.violations:
            return trajectory.with_efforts(check.efforts), check
        duration *= 1.25
    return None


def _displaced_in(
    duration: float, motion: PublishedMotion, place: float, goal: JointState, period: float
) -> Trajectory:
    """The motion from a place on, plus the polynomial to the change of its end."""
    # At the points of the motion: between others, a quintic over a jump of the jerk exceeds it.
    own = motion.rest(place).times if place < motion.duration else np.zeros(1)
    own = own[own < max(duration - MIN_STEP, MIN_STEP)]
    n_more = max(int(np.ceil((duration - own[-1]) / period - 1e-6)), 6 - len(own), 1)
    times = np.concatenate([own, np.linspace(own[-1], duration, n_more + 1)[1:]])
    last = motion.state(motion.duration)
    ends = zip(last.values, goal.values, strict=True)
    change = [(new - old) * duration**d for d, (old, new) in enumerate(ends)]
    boundary = np.vstack([np.zeros((3, len(goal.positions))), change])
    columns = [
        x + hermite_functions(times / duration, d) @ boundary / duration**d
        for d, x in enumerate(motion.sample(place + times))
    ]
    for x, end in zip(columns, goal.values, strict=True):
        x[-1] = end
    return Trajectory(motion.trajectory.joint_names, times, *columns)


AnyPlan = Plan | AdaptedPlan


def _planned_duration(plan: AnyPlan) -> float:
    if isinstance(plan, AdaptedPlan):
        return plan.planned_duration
    return plan.trajectory.duration


Planned = tuple[AnyPlan, "ServedTrial | None"]


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


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """The start and the context of a goal.

    Attributes
    ----------
    start : MotionStart
        Start of the motion.
    model : Model
        The planner and the robot.
    is_cancelled : callable
        Whether the goal was preempted.
    last : Served or None
        The goal that was served last.
    """

    start: MotionStart
    model: Model
    is_cancelled: IsCancelled
    last: Served | None


class GoalPlanner:
    """Plans executable motions for goals.

    Parameters
    ----------
    follower :
        Tracks the robot on its motion.
    clock :
        The clock of planning times [s].
    options :
        Parameters.
    """

    def __init__(self, follower: MotionFollower, clock: Clock, options: ServingOptions) -> None:
        self._follower = follower
        self._clock = clock
        self._options = options

    def plan(self, goal: Goal, request: PlanRequest) -> Planned:
        """Plan an executable motion.

        Returns
        -------
        plan : Plan or AdaptedPlan
            The plan.
        trial : ServedTrial or None
            The trial that it is, if the goal is learned by trials.

        Raises
        ------
        PlannerError
            If there is no executable plan.
        CancelledError
            If the goal is preempted.
        """
        start, model = request.start, request.model
        adapted = None
        if not isinstance(goal, SequenceGoal) and start.following is not None:
            adapted = self._continued(goal, request)
        plan = adapted or _executable_plan(goal, request)
        may_learn = model.settings.learn_trials and not start.is_in_motion
        if may_learn and isinstance(goal, JointGoal) and isinstance(plan, Plan):
            return self._trials.vary(goal, plan, model)
        return plan, None

    def _continued(
        self, goal: JointGoal | PoseGoal, request: PlanRequest
    ) -> Plan | AdaptedPlan | None:
        """Continue the motion that the robot follows to another goal; None if that is impossible.

        A planned motion takes no longer than the displaced one, so streams of goals do not delay
        the arrival. Planning ends when it is time to publish. For a goal near the end of the
        motion, the displaced motion is used, because planned motions would swing as the
        demonstrations do.
        """
        start, model, began = request.start, request.model, self._clock()
        following = start.following
        assert following is not None
        if isinstance(goal, PoseGoal):
            if following.is_over:
                return None
            end = _executable_plan(goal, request).trajectory.positions[-1]
            end_state = JointState(start.state.joint_names, end)
            goal = JointGoal(end_state, goal.duration, goal.primitive)
        target = model.planner.target(goal, start.state)
        if model.planner.is_too_far(goal, start.state, target):
            return None
        change = float(np.abs(target.positions - following.motion.end).max())
        near = self._options.near_at_rest if following.is_over else self._options.near
        is_near = not goal.duration and goal.primitive is None and change <= near
        is_known = request.last is not None and request.last.model is model
        if following.is_over and not (is_near and is_known):
            return None
        adapted = self._displaced(target, request, began)
        if adapted is None or is_near:
            return adapted
        planned = self._plan_in_time(goal, adapted, request)
        if planned is None or not planned.is_executable:
            return adapted
        if not goal.duration and planned.trajectory.effort_cost > adapted.trajectory.effort_cost:
            return adapted
        return planned

    def _displaced(
        self, target: JointState, request: PlanRequest, began: float
    ) -> AdaptedPlan | None:
        """The running motion displaced to a target, if that keeps what motions have to."""
        start, model, last = request.start, request.model, request.last
        assert start.following is not None
        motion, period = start.following.motion, model.settings.sample_period
        place = min(start.place, motion.duration)
        robot, limits = model.planning_robot, model.limits
        planned = motion.duration if last is None else _planned_duration(last.plan)
        found = displaced(motion, place, target, robot, limits, period, planned)
        collision = model.planner.collision
        if found is None or (collision is not None and collision.collisions(found[0])):
            return None
        for constraint in model.constraints:
            if np.any(constraint.values(robot, found[0].positions)[0] < 0.0):
                return None
        primitives, score = (last.plan.primitives, last.plan.in_span_score) if last else ((), nan)
        return AdaptedPlan(*found, primitives, score, planned, self._clock() - began)

    def _plan_in_time(
        self, goal: JointGoal, adapted: AdaptedPlan, request: PlanRequest
    ) -> Plan | None:
        """A plan with the duration of the displaced motion; None if it would come too late."""
        start, cancellation = request.start, request.model.cancellation
        deadline = start.deadline - self._options.publishing_time
        if not goal.duration:
            goal = replace(goal, duration=adapted.trajectory.duration)

        def is_over() -> bool:
            return request.is_cancelled() or self._follower.motion_time > deadline

        cancellation.is_cancelled = is_over
        try:
            plan = request.model.planner.plan(goal, start.state)
        finally:
            cancellation.is_cancelled = request.is_cancelled
        if request.is_cancelled():
            raise CancelledError
        return None if is_over() else plan

    @cached_property
    def _trials(self) -> TrialStore:
        # The import is slow, and few nodes learn.
        from .trial_store import TrialStore

        return TrialStore()


def _executable_plan(goal: Goal, request: PlanRequest) -> Plan:
    """A plan that may be executed."""
    model = request.model
    plan = model.planner.plan(goal, request.start.state)
    if request.is_cancelled():
        raise CancelledError
    if not plan.is_executable:
        raise UnexecutablePlanError(plan)
    return plan
