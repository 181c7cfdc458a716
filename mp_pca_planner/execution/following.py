# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last, how a robot follows it, and the model of its servos."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.goal import JointState
from .measured import MeasuredSamples
from .options import FollowingOptions
from .published_motion import Joined, Progress, PublishedMotion, TrackedMotion, hold

if TYPE_CHECKING:
    from ..robot.world import World
    from .execution_monitor import Execution
    from .surroundings import Threat


class ServoModel:
    """Offset of a load and lag of the servos, learned from a robot that runs on time.

    Parameters
    ----------
    n_joints : int
        Number of joints.
    options : FollowingOptions, optional
        Parameters of the model.

    Attributes
    ----------
    load : array, shape (n_joints,)
        Measured minus commanded positions at the last rest [rad or m].
    offset : array, shape (n_joints,)
        The current offset, with the effect of accelerations [rad or m].
    lag : float
        Delay with which commands are followed [s].
    """

    def __init__(self, n_joints: int, options: FollowingOptions | None = None) -> None:
        self._options = options or FollowingOptions()
        self.load: FloatArray = np.zeros(n_joints)
        self.offset = self.load
        self.lag = self._options.initial_lag
        # Total duration of fast motions used for learning [s].
        self._experience = 0.0
        self._learned: deque[tuple[float, FloatArray, float]] = deque()

    def rest(self, offset: FloatArray) -> None:
        """Set the offset that was measured at rest."""
        self.load = self.offset = offset
        self._learned.clear()

    def learn(
        self, motion: PublishedMotion, time: float, positions: FloatArray, lag: float
    ) -> None:
        """Learn from a robot that runs on time.

        Parameters
        ----------
        motion : PublishedMotion
            The motion that it follows.
        time : float
            When it was measured [s].
        positions : array, shape (n_joints,)
            Measured positions [rad or m].
        lag : float
            Estimated lag behind the clock [s].
        """
        options = self._options
        last = self._learned[-1][0] if self._learned else time - 0.01
        since = min(max(time - last, 0.0), options.servo_time)
        share = 1.0 - np.exp(-since / options.servo_time)
        self._learned.append((time, self.offset, self.lag))
        while self._learned[0][0] < time - options.servo_memory:
            self._learned.popleft()
        q, v, _ = (x[0] for x in motion.sample(np.array([time - motion.began - self.lag])))
        is_new = self._experience < options.servo_time
        speed, slow = float(v @ v), options.slow**2
        fast = speed / (speed + slow)
        self._experience += fast * since
        gain = fast * (1.0 if is_new else options.lag_share * share)
        self.lag = float(np.clip(self.lag + gain * (lag - self.lag), 0.0, options.max_lag))
        if not is_new:
            error = positions - q - self.offset
            along = float(v @ error) / (speed + slow)
            self.offset = self.offset + share * (error - v * along)

    def limit_lag(self, speed: float, lag: float) -> None:
        """Reduce the lag to that of a robot in fast motion, which never leads its command.

        Parameters
        ----------
        speed : float
            Norm of its joint velocities [rad/s or m/s].
        lag : float
            Time by which it is behind the clock [s].
        """
        if speed > 2.0 * self._options.slow and lag < self.lag - self._options.lag_noise:
            self.lag = max(lag, 0.0)
            self._learned.clear()

    @property
    def longest_lag(self) -> float:
        """Largest lag of a robot that counts as on time [s]."""
        options = self._options
        is_new = self._experience < 2.0 * options.servo_time
        return options.max_lag if is_new else self.lag + options.lag_noise

    def unlearn(self) -> bool:
        """Discard the values learned last, because the robot was no longer on time."""
        if not self._learned:
            return False
        _, self.offset, self.lag = self._learned[0]
        self._learned.clear()
        return True


ON_TIME, LAGGING, HELD, OFF = "on_time", "lagging", "held", "off"
"""The robot is at its place by the clock, moves along the path behind that place, rests short of
the end of the motion, or is away from the path."""

TAKEN, REFUSED, DOUBTFUL, ALIKE = "taken", "refused", "doubtful", "alike"
"""The robot follows the newest motion, or the one before; it may follow either, and they differ;
or they do not differ noticeably."""


class UnconfirmedError(TrajectoryError):
    """The place of the robot on the motion that was published last is not known yet."""


@dataclass(frozen=True, eq=False)
class Following:
    """How a robot follows the motion that was published last.

    Attributes
    ----------
    motion : PublishedMotion
        That motion.
    how : {'on_time', 'lagging', 'held', 'off'}
        How the robot follows it.
    progress : Progress
        The place of its command.
    distance : float
        Largest distance of a joint from there [rad or m].
    joint : str
        The joint with that distance.
    at_rest : bool
        Whether the robot rests.
    is_path_known : bool
        See `Joined`. If not, a robot at rest may be short of the end.
    """

    motion: PublishedMotion
    how: str
    progress: Progress
    distance: float
    joint: str
    at_rest: bool
    is_path_known: bool = True

    @property
    def is_over(self) -> bool:
        """Whether the robot holds the end of the motion."""
        return self.how == ON_TIME and self.progress.place >= self.motion.duration

    @property
    def is_running(self) -> bool:
        """Whether the robot moves along the motion."""
        return self.how in (ON_TIME, LAGGING) and not self.is_over


@dataclass(frozen=True, eq=False)
class FollowingState:
    """The measured state, whether the robot rests, and its positions in the last moments."""

    state: JointState
    at_rest: bool
    samples: MeasuredSamples


@dataclass(eq=False)
class Publication:
    """The motion that was published last: what is running, for all who ask.

    Attributes
    ----------
    joined : Joined
        The motion with the time of its first point.
    current : TrackedMotion
        The motion that the robot follows according to the measured positions.
    previous : TrackedMotion or None
        The motion that the robot follows if the controller has not accepted the newest one; None
        once the measured positions confirm the newest one.
    unconfirmed_since : float
        Time since when the accepted motion is unknown [s].
    is_lagging, is_arrived : bool
        Whether the robot was seen to lag, or to rest at the end.
    execution : Execution or None
        Its goal and its report.
    threat : Threat or None
        The next collision of its rest with an obstacle that was not there when it was planned.
    checked : tuple of (PublishedMotion, World) or None
        The motion that was checked for such a collision last, and the obstacles.
    concluded : tuple of (float, str)
        Time of the newest measured state [s] for which :meth:`confirm` came to a conclusion, and
        that.
    """

    joined: Joined
    current: TrackedMotion
    previous: TrackedMotion | None
    unconfirmed_since: float
    is_lagging: bool = False
    is_arrived: bool = False
    execution: Execution | None = None
    threat: Threat | None = None
    checked: tuple[PublishedMotion, World] | None = None
    concluded: tuple[float, str] = (-math.inf, ALIKE)

    @classmethod
    def after(
        cls, old: Publication | None, joined: Joined, lag: float, execution: Execution | None = None
    ) -> Publication:
        """The publication that replaces another one, for servos with this lag [s]."""
        motion, now = joined.motion, joined.time
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
        progress = Progress(now, now - motion.began - lag * rate, rate)
        current = TrackedMotion(motion, progress)
        return cls(joined, current, previous, since, is_lagging, execution=execution)

    def give_up(self) -> None:
        """Record that the controller has not accepted the motion."""
        if self.previous is not None:
            self.current, self.previous = self.previous, None
            self.is_arrived = self.is_lagging = False

    def confirm(
        self,
        found: Progress,
        seen: FollowingState,
        servo: ServoModel,
        noise: float,
        options: FollowingOptions,
    ) -> str:
        """Determine from measured positions which motion the controller accepted.

        Parameters
        ----------
        found : Progress
            Place of the robot on the newest motion.
        seen : FollowingState
            The measured positions.
        servo : ServoModel
            Offset and lag of the servos.
        noise : float
            Noise of measured positions [rad or m].
        options : FollowingOptions
            Thresholds.

        Returns
        -------
        {'taken', 'refused', 'doubtful', 'alike'}
            The conclusion.
        """
        times, previous = seen.samples.times, self.previous
        if previous is None or not len(times):
            return ALIKE
        motion, when = self.current.motion, float(times[-1])
        if when < self.unconfirmed_since + options.visible_time:
            return ALIKE
        if when == self.concluded[0]:  # without new states, only the error of the place grows
            return self.concluded[1]
        is_over = seen.at_rest and when >= motion.began + motion.duration
        # At rest, the accelerations that the newest offset still contains have no effect.
        offsets = np.stack([servo.offset, servo.load] if is_over else [servo.offset])
        measured = seen.samples.positions[-1] - offsets
        new, old = motion.state(found.at(when)).positions, previous.state(when).positions
        # Motions to similar goals share their path and differ in timing only, unless the robot lags
        # on either.
        due = new
        if self.joined.is_on_time and not self.is_lagging:
            due = motion.state(when - motion.began - servo.lag).positions
        to_new, to_due, to_old, between = (
            float(np.abs(x).max(axis=-1).min())
            for x in (measured - new, measured - due, measured - old, due - old)
        )
        margin = 4.0 * noise
        if between >= options.taken_distance + margin and max(to_new, to_due) < 0.5 * to_old:
            self.previous = None
            return TAKEN
        at_rest = options.refused_rest_distance + margin
        refused = at_rest if seen.at_rest else options.refused_distance
        # A robot that rests after both motions where the old one ends is not on this one, however
        # near they are. At its start, it may only be slow to move.
        rests_on_old = is_over and to_new >= 0.5 * at_rest and to_old < 0.1 * to_new
        # A robot that waits for a late message rests where it was, as if it had been rejected.
        is_from_rest = previous.motion.duration == 0.0
        may_be_late = is_from_rest and when < self.unconfirmed_since + options.late_start
        is_on_old = rests_on_old or (to_new >= refused and to_old < 0.5 * to_new)
        if is_on_old and not may_be_late:
            self.give_up()
            return REFUSED
        self.concluded = when, DOUBTFUL if between > options.same_distance else ALIKE
        return self.concluded[1]

    def is_on_time(
        self, on_time: Progress, found: Progress, servo: ServoModel, options: FollowingOptions
    ) -> bool:
        """Whether the robot is at its place by the clock, except for the lag of its servos.

        Parameters
        ----------
        on_time, found : Progress
            The place by the clock, and that of the robot.
        servo : ServoModel
            Lag of the servos.
        options : FollowingOptions
            Thresholds.
        """
        joined = self.joined
        places = np.array([on_time.place, found.place + servo.lag * found.rate])
        clock, path = self.current.motion.sample(places)[0]
        is_start = joined.is_on_time and on_time.time < joined.time + options.start_time
        is_start = is_start and joined.motion.began >= joined.time
        near = options.start_distance if is_start else options.on_time_distance
        is_near = bool(np.abs(clock - path).max() <= near)
        lag = abs(on_time.place - found.place)
        has_no_lag = lag <= servo.longest_lag
        has_its_rate = abs(found.rate - 1.0) <= options.on_time_rate
        if not self.is_lagging:
            return is_near or (has_no_lag and has_its_rate)
        # A robot that lagged before remains late at full rate, even near the end of its motion,
        # unless a load increased the apparent lag of its servos.
        is_usual = abs(lag - servo.lag) <= options.load_lag and has_its_rate
        return has_no_lag and (is_near or is_usual)

    def check_taken(
        self, following: Following, then: float, lag: float, options: FollowingOptions
    ) -> None:
        """Check that a running motion may be continued at a later time.

        Parameters
        ----------
        following : Following
            How the robot follows the motion.
        then : float
            Time at which it is to be continued [s].
        lag : float
            Lag of the servos [s].
        options : FollowingOptions
            Thresholds.

        Raises
        ------
        UnconfirmedError
            If something else stops the robot, or it may follow another motion.
        """
        progress = following.progress
        if following.how == LAGGING and progress.rate < options.min_rate:
            raise UnconfirmedError(
                "the robot comes to rest short of the end of its motion; send the goal again when "
                "it is at rest"
            )
        if not self.joined.is_path_known:
            raise UnconfirmedError(
                "the robot is being stopped by a single point, so its path is not known; send the "
                "goal again when it is at rest"
            )
        if self.previous is None:
            return
        new = following.motion.state(progress.at(then)).positions
        old = self.previous.state(then, lag).positions
        if np.abs(new - old).max() > options.same_distance:
            raise UnconfirmedError(
                "joint_states do not show yet whether the controller has taken the motion before "
                "this one; check that it is active, then send the goal again"
            )
