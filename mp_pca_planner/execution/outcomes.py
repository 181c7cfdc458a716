# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What became of goals and of published motions."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from ..motion.goal import Goal, JointGoal, JointState, PoseGoal, SequenceGoal
from .link import Planned
from .motions import PublishedMotion
from .tracking import Following, How

# Time away from the path after which a motion is not followed, at rest at its start after which it
# never started, and at rest on the path, or in silence after its end [s].
_AWAY, START_DELAY, _MAX_HOLD = 0.2, 1.0, 10.0
# Distance at which a joint has left the start [rad or m], and the speed of the slowest robot that
# is told from one that never started.
_LEFT_START, _SLOWEST = 0.006, 0.1
# Time after the end of a stop by which the robot rests, and off its path before, after which the
# stop is sent again [s]; time before that, which doubles up to the longest: on a busy machine,
# messages are late, and each moves the robot.
_STOP_MARGIN, _STOP_AWAY, _FIRST_WAIT, _LONGEST_WAIT = 0.25, 0.1, 0.04, 1.0
# Goals closer than this are the same [rad or m]: controllers and encoders resolve no more.
_SAME = 1e-4

ACCEPTED = "accepted the goal"
"""What a controller answers to a goal that it executes."""


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
    """

    goal: Any
    outcome: MotionOutcome
    message: str
    progress: float
    error: float
    largest_deviation: float
    deviation_time: float
    controller: str = ""


@dataclass(eq=False)
class Execution:
    """The execution of a published motion, up to its report.

    Attributes
    ----------
    name : object
        Identifies the goal in the report.
    motion : PublishedMotion
        The motion.
    planned : Planned or None
        The motion as planned; None for a stop.
    reason : str
        Why the robot is stopped or makes a detour.
    is_reported : bool
        Whether the outcome was reported.
    """

    name: Any
    motion: PublishedMotion
    planned: Planned | None = None
    reason: str = ""
    is_reported: bool = False
    _last: Following | None = None
    _largest_deviation: float = 0.0
    _deviation_time: float = 0.0
    _controller: str = ""
    _how: How | None = None
    _since: float = 0.0
    _wait: float = _FIRST_WAIT
    _was_at_rest: bool = False

    @classmethod
    def of_stop(
        cls, stopped: Execution | None, motion: PublishedMotion, reason: str = ""
    ) -> Execution:
        """The execution of a stop; it is reported unless that of the stopped motion was."""
        if stopped is None:
            return cls(None, motion, reason=reason, is_reported=True)
        stop = cls(stopped.name, motion, reason=reason, is_reported=stopped.is_reported)
        stop._last = stopped._last
        if stopped.is_stop:
            stop._wait = min(2.0 * stopped._wait, _LONGEST_WAIT)
        return stop

    @property
    def is_stop(self) -> bool:
        """Whether the motion stops the one before, which then gets no report of its own."""
        return self.planned is None

    @property
    def is_repeated(self) -> bool:
        """Whether this is a stop that was sent again."""
        return self._wait > _FIRST_WAIT

    def replaced(self) -> ExecutionReport | None:
        """The report on the motion when that of a newer goal replaces it; None if it had one.

        A stop counts as executed then.
        """
        outcome = MotionOutcome.STOPPED if self.is_stop else MotionOutcome.REPLACED
        return self._end(outcome, "replaced by the motion of a newer goal")

    def given_up(self, reason: str) -> ExecutionReport | None:
        """The report on a motion that can't be followed any more; None if it had one."""
        return self._end(
            MotionOutcome.NOT_FOLLOWED, f"not known whether the robot arrived: {reason}"
        )

    def answer(self, text: str, failure: MotionOutcome | None) -> ExecutionReport | None:
        """Record what the controller answered; the report if that ends the motion."""
        self._controller = "; ".join(filter(None, [self._controller, text]))
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
        ends = self.motion.began + self.motion.duration
        if following is None:
            silence = f"joint_states are silent {_MAX_HOLD:g} s after the end of the motion"
            return self.given_up(silence) if now >= ends + _MAX_HOLD else None
        if following.how is not self._how:
            self._how, self._since = following.how, now
        if self.is_stop:
            if not (following.at_rest and now >= ends):
                return None
            self._was_at_rest = True
            since = f"{now - self.motion.time:.2f} s after the stop"
            text = f"stopped: the robot was seen at rest {since}"
            again = "; send the goal again" if self.reason else ""
            return self._end(MotionOutcome.STOPPED, self._with_reason(text) + again)
        if following.motion is not self.motion:  # on a busy machine, the message comes late
            is_due = now > self.motion.time + START_DELAY and self._would_have_left(now)
            return self._never_started(now) if is_due else None
        self._last = following
        if following.distance > self._largest_deviation:
            self._largest_deviation = following.distance
            self._deviation_time = now - self.motion.time
        return self._judge(following, now)

    def is_lost(self, following: Following | None, now: float) -> bool:
        """Whether this is a stop that the controller has not taken: it is sent again."""
        if not self.is_stop or following is None or following.at_rest:
            return False
        if now < self.motion.time + self._wait:
            return False
        if following.motion is not self.motion:
            return True
        if following.is_over or self._was_at_rest:  # its servos follow, or it got a payload
            return False
        ends = self.motion.began + self.motion.duration
        is_off = following.how in (How.OFF, How.BEHIND) and self.motion.is_path_known
        return now > ends + _STOP_MARGIN or (is_off and now - self._since >= _STOP_AWAY)

    def _judge(self, following: Following, now: float) -> ExecutionReport | None:
        away = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        duration, late = now - self._since, following.place - following.motion.duration
        if following.is_over and following.at_rest:
            if self._controller == ACCEPTED and late < START_DELAY:
                return None  # the result of the controller comes a little later
            text = f"arrived: the largest error is {away}"
            return self._end(MotionOutcome.ARRIVED, self._with_reason(text))
        is_held, outcome = following.how is How.HELD, MotionOutcome.NOT_FOLLOWED
        is_at_start = not self._has_left(following.place) and self._has_left(math.inf)
        if is_held and is_at_start and duration > START_DELAY and self._would_have_left(now):
            return self._never_started(now)
        if following.how is How.OFF and duration > _AWAY:
            largest = (
                f"{self._largest_deviation:.3g}, {self._deviation_time:.2f} s after publishing"
            )
            text = f"the deviation from the path is {away}; the largest one was {largest}"
            return self._end(outcome, f"not followed: {text}")
        if is_held and duration > _MAX_HOLD:
            text = f"rested at {self._share:.0%} of the motion for more than {_MAX_HOLD:g} s"
            return self._end(outcome, f"not followed: the robot has {text}")
        return None

    def _never_started(self, now: float) -> ExecutionReport | None:
        return self._end(
            MotionOutcome.NEVER_STARTED,
            f"never started: {now - self.motion.time:.1f} s after it was sent, the robot is not "
            "seen on the motion; the controller may be inactive, have rejected it, or be late",
        )

    def _would_have_left(self, now: float) -> bool:
        """Whether even a slow robot would have left the start of the motion by now."""
        due = self._start + _SLOWEST * (now - self.motion.time)
        return self._has_left(due) or now > self.motion.time + _MAX_HOLD

    def _has_left(self, place: float) -> bool:
        """Whether a place on the motion is away from its start."""
        start, there = self.motion.sample(np.array([self._start, place]))[0]
        return bool(np.abs(there - start).max() > _LEFT_START)

    @property
    def _start(self) -> float:
        """The place at which the motion was published [s]."""
        return max(self.motion.time - self.motion.began, 0.0)

    @property
    def _share(self) -> float:
        """The share of the motion that was executed."""
        if self._last is None:
            return 0.0
        duration = self._last.motion.duration
        return min(self._last.place / duration, 1.0) if duration > 0.0 else 1.0

    def _with_reason(self, text: str) -> str:
        return f"{text}; {self.reason}" if self.reason else text

    def _end(self, outcome: MotionOutcome, message: str) -> ExecutionReport | None:
        if self.is_reported:
            return None
        self.is_reported = True
        return ExecutionReport(
            self.name,
            outcome,
            message,
            0.0 if outcome is MotionOutcome.NEVER_STARTED else self._share,
            0.0 if self._last is None else self._last.distance,
            self._largest_deviation,
            self._deviation_time,
            self._controller,
        )

    def rest_of_goal(self) -> Goal | None:
        """The goal for all joints, without a duration; None for a stop or several targets.

        Joints that the goal doesn't name keep the position that they were to have.
        """
        if self.planned is None:
            return None
        goal, end = self.planned.goal, self.planned.trajectory
        if isinstance(goal, SequenceGoal) and len(goal.targets) > 1:
            return None
        if isinstance(goal, PoseGoal):
            return replace(goal, duration=None)
        last = (end.positions[-1], end.velocities[-1], end.accelerations[-1])
        return JointGoal(JointState(end.joint_names, *last), primitive=goal.primitive)

    def repeats(self, goal: Goal, following: Following | None) -> str:
        """Why nothing has to be published for another goal; empty if a motion is needed."""
        if self.planned is None or following is None or following.motion is not self.motion:
            return ""
        is_same = is_same_goal(goal, self.planned.goal)
        if following.is_running and is_same:
            left = (following.motion.duration - following.place) / max(following.rate, 0.01)
            return f"the goal is under way: the robot arrives in {left:.2g} s"
        if not (following.is_over and is_same) or isinstance(goal, SequenceGoal):
            return ""
        error = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        return f"the robot is at the goal: the largest error is {error}"


def is_same_goal(one: Any, other: Any) -> bool:
    """Whether two goals, or parts of them, are the same except for rounding."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and bool(np.all(np.abs(one - other) <= _SAME))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(is_same_goal, one, other))
    if is_dataclass(one):
        names = (field.name for field in fields(one))
        return all(is_same_goal(getattr(one, name), getattr(other, name)) for name in names)
    return bool(one == other)
