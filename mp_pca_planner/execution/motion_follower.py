# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last, and how the robot follows it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from .following import HELD, LAGGING, OFF, ON_TIME, Following, FollowingOptions
from .joined import Joined
from .measured import Clock, MeasuredStates, Samples, StateReader
from .parameters import Settings
from .published_motion import PublishedMotion
from .servo import ServoModel
from .stopping import hold
from .tracking import Progress, TrackedMotion, locate

_TAKEN, _REFUSED, _DOUBTFUL, _ALIKE = "taken", "refused", "doubtful", "alike"


@dataclass(eq=False)
class _Track:
    """What is known of the motion that was published last.

    Attributes
    ----------
    joined : Joined
        What was published.
    current : TrackedMotion
        The motion that the robot follows as far as is known.
    previous : TrackedMotion or None
        What the robot does if the controller has not taken that motion; None once it is seen to
        have taken it.
    unconfirmed_since : float
        When `previous` was replaced [s].
    is_lagging, is_arrived : bool
        Whether the robot was seen to lag, or to rest at the end.
    """

    joined: Joined
    current: TrackedMotion
    previous: TrackedMotion | None
    unconfirmed_since: float
    is_lagging: bool = False
    is_arrived: bool = False


@dataclass(frozen=True, eq=False)
class _Seen:
    """The measured state, whether it is one of rest, and those before."""

    state: JointState
    at_rest: bool
    samples: Samples


class MotionFollower:
    """Knows the motion that was published last, and how the robot follows it.

    Parameters
    ----------
    reader, receipt_clock, motion_clock, fetch :
        See `MeasuredStates`.
    options :
        Thresholds.

    Attributes
    ----------
    measured : MeasuredStates
        The measured states.
    """

    def __init__(
        self,
        reader: StateReader,
        receipt_clock: Clock,
        motion_clock: Clock,
        fetch: Callable[[], None] = lambda: None,
        options: FollowingOptions | None = None,
    ) -> None:
        self._options = options or FollowingOptions()
        self.measured = MeasuredStates(
            reader, receipt_clock, motion_clock, fetch, self._options.measuring
        )
        self._motion_clock = motion_clock
        # Goals are served in one thread, stops and reports in another.
        self._lock = threading.RLock()
        self._forget()

    def _forget(self) -> None:
        self._track: _Track | None = None
        self._servo = ServoModel(len(self.measured.joint_names), self._options.servo)
        # Of positions at rest [rad or m].
        self._noise = 0.0

    def expect(self, joint_names: tuple[str, ...]) -> None:
        """Set the joints whose state is needed, and discard what is known of other joints."""
        if self.measured.joint_names != tuple(joint_names):
            with self._lock:
                self.measured.expect(joint_names)
                self._forget()

    def command(self, joined: Joined) -> PublishedMotion:
        """Note that a motion was published."""
        with self._lock:
            old, motion, now = self._track, joined.motion, joined.time
            is_lagging = old is not None and old.is_lagging
            rate = old.current.progress.rate if old is not None and is_lagging else 1.0
            if old is None or motion.began >= now:
                # A robot at rest stays there if the controller does not take the motion.
                start = hold(joined.trajectory.joint_names, joined.trajectory.positions[0])
                previous = TrackedMotion(PublishedMotion(start, now), Progress(now, 0.0))
                since = now
            elif old.previous is None:
                previous, since = old.current, now
            else:
                previous, since = old.previous, old.unconfirmed_since
            place = now - motion.began - self._servo.lag * rate
            current = TrackedMotion(motion, Progress(now, place, rate))
            self._track = _Track(joined, current, previous, since, is_lagging)
        return motion

    def give_up(self) -> None:
        """Note that the controller has not taken the motion that was published last."""
        with self._lock:
            track = self._track
            if track is not None and track.previous is not None:
                track.current, track.previous = track.previous, None
                track.is_arrived = track.is_lagging = False

    @property
    def motion_time(self) -> float:
        """The time by the clock of motions [s]; simulated time has its own rate."""
        return self._motion_clock()

    @property
    def commanded(self) -> PublishedMotion | None:
        """The motion that was published last, unless time was set back since."""
        track = self._track
        if track is None or self._motion_clock() < track.current.motion.began - 1.0:
            return None
        return track.current.motion

    @property
    def last_place(self) -> float:
        """The place on that motion at which the robot was seen last [s]."""
        return 0.0 if self._track is None else self._track.current.progress.place

    @property
    def load_offset(self) -> FloatArray:
        """Distance that a load pulls the robot away from its commanded position [rad or m]."""
        return self._servo.load

    @property
    def alternatives(self) -> list[JointState]:
        """The commanded state if the controller has not taken that motion; none if it has."""
        with self._lock:
            previous = None if self._track is None else self._track.previous
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
        with self._lock:
            motion = self.commanded
            measured = self.measured.newest(settings.state_timeout)
            track = self._track
            if motion is None or track is None:
                return None
            now = self._motion_clock()
            at_rest = not self.measured.velocities(measured).any()
            seen = _Seen(measured, at_rest, self.measured.history())
            on_time = Progress(now, now - motion.began)
            if track.is_arrived:
                found = self._following(track, ON_TIME, on_time, seen)
            else:
                known = self._follow(track, on_time, seen)
                if known is None:
                    return self.follow(settings)
                found = known
            is_near = found.distance <= settings.commanded_tolerance
            return found if is_near else replace(found, how=OFF)

    def _follow(self, track: _Track, on_time: Progress, seen: _Seen) -> Following | None:
        """How the robot follows a motion; None if what was known of it has proved wrong."""
        motion, samples, servo = track.current.motion, seen.samples, self._servo
        known = samples.times >= motion.began
        window = Samples(samples.times[known], samples.positions[known] - servo.offset)
        progress = track.current.progress
        found = locate(motion, window, progress, on_time.time, self._options.tracking)
        confirmation = self._confirmation(track, found, seen)
        if confirmation == _REFUSED:
            self.give_up()
            return None
        if confirmation == _TAKEN:
            track.previous = None
        track.current = TrackedMotion(motion, found)
        is_over = on_time.place >= motion.duration
        is_late = not self._is_on_time(track, on_time, found)
        if is_late and seen.at_rest and is_over:
            left = np.abs(motion.state(found.place).positions - motion.end).max()
            is_late = bool(found.error < self._options.beside_share * left)
        if is_late and servo.unlearn():
            return None
        if seen.at_rest and len(samples.positions) > 2:
            # Differences of neighbours: a robot that still settles is not noise.
            steps = np.diff(samples.positions, axis=0)
            self._noise = float(steps.std(axis=0).max()) / np.sqrt(2.0)
        track.is_lagging = is_late and not seen.at_rest
        ahead = servo.lag * found.rate - self._options.cycle * (1.0 - found.rate)
        command = replace(found, place=found.place + ahead)
        if is_late:
            return self._following(track, HELD if seen.at_rest else LAGGING, command, seen)
        is_timed = track.joined.is_on_time
        is_sure = track.joined.is_path_known and is_timed and confirmation != _DOUBTFUL
        if known.any() and is_sure and not is_over:
            lag = on_time.place - found.place
            servo.learn(motion, float(samples.times[-1]), seen.state.positions, lag)
        # The clock does not say where a motion is that the controller started on receipt.
        following = self._following(
            track, ON_TIME, on_time if is_timed or is_over else command, seen
        )
        return self._arrival(track, following, seen) if seen.at_rest and is_over else following

    def _confirmation(self, track: _Track, found: Progress, seen: _Seen) -> str:
        """Whether the position of the robot shows that the newest motion was taken."""
        options, times, previous = self._options, seen.samples.times, track.previous
        if previous is None or not len(times):
            return _ALIKE
        motion, when = track.current.motion, float(times[-1])
        if when < track.unconfirmed_since + options.visible_time:
            return _ALIKE
        measured = seen.samples.positions[-1] - self._servo.offset
        new, old = motion.state(found.at(when)).positions, previous.state(when).positions
        # Motions to goals that differ little share their path and differ by their timing, unless
        # the robot is late on either.
        due = new
        if track.joined.is_on_time and not track.is_lagging:
            due = motion.state(when - motion.began - self._servo.lag).positions
        to_new, to_due, to_old, between = (
            float(np.abs(x).max())
            for x in (measured - new, measured - due, measured - old, due - old)
        )
        noise = 4.0 * self._noise
        if between >= options.taken_distance + noise and max(to_new, to_due) < 0.5 * to_old:
            return _TAKEN
        at_rest = options.refused_rest_distance + noise
        refused = at_rest if seen.at_rest else options.refused_distance
        if to_new >= refused and to_old < 0.5 * to_new:
            return _REFUSED
        return _DOUBTFUL if between > options.same_distance else _ALIKE

    def _is_on_time(self, track: _Track, on_time: Progress, found: Progress) -> bool:
        options, joined, servo = self._options, track.joined, self._servo
        places = np.array([on_time.place, found.place + servo.lag * found.rate])
        clock, path = track.current.motion.sample(places)[0]
        is_start = joined.is_on_time and on_time.time < joined.time + options.start_time
        is_start = is_start and joined.motion.began >= joined.time
        near = options.start_distance if is_start else options.on_time_distance
        is_near = bool(np.abs(clock - path).max() <= near)
        lag = abs(on_time.place - found.place)
        has_no_lag = lag <= servo.longest_lag
        has_its_rate = abs(found.rate - 1.0) <= options.on_time_rate
        if not track.is_lagging:
            return is_near or (has_no_lag and has_its_rate)
        # A robot that has lagged stays late at full rate, even where it is near the end of its
        # motion; unless a load made the lag of its servos look longer.
        is_usual = abs(lag - servo.lag) <= options.load_lag and has_its_rate
        return has_no_lag and (is_near or is_usual)

    def _arrival(self, track: _Track, following: Following, seen: _Seen) -> Following:
        """Note that a robot that rests after a motion has arrived, unless it is elsewhere."""
        motion = following.motion
        away = np.abs(seen.state.positions - motion.end - self._servo.offset).max()
        if away > self._options.missed_distance:
            return replace(following, how=OFF)
        # A state from before the end of the motion says nothing about after it.
        track.is_arrived = self.measured.newest_time >= motion.began + motion.duration
        if track.is_arrived:
            track.previous = None
        return following

    def _following(self, track: _Track, how: str, progress: Progress, seen: _Seen) -> Following:
        motion, when = track.current.motion, self.measured.newest_time
        place = progress.at(when)
        if how == ON_TIME and place < motion.duration:
            # The measured position lags behind the command of its own time.
            place = track.current.progress.at(when)
        away = np.abs(seen.state.positions - motion.state(place).positions)
        worst = int(away.argmax())
        is_known = progress.place < motion.duration or when >= motion.began + motion.duration
        joint, at_rest = seen.state.joint_names[worst], is_known and seen.at_rest
        return Following(motion, how, progress, float(away[worst]), joint, at_rest)
