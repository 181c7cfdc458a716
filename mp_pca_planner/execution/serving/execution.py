# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals that were served, the executions of their motions, and the report of each outcome."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import starmap
from typing import TYPE_CHECKING, Any

import numpy as np

from ...motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ...planning.resolve import in_order
from ...primitives.primitive import MovementPrimitive
from ..options import Serving
from ..tracking.following import Following, How
from ..tracking.published_motion import PublishedMotion
from ..tracking.start_state import MotionStart
from .assembly import Model

if TYPE_CHECKING:
    from ...robot.world import World
    from .motion_server import AnyPlan
    from .surroundings import Threat


class GoalOutcome(StrEnum):
    """What became of a goal: its word in reports and diagnostics."""

    SERVED = "served"
    UNDER_WAY = "under_way"  # the same goal is under way, or reached, already
    OVERTAKEN = "overtaken"  # valid, but preempted by a newer one or by a stop
    REFUSED = "refused"

    @property
    def level(self) -> int:
        """The level of its report: 0 good, 1 a warning, 2 an error."""
        return {GoalOutcome.OVERTAKEN: 1, GoalOutcome.REFUSED: 2}.get(self, 0)


class MotionOutcome(StrEnum):
    """What became of a motion: its word in reports."""

    ARRIVED = "arrived"
    REPLACED = "replaced"
    STOPPED = "stopped"
    NOT_FOLLOWED = "not_followed"
    NEVER_STARTED = "never_started"

    @property
    def is_good(self) -> bool:
        """Whether the motion was executed as requested."""
        return self not in (MotionOutcome.NOT_FOLLOWED, MotionOutcome.NEVER_STARTED)


ACCEPTED = "accepted the goal"


@dataclass(frozen=True)
class ExecutionReport:
    """Outcome of a motion.

    Attributes
    ----------
    goal : object
        Identifies the goal of the motion.
    outcome : MotionOutcome
        The outcome.
    message : str
        One sentence for a person.
    progress : float
        The share of the motion that was executed.
    error : float
        Largest final distance of a joint from its commanded position [rad or m].
    largest_deviation : float
        The largest such distance during the motion [rad or m].
    deviation_time : float
        Time of that distance since the motion was published [s].
    controller : str
        What the controller answered to its goal; empty if motions are sent on a topic.
    continues : bool
        Whether another motion leads to the same goal, around an obstacle.
        Another report follows then.
    """

    goal: Any
    outcome: MotionOutcome
    message: str
    progress: float
    error: float
    largest_deviation: float
    deviation_time: float
    controller: str = ""
    continues: bool = False


@dataclass(eq=False)
class Execution:
    """The execution of a published motion, up to its report.

    Attributes
    ----------
    name : object
        Identifies the goal in the report.
    motion : PublishedMotion
        The motion.
    served : Served or None
        The goal; None for a stop.
    is_stop : bool
        Whether the motion stops the one before, which then gets no report of its own.
    reason : str
        Why the robot is stopped.
    threat : Threat or None
        The next collision of the rest of the motion with an obstacle that was not there when it was
        planned.
    checked : tuple of (PublishedMotion, World) or None
        The motion that was checked for such a collision last, and the obstacles.
    is_reported : bool
        Whether the outcome was reported.
    published : float
        When the motion was published [s]; for a stop that is repeated, the first one.
    last : Following or None
        How the robot followed the motion last, and stopped motions before it.
    largest_deviation, deviation_time : float
        See `ExecutionReport`.
    controller : str
        What the controller answered; empty if motions are sent on a topic.
    how : How or None
        How the robot follows the motion.
    since, place : float
        Time since when it does so, and the place at which that began [s].
    """

    name: Any
    motion: PublishedMotion
    served: Served | None = None
    is_stop: bool = False
    reason: str = ""
    threat: Threat | None = None
    checked: tuple[PublishedMotion, World] | None = None
    is_reported: bool = False
    published: float = math.nan
    last: Following | None = None
    largest_deviation: float = 0.0
    deviation_time: float = 0.0
    controller: str = ""
    how: How | None = None
    since: float = 0.0
    place: float = 0.0

    def __post_init__(self) -> None:
        self.published = self.motion.time

    @classmethod
    def of_stop(
        cls,
        stopped: Execution | None,
        motion: PublishedMotion,
        reason: str = "",
    ) -> Execution:
        """The execution of a stop; it is reported unless that of the stopped motion was."""
        stop = cls(None, motion, is_stop=True, reason=reason, is_reported=True)
        if stopped is not None:
            stop.name, stop.is_reported = stopped.name, stopped.is_reported
            stop.last = stopped.last
        return stop

    def replaced(self, by: Execution) -> ExecutionReport | None:
        """The report on the motion when another one replaces it; None if it had one.

        A stop counts as executed then.
        """
        continues = self.name is not None and by.name is self.name
        why = "the motion of a newer goal"
        if continues:
            reason = self.threat.reason if self.threat else "its goal is the same"
            why = f"another motion, for {reason}"
        outcome = MotionOutcome.STOPPED if self.is_stop else MotionOutcome.REPLACED
        return self._end(outcome, f"replaced by {why}", continues=continues)

    def given_up(self, reason: str) -> ExecutionReport | None:
        """The report on a motion that can't be followed any more; None if it had one."""
        return self._end(
            MotionOutcome.NOT_FOLLOWED, f"not known whether the robot arrived: {reason}"
        )

    def answer(self, text: str, failure: MotionOutcome | None) -> ExecutionReport | None:
        """Record what the controller answered; the report if that ends the motion.

        See `MotionMonitor.hear`.
        """
        self.controller = "; ".join(filter(None, [self.controller, text]))
        if failure is None:  # whether the robot arrived is seen, not told
            return None
        return self._end(failure, f"{failure.replace('_', ' ')}: the controller {text}")

    def update(self, following: Following | None, now: float) -> ExecutionReport | None:
        """Record how the robot follows the motion.

        Parameters
        ----------
        following : Following or None
            None if the robot sends no states.
        now : float
            The time [s].

        Returns
        -------
        :
            The report, once the outcome is known; None before and after.
        """
        if following is None:
            if now < self.motion.began + self.motion.duration + Serving.max_hold:
                return None
            silence = f"joint_states are silent {Serving.max_hold:g} s after the end of the motion"
            return self.given_up(silence)
        if following.motion is not self.motion:
            if now <= self.published + Serving.start_delay:
                return None  # on a busy machine, the message comes late
            return self._end(
                MotionOutcome.NEVER_STARTED,
                "never started: the robot still follows the previous motion; check that the "
                "controller is active and accepts the trajectory",
            )
        self.last = following
        if following.distance > self.largest_deviation:
            self.largest_deviation = following.distance
            self.deviation_time = now - self.motion.time
        if following.how is not self.how:
            self.how, self.since, self.place = following.how, now, following.progress.place
        return self._judge(following, now)

    def _judge(self, following: Following, now: float) -> ExecutionReport | None:
        away = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        duration = now - self.since
        if following.is_over and following.at_rest:
            late = following.progress.place - following.motion.duration
            if self.controller == ACCEPTED and late < Serving.start_delay:
                return None  # the result of the controller comes a little later
            if not self.is_stop:
                return self._end(MotionOutcome.ARRIVED, f"arrived: the largest error is {away}")
            since = f"{now - self.motion.time:.2f} s after the stop"
            text = f"stopped: the robot was seen at rest {since}"
            return self._end(MotionOutcome.STOPPED, "; ".join(filter(None, [text, self.reason])))
        if self._never_started(following, now):
            return self._end(
                MotionOutcome.NEVER_STARTED,
                "never started: the robot rests at the start of the motion; check that the "
                "controller is active and accepts the trajectory",
            )
        if self.how is How.OFF and duration > Serving.away_time:
            return self._end(
                MotionOutcome.NOT_FOLLOWED,
                f"not followed: the deviation from the path is {away}; the largest one was "
                f"{self.largest_deviation:.3g}, {self.deviation_time:.2f} s after publishing",
            )
        # Under speed scaling, a robot may be too slow to be seen to move.
        advanced = following.progress.place - self.place
        is_slow = advanced > 0.5 * Serving.slowest_rate * duration
        if self.how is How.HELD and duration > Serving.max_hold and not is_slow:
            return self._end(
                MotionOutcome.NOT_FOLLOWED,
                f"not followed: the robot has rested at {self._share:.0%} of the motion for more "
                f"than {Serving.max_hold:g} s",
            )
        return None

    def _never_started(self, following: Following, now: float) -> bool:
        """Whether the robot has rested at the start of the motion for too long."""
        published = self.motion.time
        if self.how is not How.HELD or now - max(self.since, published) <= Serving.start_delay:
            return False
        began = published - self.motion.began
        # A slow motion, under speed scaling, may not be seen yet.
        seen = began + Serving.slowest_rate * (now - published)
        places = np.array([began, following.progress.place, seen])
        start, here, due = self.motion.sample(places)[0]
        has_left = np.abs([here - start, due - start]).max(axis=1) > Serving.left_start
        return bool(not has_left[0] and has_left[1])

    @property
    def _share(self) -> float:
        """The share of the motion that was executed."""
        if self.last is None:
            return 0.0
        duration = self.last.motion.duration
        return min(self.last.progress.place / duration, 1.0) if duration > 0.0 else 1.0

    def _end(
        self, outcome: MotionOutcome, message: str, *, continues: bool = False
    ) -> ExecutionReport | None:
        if self.is_reported:
            return None
        self.is_reported = True
        return ExecutionReport(
            self.name,
            outcome,
            message,
            self._share,
            0.0 if self.last is None else self.last.distance,
            self.largest_deviation,
            self.deviation_time,
            self.controller,
            continues,
        )


# Goals closer than this are the same [rad or m]: controllers and encoders resolve no more.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class Served:
    """A goal whose motion was published, or is under way already.

    Attributes
    ----------
    goal : Goal
        The goal.
    plan : Plan or AdaptedPlan
        The plan.
    model : Model
        The model it was planned with.
    motion : PublishedMotion
        The published motion.
    name : object
        Identifies the goal in the report of its execution.
    primitives : tuple of MovementPrimitive
        Those of the plan. Its names may be missing in the library of a newer model.
    under_way : str
        Why nothing was published for a goal that repeats; empty if a motion was.
    """

    goal: Goal
    plan: AnyPlan
    model: Model
    motion: PublishedMotion
    name: Any = None
    primitives: tuple[MovementPrimitive, ...] = ()
    under_way: str = ""

    def rest_of_goal(self, place: float) -> Goal:
        """The goal for all joints, without a duration and without the targets before a place [s].

        Joints that the goal doesn't name keep the position that they were to have, not the one at
        that place.
        """
        goal, motions = self.goal, getattr(self.plan, "motions", ())
        if isinstance(goal, PoseGoal):
            return replace(goal, duration=None)
        end = self.plan.trajectory
        names = end.joint_names
        last: JointState | Pose = JointState(
            names, end.positions[-1], end.velocities[-1], end.accelerations[-1]
        )
        if isinstance(goal, SequenceGoal) and len(motions) == len(goal.targets):
            # The published motion begins with a part of the one that it continues.
            ends = np.cumsum([motion.duration for motion in motions])
            began = self.motion.duration - ends[-1]
            first = int(np.count_nonzero(began + ends[:-1] <= place))
            targets = [
                target if isinstance(target, Pose) else JointState(names, motion.goal.positions)
                for target, motion in zip(goal.targets, motions, strict=True)
            ]
            if targets[first + 1 :]:
                stops = goal.stops[first:]
                return SequenceGoal(tuple(targets[first:]), primitive=goal.primitive, stops=stops)
            last = targets[-1]
        # For one target, more detours are tried than for a sequence.
        if isinstance(last, Pose):
            return PoseGoal(last, primitive=goal.primitive)
        return JointGoal(last, primitive=goal.primitive)

    def answer(self, goal: Goal, start: MotionStart, model: Model) -> str:
        """Why nothing has to be published for another goal; empty if a motion is needed."""
        following = start.following
        if following is None or self.motion is not following.motion or self.model is not model:
            return ""
        if following.is_running:
            if not is_same_goal(goal, self.goal):
                return ""
            rate = max(following.progress.rate, 0.01)
            left = (following.motion.duration - following.progress.place) / rate
            return f"the goal is under way: the robot arrives in {left:.2g} s"
        if isinstance(goal, SequenceGoal):
            return ""
        if not is_same_goal(goal, self.goal):
            if not isinstance(goal, JointGoal):
                return ""
            model.planner.check(goal)
            target = model.planner.target(goal, start.state)
            if not is_same_configuration(target, start.state):
                return ""
        error = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        return f"the robot is at the goal: the largest error is {error}"


def is_same_goal(one: Goal, other: Goal) -> bool:
    """Whether two goals are of the same kind and the same except for rounding."""
    if type(one) is not type(other) or _timing(one) != _timing(other):
        return False
    pairs = zip(_targets(one), _targets(other), strict=True)
    return all(starmap(_is_same_target, pairs))


def is_same_configuration(one: JointState, other: JointState) -> bool:
    """Whether two states of the same joints, in any order, agree."""
    if set(one.joint_names) != set(other.joint_names):
        return False
    pairs = zip(one.values, in_order(other, one.joint_names).values, strict=True)
    return all(np.abs(a - b).max(initial=0.0) <= _SAME for a, b in pairs)


def _timing(goal: Goal) -> tuple[Any, ...]:
    """Options that two goals must share exactly; there are as many times as targets."""
    if isinstance(goal, SequenceGoal):
        return goal.primitive, goal.times, goal.stops
    return goal.primitive, goal.duration


def _targets(goal: Goal) -> tuple[JointState | Pose, ...]:
    if isinstance(goal, SequenceGoal):
        return goal.targets
    return (goal.state if isinstance(goal, JointGoal) else goal.pose,)


def _is_same_target(one: JointState | Pose, other: JointState | Pose) -> bool:
    if isinstance(one, JointState) and isinstance(other, JointState):
        return is_same_configuration(one, other)
    if not (isinstance(one, Pose) and isinstance(other, Pose)) or one.frame != other.frame:
        return False
    if np.abs(one.position - other.position).max() > _SAME:
        return False
    if one.orientation is None or other.orientation is None:
        return one.orientation is other.orientation
    # Quaternions of the same rotation may differ in sign.
    return abs(float(one.orientation @ other.orientation)) >= 1.0 - 0.125 * _SAME**2
