# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution reports: what became of each published motion."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .commanded import CommandedMotion
from .following import HELD, OFF, Following

ARRIVED, REPLACED, STOPPED = "arrived", "replaced", "stopped"
NOT_FOLLOWED, NEVER_STARTED = "not_followed", "never_started"

# A robot is away from its path for this time [s] before its motion counts as not followed.
_AWAY = 0.2
# It rests at the start of its motion for this time [s] before that counts as never started, and
# elsewhere on its path, or unheard of after its end, before it counts as not followed.
_START_DELAY, _LONGEST_HOLD = 1.0, 10.0
# A joint has left the start of its motion when it is this far from it [rad or m].
_LEFT_START = 0.006


@dataclass(frozen=True)
class ExecutionReport:
    """What became of a motion.

    Attributes
    ----------
    goal : object
        Identifies the motion: what `begin` was given.
    outcome : {'arrived', 'replaced', 'stopped', 'not_followed', 'never_started'}
        What became of it.
    message : str
        One sentence for a person.
    progress : float
        The share of the motion that the robot came to.
    error : float
        How far the farthest joint was from where it was commanded to be at last [rad or m].
    largest_deviation : float
        The largest such distance during the motion [rad or m].
    deviation_time : float
        When that was, since the motion was published [s].
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
        """Whether the robot did what it was asked to do."""
        return self.outcome in (ARRIVED, REPLACED, STOPPED)


@dataclass(eq=False)
class _Execution:
    goal: Any
    motion: CommandedMotion
    published: float
    is_stop: bool
    last: Following | None = None
    largest_deviation: float = 0.0
    deviation_time: float = 0.0
    # Since when the robot is away from its path, and at rest on it.
    away_since: float | None = None
    resting_since: float | None = None


class ExecutionMonitor:
    """Follows the motion that was published last; used by several threads.

    Parameters
    ----------
    report :
        Called with what became of each motion.
    """

    def __init__(self, report: Callable[[ExecutionReport], None]) -> None:
        self._report = report
        self._current: _Execution | None = None
        self._lock = threading.RLock()

    def begin(self, goal: Any, motion: CommandedMotion, now: float) -> None:
        """Follow a motion that was published now; the one before was replaced by it."""
        with self._lock:
            self._end(REPLACED, "replaced by the motion of a newer goal")
            self._current = _Execution(goal, motion, now, False)

    def stop(self, motion: CommandedMotion, now: float) -> None:
        """Follow a stop that was published now, in place of the motion that it stops."""
        with self._lock:
            if self._current is not None:
                goal, last = self._current.goal, self._current.last
                self._current = _Execution(goal, motion, now, True, last)

    def never_started(self, now: float) -> bool:
        """Whether the robot rests at the start of its motion for longer than controllers take."""
        current = self._current
        if current is None or current.last is None or current.resting_since is None:
            return False
        motion, place = current.motion, current.last.progress.place
        start = motion.state(current.published - motion.began).positions
        left = abs(motion.state(place).positions - start).max() > _LEFT_START
        return not left and now - max(current.resting_since, current.published) > _START_DELAY

    def update(self, following: Following | None, now: float) -> None:
        """Take note of how the robot follows its motion; None if nothing is heard of it."""
        with self._lock:
            current = self._current
            if current is None:
                return
            if following is None:
                if now - current.motion.began > current.motion.duration + _LONGEST_HOLD:
                    self._end(
                        NOT_FOLLOWED,
                        "not known whether the robot arrived: joint_states are silent "
                        f"{_LONGEST_HOLD:g} s after the end of the motion",
                    )
                return
            if following.motion is not current.motion:
                self._end(
                    NEVER_STARTED,
                    "never started: the robot still follows the previous motion; check that the "
                    "controller is active and accepts the trajectory",
                )
                return
            self._note(current, following, now)
            self._judge(current, following, now)

    def _note(self, current: _Execution, following: Following, now: float) -> None:
        current.last = following
        if following.distance > current.largest_deviation:
            current.largest_deviation = following.distance
            current.deviation_time = now - current.published
        if following.how != OFF:
            current.away_since = None
        elif current.away_since is None:
            current.away_since = now
        if following.how != HELD:
            current.resting_since = None
        elif current.resting_since is None:
            current.resting_since = now

    def _judge(self, current: _Execution, following: Following, now: float) -> None:
        away = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        if following.is_over and following.at_rest:
            if current.is_stop:
                since = now - current.published
                self._end(STOPPED, f"stopped: the robot is at rest {since:.2f} s after the stop")
            else:
                self._end(ARRIVED, f"arrived: the largest error is {away}")
        elif self.never_started(now):
            self._end(
                NEVER_STARTED,
                "never started: the robot rests at the start of the motion; check that the "
                "controller is active and accepts the trajectory",
            )
        elif current.away_since is not None and now - current.away_since > _AWAY:
            self._end(
                NOT_FOLLOWED,
                f"not followed: the deviation from the path is {away}; the largest one was "
                f"{current.largest_deviation:.3g}, {current.deviation_time:.2f} s after publishing",
            )
        elif current.resting_since is not None and now - current.resting_since > _LONGEST_HOLD:
            share = _share(following)
            self._end(
                NOT_FOLLOWED,
                f"not followed: the robot has rested at {share:.0%} of the motion for more than "
                f"{_LONGEST_HOLD:g} s",
            )

    def _end(self, outcome: str, message: str) -> None:
        current, self._current = self._current, None
        if current is None:
            return
        last = current.last
        self._report(
            ExecutionReport(
                current.goal,
                STOPPED if outcome == REPLACED and current.is_stop else outcome,
                message,
                0.0 if last is None else _share(last),
                0.0 if last is None else last.distance,
                current.largest_deviation,
                current.deviation_time,
            )
        )


def _share(following: Following) -> float:
    duration = following.motion.duration
    return min(following.progress.place / duration, 1.0) if duration > 0.0 else 1.0
