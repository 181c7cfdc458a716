# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How a robot follows the motion that was published last."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.goal import JointState
from .commanded import CommandedMotion
from .joined import Joined
from .measured import Clock, MeasuredStates, StateReader
from .servo import ServoModel
from .stopping import hold
from .tracking import Progress, locate

ON_TIME, LAGGING, HELD, OFF = "on_time", "lagging", "held", "off"
"""A robot runs on time, moves behind its place by the clock, rests short of the end of its motion,
or is away from its path."""

# The cycle of a controller, by which its commands are ahead whatever their speed [s].
_CYCLE = 0.001
# A robot is on time where that moves its commanded positions by less [rad or m], or at this rate
# and lag [s], which servos and messages account for.
_SAME_POSITION, _RATE_TOLERANCE = 5e-4, 0.07
# The same in the first moments of a motion from rest.
_SAME_AT_FIRST = 0.002
# From so much difference on it is seen that a robot follows the newer of two motions, that it
# follows the older, and that it rests at the end of the older, but for noise; up to so much it does
# not matter [rad or m].
_CONFIRMED, _DIFFERENCE, _RESTS, _NO_JUMP = 0.0015, 0.006, 4e-4, 1.5e-4
# A load that is not known yet looks like so much more or less lag of the servos [s].
_LAG_OF_LOAD = 0.003
# To continue a motion, states may be this old [s], this far from where a lagging robot is
# estimated to be [rad or m] but for their noise, and its rate may change so fast [1/s].
_FRESH, _PRECISE, _STEADY = 0.1, 1e-4, 0.5
# A robot at rest so far from the end of its motion is elsewhere, whatever its load [rad or m].
_MISSED = 0.02
# A robot that rests short of the end of its motion is beside its path by less than this share of
# the way that is left; a load that is not known yet pulls it away from the end in any direction.
_BESIDE = 0.15
# A robot that is slower than this share of its motion's speed has been stopped by something else.
_SLOWEST = 0.05
# A robot that begins to move is seen to do so by then [s].
_BEGINNING = 0.5
# What was measured shows a motion so long after it was published [s].
_VISIBLE = 0.05


class UnconfirmedError(TrajectoryError):
    """It is not known yet where the robot is on the motion that was published last."""


@dataclass(frozen=True, eq=False)
class Following:
    """How a robot follows the motion that was published last.

    Attributes
    ----------
    motion : CommandedMotion
        That motion.
    how : {'on_time', 'lagging', 'held', 'off'}
        Whether it does.
    progress : Progress
        Where its command is.
    distance : float
        How far the farthest joint is from there [rad or m].
    joint : str
        Which joint that is.
    at_rest : bool
        Whether the robot rests.
    """

    motion: CommandedMotion
    how: str
    progress: Progress
    distance: float
    joint: str
    at_rest: bool

    @property
    def is_over(self) -> bool:
        """Whether the robot holds the end of the motion."""
        return self.how == ON_TIME and self.progress.place >= self.motion.duration

    @property
    def is_running(self) -> bool:
        """Whether the robot moves along the motion."""
        return self.how in (ON_TIME, LAGGING) and not self.is_over


class MotionFollower:
    """Knows the motion that was published last, and how the robot follows it.

    Parameters
    ----------
    reader, receipt_clock, motion_clock, fetch :
        See `MeasuredStates`.

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
    ) -> None:
        self.measured = MeasuredStates(reader, receipt_clock, motion_clock, fetch)
        self._motion_clock = motion_clock
        # Goals are served in one thread, stops and reports in another.
        self._lock = threading.RLock()
        self._commanded: CommandedMotion | None
        self._progress: Progress
        # What the robot does if the controller has not taken the commanded motion; none once it is
        # seen that it has.
        self._previous: CommandedMotion | None
        self._previous_progress: Progress
        self._servo: ServoModel
        self._unconfirmed_since: float
        self._commanded_since: float
        # That of positions at rest [rad or m].
        self._noise: float
        self._is_path_known: bool
        self._is_timed: bool
        self._is_lagging: bool
        self._is_arrived: bool
        # Whether that motion continues another one.
        self._is_joined: bool
        # Whether the robot may follow the motion before, elsewhere than on this one.
        self._is_doubtful: bool
        self._forget()

    def expect(self, joint_names: tuple[str, ...]) -> None:
        """Set the joints whose state is needed; what is known of other joints is forgotten."""
        if self.measured.joint_names != tuple(joint_names):
            with self._lock:
                self.measured.expect(joint_names)
                self._forget()

    def command(self, joined: Joined) -> CommandedMotion:
        """Note that a motion was published."""
        with self._lock:
            rate = self._progress.rate if self._is_lagging else 1.0
            if joined.motion.began >= joined.time or self._commanded is None:
                # A robot at rest stays there if the controller does not take the motion.
                start = hold(joined.trajectory.joint_names, joined.trajectory.positions[0])
                self._previous = CommandedMotion(start, joined.time)
                self._previous_progress = Progress(joined.time, 0.0)
                self._unconfirmed_since = joined.time
            elif self._previous is None:
                self._previous, self._previous_progress = self._commanded, self._progress
                self._unconfirmed_since = joined.time
            self._commanded, self._is_arrived = joined.motion, False
            self._commanded_since = joined.time
            self._is_joined = joined.motion.began < joined.time
            self._is_path_known, self._is_timed = joined.is_path_known, joined.is_on_time
            place = joined.time - joined.motion.began - self._servo.lag * rate
            self._progress = Progress(joined.time, place, rate)
        return joined.motion

    @property
    def motion_time(self) -> float:
        """The time by the clock of motions [s]; simulated time goes at its own rate."""
        return self._motion_clock()

    @property
    def commanded(self) -> CommandedMotion | None:
        """The motion that was published last, unless time was set back since."""
        motion = self._commanded
        return None if motion is None or self._motion_clock() < motion.began - 1.0 else motion

    @property
    def last_place(self) -> float:
        """Where on that motion the robot was when it was heard of last [s]."""
        return self._progress.place

    @property
    def load_offset(self) -> FloatArray:
        """What a load pulls the robot away from where it is commanded to be [rad or m]."""
        return self._servo.load

    @property
    def alternatives(self) -> list[JointState]:
        """Where the robot is commanded to be if the controller has not taken that motion."""
        with self._lock:
            previous, progress = self._previous, self._previous_progress
            return [previous.state(progress.at(self._motion_clock()))] if previous else []

    def follow(self, timeout: float, tolerance: float) -> Following | None:
        """How the robot follows the motion that was published last; None if there is none.

        Parameters
        ----------
        timeout : float
            Age at which a measured state is too old [s]; 0: never.
        tolerance : float
            How far from its motion a robot still follows it [rad or m].

        Raises
        ------
        GoalError
            If there is no usable measured state.
        """
        with self._lock:
            motion = self.commanded
            measured = self.measured.newest(timeout)
            if motion is None:
                return None
            now = self._motion_clock()
            on_time = Progress(now, now - motion.began)
            at_rest = not self.measured.velocities(measured).any()
            if self._is_arrived:
                return self._following(motion, ON_TIME, on_time, measured, tolerance, at_rest)
            times, positions = self.measured.history()
            known = times >= motion.began
            found = locate(
                motion, times[known], positions[known] - self._servo.offset, self._progress, now
            )
            if self._was_refused(motion, found, times, positions, at_rest):
                return self.follow(timeout, tolerance)
            self._progress = found
            is_late = not self._is_on_time(motion, on_time, found)
            is_over = on_time.place >= motion.duration
            if is_late and at_rest and is_over:
                left = np.abs(motion.state(found.place).positions - motion.end).max()
                is_late = found.error < _BESIDE * left
            if is_late and self._servo.unlearn():
                return self.follow(timeout, tolerance)
            if at_rest and len(positions) > 2:
                # By differences of neighbours: a robot that still settles is not noise.
                self._noise = float(np.diff(positions, axis=0).std(axis=0).max()) / np.sqrt(2.0)
            self._is_lagging = is_late and not at_rest
            ahead = self._servo.lag * found.rate - _CYCLE * (1.0 - found.rate)
            command = replace(found, place=found.place + ahead)
            if is_late:
                how = HELD if at_rest else LAGGING
                return self._following(motion, how, command, measured, tolerance, at_rest)
            is_sure = self._is_path_known and self._is_timed and not self._is_doubtful
            if known.any() and is_sure and not is_over:
                lag = on_time.place - found.place
                self._servo.learn(motion, float(times[-1]), measured.positions, lag)
            # When a motion began that a controller started on receipt is not known by the clock.
            progress = on_time if self._is_timed or is_over else command
            seen = self._following(motion, ON_TIME, progress, measured, tolerance, at_rest)
            return self._arrival(seen, measured) if at_rest and is_over else seen

    def _arrival(self, following: Following, measured: JointState) -> Following:
        """Note that a robot that rests after a motion has arrived, or see that it has not."""
        motion = following.motion
        if np.abs(measured.positions - motion.end - self._servo.offset).max() > _MISSED:
            return replace(following, how=OFF)
        # That it rested before the end of the motion says nothing of after it.
        self._is_arrived = self.measured.newest_time >= motion.began + motion.duration
        if self._is_arrived:
            self._previous = None
        return following

    def _forget(self) -> None:
        self._commanded = self._previous = None
        self._progress = self._previous_progress = Progress(0.0, 0.0)
        self._servo = ServoModel(len(self.measured.joint_names))
        self._is_lagging = self._is_arrived = self._is_doubtful = self._is_joined = False
        self._unconfirmed_since = self._commanded_since = 0.0
        self._is_path_known = self._is_timed = True
        self._noise = 0.0

    def _following(
        self,
        motion: CommandedMotion,
        how: str,
        progress: Progress,
        measured: JointState,
        tolerance: float,
        at_rest: bool,
    ) -> Following:
        # A robot on time is measured where its servos and the messages of its state leave it.
        # What is measured lags behind the command of its own moment.
        when = self.measured.newest_time
        place = progress.at(when)
        if how == ON_TIME and place < motion.duration:
            place = self._progress.at(when)
        away = np.abs(measured.positions - motion.state(place).positions)
        worst = int(away.argmax())
        how = how if away[worst] <= tolerance else OFF
        is_known = progress.place < motion.duration or when >= motion.began + motion.duration
        joint = measured.joint_names[worst]
        return Following(motion, how, progress, float(away[worst]), joint, is_known and at_rest)

    def _is_on_time(self, motion: CommandedMotion, on_time: Progress, found: Progress) -> bool:
        places = np.array([on_time.place, found.place + self._servo.lag * found.rate])
        clock, path = motion.sample(places)[0]
        # Where a motion begins, it is so slow that any error of the servos looks like a lag.
        begins = self._is_timed and on_time.time < self._commanded_since + _BEGINNING
        begins = begins and not self._is_joined
        is_near = np.abs(clock - path).max() <= (_SAME_AT_FIRST if begins else _SAME_POSITION)
        lag = abs(on_time.place - found.place)
        has_no_lag = lag <= self._servo.longest_lag
        has_its_rate = abs(found.rate - 1.0) <= _RATE_TOLERANCE
        # A robot that has lagged, and moves at the rate of the clock again, is late still, though
        # it may be near where the motion ends: unless a load made a servo's lag look longer.
        if self._is_lagging:
            is_usual = abs(lag - self._servo.lag) <= _LAG_OF_LOAD and has_its_rate
            return bool(has_no_lag and (is_near or is_usual))
        return bool(is_near or (has_no_lag and has_its_rate))

    def give_up(self) -> None:
        """Note that the controller has not taken the motion that was published last."""
        with self._lock:
            if self._previous is None:
                return
            self._commanded, self._previous = self._previous, None
            self._progress = self._previous_progress
            self._is_arrived = self._is_lagging = False

    def _was_refused(
        self,
        motion: CommandedMotion,
        found: Progress,
        times: FloatArray,
        positions: FloatArray,
        at_rest: bool,
    ) -> bool:
        """See which motion the robot follows, where the newest and the one before differ enough."""
        self._is_doubtful = False
        if self._previous is None or not len(times):
            return False
        when = float(times[-1])
        if when < self._unconfirmed_since + _VISIBLE:
            return False
        measured = positions[-1] - self._servo.offset
        new = motion.state(found.at(when)).positions
        old = self._previous.state(self._previous_progress.at(when)).positions
        # Motions to goals that changed a little share their path: then they differ by their timing,
        # unless the robot is late on either.
        due = new
        if self._is_timed and not self._is_lagging:
            due = motion.state(when - motion.began - self._servo.lag).positions
        to_new, to_due, to_old, between = (
            float(np.abs(x).max())
            for x in (measured - new, measured - due, measured - old, due - old)
        )
        # What is learned from the wrong motion would hide that it is the wrong one.
        self._is_doubtful = between > _NO_JUMP
        noise = 4.0 * self._noise
        if between >= _CONFIRMED + noise and max(to_new, to_due) < 0.5 * to_old:
            self._previous, self._is_doubtful = None, False
        elif to_new >= (_RESTS + noise if at_rest else _DIFFERENCE) and to_old < 0.5 * to_new:
            self.give_up()
            return True
        return False

    def _check_known(self, following: Following, now: float) -> None:
        """Refuse to continue a motion if it is not known precisely where on it the robot is."""
        age = now - self.measured.newest_time
        if age > _FRESH:
            raise UnconfirmedError(
                f"the newest joint_states message is {age:.3g} s old, at most {_FRESH:g} s is "
                "accepted while the robot moves; send the goal again"
            )
        progress = following.progress
        is_steady = progress.error <= _PRECISE + self._noise and abs(progress.change) <= _STEADY
        if following.how == LAGGING and not is_steady:
            raise UnconfirmedError(
                "the speed of the robot changes (speed scaling), so its place on the motion is not "
                "known precisely; send the goal again"
            )

    def _check_resting(self, following: Following, now: float) -> None:
        """Refuse to start where a robot rests that may just begin to move."""
        if following.how == HELD and now < self._commanded_since + _BEGINNING:
            raise UnconfirmedError(
                "the robot rests at the start of the motion before this one, which was published "
                f"less than {_BEGINNING:g} s ago; send the goal again"
            )

    def _check_confirmed(self, following: Following, then: float) -> None:
        """Refuse to continue a motion that may not be the one that is executed."""
        if following.how == LAGGING and following.progress.rate < _SLOWEST:
            raise UnconfirmedError(
                "the robot comes to rest short of the end of its motion; send the goal again when "
                "it is at rest"
            )
        if not self._is_path_known:
            raise UnconfirmedError(
                "the robot is being stopped by a single point, so its path is not known; send the "
                "goal again when it is at rest"
            )
        if self._previous is None:
            return
        before = self._previous_progress
        new = following.motion.state(following.progress.at(then)).positions
        old = self._previous.state(before.at(then) + self._servo.lag * before.rate).positions
        if np.abs(new - old).max() > _NO_JUMP:
            raise UnconfirmedError(
                "joint_states do not show yet whether the controller has taken the motion before "
                "this one; check that it is active, then send the goal again"
            )
