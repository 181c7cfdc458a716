# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of how the robot follows the motion that was published last."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from .following import (
    DOUBTFUL,
    HELD,
    LAGGING,
    OFF,
    ON_TIME,
    REFUSED,
    Following,
    FollowingState,
    Publication,
    ServoModel,
)
from .measured import MeasuredSamples, MeasuredStates
from .parameters import Settings
from .published_motion import Joined, Progress, PublishedMotion, TrackedMotion, locate
from .timed_lock import TimedLock

if TYPE_CHECKING:
    from ..robot.world import World
    from .execution_monitor import Execution


class MotionFollower:
    """Tracks the motion that was published last, and how the robot follows it.

    Parameters
    ----------
    measured : MeasuredStates
        The measured states, with the clock of motions and the thresholds.

    Attributes
    ----------
    measured : MeasuredStates
        As given.
    published : Publication or None
        The motion that was published last; None if there is none.
    lock : TimedLock
        Held while a motion is published, so that no thread sees half of the change.
    """

    def __init__(self, measured: MeasuredStates) -> None:
        self.measured = measured
        self._options = measured.options
        self._motion_clock = measured.clock.now
        # Goals are served in one thread, stops and reports in another.
        self.lock = TimedLock()
        self._forget()

    def _forget(self) -> None:
        self.published: Publication | None = None
        self._servo = ServoModel(len(self.measured.joint_names), self._options)
        # Noise of positions at rest [rad or m].
        self._noise = 0.0

    def expect(self, joint_names: tuple[str, ...]) -> None:
        """Set the joints whose state is needed; states and motions of others are forgotten."""
        with self.lock:
            self.measured.expect(joint_names)
            self._forget()

    def command(
        self, joined: Joined, execution: Execution | None = None, world: World | None = None
    ) -> None:
        """Record that a motion was published, and in which world it was checked."""
        with self.lock:
            published = Publication.after(self.published, joined, self._servo.lag, execution)
            published.checked = None if world is None else (joined.motion, world)
            self.published = published

    @property
    def execution(self) -> Execution | None:
        """The execution of the motion that was published last; None if there is none."""
        published = self.published
        return None if published is None else published.execution

    @property
    def motion_time(self) -> float:
        """The time by the clock of motions [s]; simulated time has its own rate."""
        return self._motion_clock()

    @property
    def commanded(self) -> PublishedMotion | None:
        """The motion that was published last, unless time was set back since."""
        published = self.published
        if published is None or self._motion_clock() < published.current.motion.began - 1.0:
            return None
        return published.current.motion

    @property
    def last_place(self) -> float:
        """The place on that motion at which the robot was seen last [s]."""
        return 0.0 if self.published is None else self.published.current.progress.place

    @property
    def load_offset(self) -> FloatArray:
        """Distance that a load pulls the robot away from its commanded position [rad or m]."""
        return self._servo.load

    @property
    def alternatives(self) -> list[JointState]:
        """The commanded state if the controller has not accepted that motion; else None."""
        with self.lock:
            previous = None if self.published is None else self.published.previous
            return [] if previous is None else [previous.state(self._motion_clock())]

    def follow(self, settings: Settings) -> Following | None:
        """How the robot follows the motion that was published last; None if there is none.

        Parameters
        ----------
        settings : Settings
            With `state_timeout` and `commanded_tolerance`.

        Raises
        ------
        GoalError
            If there is no usable measured state.
        """
        with self.lock:
            execution = self.execution
            self.measured.clock.settle(is_idle=execution is None or execution.is_reported)
            motion = self.commanded
            measured = self.measured.newest(settings.state_timeout)
            published = self.published
            if motion is None or published is None:
                return None
            now = self._motion_clock()
            at_rest = not self.measured.velocities(measured).any()
            seen = FollowingState(measured, at_rest, self.measured.history())
            on_time = Progress(now, now - motion.began)
            following = self._follow(published, on_time, seen)
            if following is None:
                return self.follow(settings)
            is_near = following.distance <= settings.commanded_tolerance
            return following if is_near else replace(following, how=OFF)

    def _follow(
        self, published: Publication, on_time: Progress, seen: FollowingState
    ) -> Following | None:
        """How the robot follows a motion; None if the motion or the servo model was wrong."""
        if published.is_arrived:
            return self._following(published, ON_TIME, on_time, seen)
        motion, samples, servo = published.current.motion, seen.samples, self._servo
        options = self._options
        known = samples.times >= motion.began
        window = MeasuredSamples(samples.times[known], samples.positions[known] - servo.offset)
        progress = published.current.progress
        found = locate(motion, window, progress, on_time.time, options)
        confirmation = published.confirm(found, seen, servo, self._noise, options)
        if confirmation == REFUSED:
            return None
        published.current = TrackedMotion(motion, found)
        is_over = on_time.place >= motion.duration
        lag = on_time.place - found.place
        is_timed = published.joined.is_on_time
        is_certain = is_timed and confirmation != DOUBTFUL and not is_over
        if is_certain and abs(found.rate - 1.0) <= options.on_time_rate:
            speed = float(np.linalg.norm(motion.state(found.place).velocities))
            servo.limit_lag(speed, lag)
        is_late = not published.is_on_time(on_time, found, servo, options)
        if is_late and seen.at_rest and is_over:
            left = np.abs(motion.state(found.place).positions - motion.end).max()
            is_late = bool(found.error < options.beside_share * left)
        if is_late and servo.unlearn():
            return None
        if seen.at_rest and len(samples.positions) > 2:
            # Differences of neighbouring samples, so that the settling of the robot is not counted
            # as noise.
            steps = np.diff(samples.positions, axis=0)
            self._noise = float(steps.std(axis=0).max()) / np.sqrt(2.0)
        published.is_lagging = is_late and not seen.at_rest
        ahead = servo.lag * found.rate - options.cycle * (1.0 - found.rate)
        command = replace(found, place=found.place + ahead)
        if is_late:
            return self._following(published, HELD if seen.at_rest else LAGGING, command, seen)
        if known.any() and is_certain and published.joined.is_path_known:
            servo.learn(motion, float(samples.times[-1]), seen.state.positions, lag)
        # For a motion that the controller started on receipt, the clock does not determine the
        # place.
        command = on_time if is_timed or is_over else command
        following = self._following(published, ON_TIME, command, seen)
        # A state from before the end of the motion is no evidence of an arrival, nor of a miss.
        is_known = following.at_rest and is_over
        return self._arrival(published, following, seen) if is_known else following

    def _arrival(
        self, published: Publication, following: Following, seen: FollowingState
    ) -> Following:
        """Record the arrival of a robot at rest after its motion, unless far from the end."""
        motion, options = following.motion, self._options
        away = np.abs(seen.state.positions - motion.end - self._servo.offset).max()
        is_known = following.is_path_known
        if away > (options.missed_distance if is_known else options.missed_stop_distance):
            return replace(following, how=OFF)
        published.is_arrived, published.previous = True, None
        return following

    def _following(
        self, published: Publication, how: str, progress: Progress, seen: FollowingState
    ) -> Following:
        motion, when = published.current.motion, self.measured.newest_time
        place = progress.at(when)
        if how == ON_TIME and place < motion.duration:
            # The measured position lags behind the command of its own time.
            place = published.current.progress.at(when)
        away = np.abs(seen.state.positions - motion.state(place).positions)
        worst = int(away.argmax())
        is_known = progress.place < motion.duration or when >= motion.began + motion.duration
        joint, at_rest = seen.state.joint_names[worst], is_known and seen.at_rest
        is_path_known, distance = published.joined.is_path_known, float(away[worst])
        return Following(motion, how, progress, distance, joint, at_rest, is_path_known)
