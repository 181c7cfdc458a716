# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution reports: the outcome of each published motion."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .following import HELD, OFF, Following
from .options import ServingOptions
from .published_motion import PublishedMotion

ARRIVED, REPLACED, STOPPED = "arrived", "replaced", "stopped"
NOT_FOLLOWED, NEVER_STARTED = "not_followed", "never_started"


@dataclass(frozen=True)
class ExecutionReport:
    """Outcome of a motion.

    Attributes
    ----------
    goal : object
        Identifies the motion: the first argument of `begin`.
    outcome : {'arrived', 'replaced', 'stopped', 'not_followed', 'never_started'}
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
    """

    goal: Any
    outcome: str
    message: str
    progress: float
    error: float
    largest_deviation: float
    deviation_time: float

    @property
    def is_good(self) -> bool:
        """Whether the motion was executed as requested."""
        return self.outcome in (ARRIVED, REPLACED, STOPPED)


@dataclass(eq=False)
class _Execution:
    """A motion that is being executed, and how the robot has followed it."""

    goal: Any
    motion: PublishedMotion
    published: float
    reason: str = ""
    is_stop: bool = False
    last: Following | None = None
    largest_deviation: float = 0.0
    deviation_time: float = 0.0
    # State of following, and the time since when it holds.
    how: str = ""
    since: float = 0.0

    def note(self, following: Following, now: float) -> None:
        """Record how the robot follows the motion."""
        self.last = following
        if following.distance > self.largest_deviation:
            self.largest_deviation = following.distance
            self.deviation_time = now - self.published
        if following.how != self.how:
            self.how, self.since = following.how, now

    @property
    def share(self) -> float:
        """The share of the motion that was executed."""
        if self.last is None:
            return 0.0
        duration = self.last.motion.duration
        return min(self.last.progress.place / duration, 1.0) if duration > 0.0 else 1.0


class ExecutionMonitor:
    """Follows the motion that was published last; used by several threads.

    Parameters
    ----------
    report :
        Called with the outcome of each motion.
    options :
        Thresholds.
    """

    def __init__(
        self, report: Callable[[ExecutionReport], None], options: ServingOptions | None = None
    ) -> None:
        self._report = report
        self._options = options or ServingOptions()
        self._current: _Execution | None = None
        self._lock = threading.RLock()

    def begin(self, goal: Any, motion: PublishedMotion, now: float, reason: str = "") -> None:
        """Follow a motion that was published now; it replaces the one before, for a reason."""
        with self._lock:
            why = f"another motion, for {reason}" if reason else "the motion of a newer goal"
            self._end(REPLACED, f"replaced by {why}")
            self._current = _Execution(goal, motion, now)

    def stop(self, motion: PublishedMotion, now: float, reason: str = "") -> None:
        """Follow a stop that was published now, in place of the motion that it stops."""
        with self._lock:
            if self._current is not None:
                goal, last = self._current.goal, self._current.last
                self._current = _Execution(
                    goal, motion, now, reason=reason, is_stop=True, last=last
                )

    def never_started(self, now: float) -> bool:
        """Whether the robot has rested at the start of its motion for too long."""
        current, options = self._current, self._options
        if current is None or current.last is None or current.how != HELD:
            return False
        motion, place = current.motion, current.last.progress.place
        start = motion.state(current.published - motion.began).positions
        if abs(motion.state(place).positions - start).max() > options.left_start:
            return False
        return now - max(current.since, current.published) > options.start_delay

    def update(self, following: Following | None, now: float) -> None:
        """Record how the robot follows its motion; None means that it sends no states."""
        with self._lock:
            current, max_hold = self._current, self._options.max_hold
            if current is None:
                return
            if following is None:
                if now - current.motion.began > current.motion.duration + max_hold:
                    self._end(
                        NOT_FOLLOWED,
                        "not known whether the robot arrived: joint_states are silent "
                        f"{max_hold:g} s after the end of the motion",
                    )
            elif following.motion is not current.motion:
                self._end(
                    NEVER_STARTED,
                    "never started: the robot still follows the previous motion; check that the "
                    "controller is active and accepts the trajectory",
                )
            else:
                current.note(following, now)
                self._judge(current, following, now)

    def _judge(self, current: _Execution, following: Following, now: float) -> None:
        options = self._options
        away = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        duration = now - current.since
        if following.is_over and following.at_rest:
            if current.is_stop:
                since = now - current.published
                text = f"stopped: the robot is at rest {since:.2f} s after the stop"
                self._end(STOPPED, f"{text}; {current.reason}" if current.reason else text)
            else:
                self._end(ARRIVED, f"arrived: the largest error is {away}")
        elif self.never_started(now):
            self._end(
                NEVER_STARTED,
                "never started: the robot rests at the start of the motion; check that the "
                "controller is active and accepts the trajectory",
            )
        elif current.how == OFF and duration > options.away_time:
            self._end(
                NOT_FOLLOWED,
                f"not followed: the deviation from the path is {away}; the largest one was "
                f"{current.largest_deviation:.3g}, {current.deviation_time:.2f} s after publishing",
            )
        elif current.how == HELD and duration > options.max_hold:
            self._end(
                NOT_FOLLOWED,
                f"not followed: the robot has rested at {current.share:.0%} of the motion for more "
                f"than {options.max_hold:g} s",
            )

    def _end(self, outcome: str, message: str) -> None:
        current, self._current = self._current, None
        if current is None:
            return
        if outcome == REPLACED and current.is_stop:
            outcome = STOPPED
        self._report(
            ExecutionReport(
                current.goal,
                outcome,
                message,
                current.share,
                0.0 if current.last is None else current.last.distance,
                current.largest_deviation,
                current.deviation_time,
            )
        )
