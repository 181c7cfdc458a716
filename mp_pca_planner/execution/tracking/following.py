# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How a robot follows the motion that was published last."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from ...exceptions import TrajectoryError
from ...motion.goal import JointState
from ..options import Tracking
from ..parameters import Settings
from ..threads import TimedLock
from .estimation import ControllerStates, Progress, ServoModel, StatedCommand, locate
from .measured import MeasuredSamples, MeasuredStates
from .published_motion import PublishedMotion, hold

if TYPE_CHECKING:
    from ..serving.execution import Execution


class How(Enum):
    """How a robot follows a motion."""

    ON_TIME = "at its place by the clock"
    LAGGING = "moves along the path behind that place"
    HELD = "rests short of the end"
    OFF = "away from the path"


class Conclusion(Enum):
    """Which of two motions the controller has accepted."""

    TAKEN = "the newest one"
    REFUSED = "the one before"
    DOUBTFUL = "either, and they differ"
    ALIKE = "either, and they do not differ noticeably"


class UnconfirmedError(TrajectoryError):
    """The place of the robot on the motion that was published last is not known yet."""


@dataclass(frozen=True, eq=False)
class Following:
    """How a robot follows the motion that was published last.

    Attributes
    ----------
    how : How
        How the robot follows it.
    progress : Progress
        The place of its command on that motion.
    distance : float
        Largest distance of a joint from there [rad or m].
    joint : str
        The joint with that distance.
    at_rest : bool
        Whether the robot rests.
    is_path_known : bool
        See `PublishedMotion`. If not, a robot at rest may be short of the end.
    """

    how: How
    progress: Progress
    distance: float
    joint: str
    at_rest: bool
    is_path_known: bool = True

    @property
    def motion(self) -> PublishedMotion:
        """The motion."""
        return self.progress.motion

    @property
    def is_over(self) -> bool:
        """Whether the robot holds the end of the motion."""
        return self.how is How.ON_TIME and self.progress.place >= self.motion.duration

    @property
    def is_running(self) -> bool:
        """Whether the robot moves along the motion."""
        return self.how in (How.ON_TIME, How.LAGGING) and not self.is_over


@dataclass(frozen=True, eq=False)
class Observation:
    """The measured state, whether the robot rests, and its positions in the last moments."""

    state: JointState
    at_rest: bool
    samples: MeasuredSamples


@dataclass(eq=False)
class Publication:
    """The motion that was published last: what is running, for all who ask.

    Attributes
    ----------
    motion : PublishedMotion
        The motion.
    current : Progress
        The place of the robot on the motion that it follows according to the measured positions.
    previous : Progress or None
        The same if the controller has not accepted the newest motion; None once the measured
        positions confirm that.
    refused : tuple of (Progress, Progress) or None
        The last places on the newest motion and on the one before, if the robot was seen not to
        follow the newest one, whose message may still be on its way.
    unconfirmed_since : float
        Time since when the accepted motion is unknown [s].
    is_lagging, is_arrived : bool
        Whether the robot was seen to lag, or to rest at the end.
    execution : Execution or None
        Its goal and its report.
    concluded : tuple of (float, Conclusion)
        Time of the newest measured state [s] for which :meth:`confirm` came to a conclusion, and
        that.
    """

    motion: PublishedMotion
    current: Progress
    previous: Progress | None
    unconfirmed_since: float
    is_lagging: bool = False
    is_arrived: bool = False
    execution: Execution | None = None
    concluded: tuple[float, Conclusion] = (-math.inf, Conclusion.ALIKE)
    refused: tuple[Progress, Progress] | None = None

    @classmethod
    def after(
        cls,
        old: Publication | None,
        motion: PublishedMotion,
        lag: float,
        execution: Execution | None = None,
    ) -> Publication:
        """The publication that replaces another one, for servos with this lag [s]."""
        now, is_lagging = motion.time, old is not None and old.is_lagging
        rate = old.current.rate if old is not None and is_lagging else 1.0
        if old is None or motion.began >= now:
            # A robot at rest stays there if the controller does not take the motion.
            start = hold(motion.sent.joint_names, motion.sent.positions[0])
            previous = Progress(PublishedMotion(start, now), now, 0.0)
            since = now
        elif old.previous is None:
            previous, since = old.current, now
        else:
            previous, since = old.previous, old.unconfirmed_since
        current = Progress(motion, now, now - motion.began - lag * rate, rate)
        return cls(motion, current, previous, since, is_lagging, execution=execution)

    def give_up(self, *, may_be_late: bool = False) -> None:
        """Record that the controller has not accepted the motion, or that it may be late."""
        self.refused = None
        if self.previous is not None:
            self.refused = (self.current, self.previous) if may_be_late else None
            self.current, self.previous = self.previous, None
            self.is_arrived = self.is_lagging = False

    def take_late(
        self, seen: Observation, command: StatedCommand | None, servo: ServoModel
    ) -> None:
        """Record if the robot follows the newest motion after all, whose message was late.

        Parameters
        ----------
        seen : Observation
            The measured positions.
        command : StatedCommand or None
            What the controller states of its command.
        servo : ServoModel
            Offset and lag of the servos.
        """
        if self.refused is None or not len(seen.samples.times):
            return
        new, old = self.refused
        when = float(seen.samples.times[-1])
        if when > self.motion.time + Tracking.late_start:
            self.refused = None
            return
        if command is not None:
            found = command.on(self.motion)
            is_taken = found is not None and command.near(self.current) is None
        else:
            samples = seen.samples.since(self.motion.began, servo.offset)
            found = locate(new, samples, when)
            is_taken = self._conclude(found, old, seen, servo) is Conclusion.TAKEN
        if found is not None and is_taken:
            self.current, self.refused, self.is_arrived = found, None, False

    def confirm(self, found: Progress, seen: Observation, servo: ServoModel) -> Conclusion:
        """Determine from measured positions which motion the controller accepted.

        Parameters
        ----------
        found : Progress
            Place of the robot on the newest motion.
        seen : Observation
            The measured positions.
        servo : ServoModel
            Offset, lag and noise of the servos.

        Returns
        -------
        :
            The conclusion.
        """
        times, previous = seen.samples.times, self.previous
        if previous is None or not len(times):
            return Conclusion.ALIKE
        when = float(times[-1])
        if when < self.unconfirmed_since + Tracking.visible_time:
            return Conclusion.ALIKE
        if when == self.concluded[0]:  # without new states, only the error of the place grows
            return self.concluded[1]
        conclusion = self._conclude(found, previous, seen, servo)
        if conclusion is Conclusion.TAKEN:
            self.previous = None
        elif conclusion is Conclusion.REFUSED:
            self.give_up(may_be_late=True)
        else:
            self.concluded = when, conclusion
        return conclusion

    def _conclude(
        self, found: Progress, previous: Progress, seen: Observation, servo: ServoModel
    ) -> Conclusion:
        """Which motion measured positions show: see :meth:`confirm`."""
        motion, when = found.motion, float(seen.samples.times[-1])
        is_over = seen.at_rest and when >= motion.began + motion.duration
        # At rest, the accelerations that the newest offset still contains have no effect.
        offsets = np.stack([servo.offset, servo.load] if is_over else [servo.offset])
        measured = seen.samples.positions[-1] - offsets
        new, old = motion.state(found.at(when)).positions, previous.state(when).positions
        # Motions to similar goals share their path and differ in timing only, unless the robot lags
        # on either.
        due = new
        if self.motion.is_on_time and not self.is_lagging:
            due = motion.state(when - motion.began - servo.lag).positions
        to_new, to_due, to_old, between = (
            float(np.abs(x).max(axis=-1).min())
            for x in (measured - new, measured - due, measured - old, due - old)
        )
        margin = 4.0 * servo.noise
        if between >= Tracking.taken_distance + margin and max(to_new, to_due) < 0.5 * to_old:
            return Conclusion.TAKEN
        at_rest = Tracking.refused_rest_distance + margin
        refused = at_rest if seen.at_rest else Tracking.refused_distance
        # A robot that rests after both motions where the old one ends is not on this one, however
        # near they are. At its start, it may only be slow to move.
        rests_on_old = is_over and to_new >= 0.5 * at_rest and to_old < 0.1 * to_new
        # A robot that waits for a late message rests where it was, as if it had been rejected.
        is_from_rest = previous.motion.duration == 0.0
        may_be_late = is_from_rest and when < self.unconfirmed_since + Tracking.late_start
        is_on_old = rests_on_old or (to_new >= refused and to_old < 0.5 * to_new)
        if is_on_old and not may_be_late:
            return Conclusion.REFUSED
        return Conclusion.DOUBTFUL if between > Tracking.same_distance else Conclusion.ALIKE

    def is_on_time(self, on_time: Progress, found: Progress, servo: ServoModel) -> bool:
        """Whether the robot is at its place by the clock, except for the lag of its servos.

        Parameters
        ----------
        on_time, found : Progress
            The place by the clock, and that of the robot.
        servo : ServoModel
            Lag of the servos.
        """
        motion = self.motion
        places = np.array([on_time.place, found.place + servo.lag * found.rate])
        clock, path = found.motion.sample(places)[0]
        is_start = motion.is_on_time and on_time.time < motion.time + Tracking.start_time
        is_start = is_start and motion.began >= motion.time
        near = Tracking.start_distance if is_start else Tracking.on_time_distance
        is_near = bool(np.abs(clock - path).max() <= near)
        lag = abs(on_time.place - found.place)
        has_no_lag = lag <= servo.longest_lag
        has_its_rate = abs(found.rate - 1.0) <= Tracking.on_time_rate
        if not self.is_lagging:
            return is_near or (has_no_lag and has_its_rate)
        # A robot that lagged before remains late at full rate, even near the end of its motion,
        # unless a load increased the apparent lag of its servos.
        is_usual = abs(lag - servo.lag) <= Tracking.load_lag and has_its_rate
        return has_no_lag and (is_near or is_usual)

    def check_taken(self, following: Following, then: float, lag: float) -> None:
        """Check that a running motion may be continued at a later time.

        Parameters
        ----------
        following : Following
            How the robot follows the motion.
        then : float
            Time at which it is to be continued [s].
        lag : float
            Lag of the servos [s].

        Raises
        ------
        UnconfirmedError
            If something else stops the robot, or it may follow another motion.
        """
        progress = following.progress
        if following.how is How.LAGGING and progress.rate < Tracking.min_rate:
            raise UnconfirmedError(
                "the robot comes to rest short of the end of its motion; send the goal again when "
                "it is at rest"
            )
        if not self.motion.is_path_known:
            raise UnconfirmedError(
                "the robot is being stopped by a single point, so its path is not known; send the "
                "goal again when it is at rest"
            )
        if self.previous is None:
            return
        new = following.motion.state(progress.at(then)).positions
        old = self.previous.state(then, lag).positions
        if np.abs(new - old).max() > Tracking.same_distance:
            raise UnconfirmedError(
                "joint_states do not show yet whether the controller has taken the motion before "
                "this one; check that it is active, then send the goal again"
            )


class MotionFollower:
    """Tracks the motion that was published last, and how the robot follows it.

    Parameters
    ----------
    measured : MeasuredStates
        The measured states, with the clock of motions.

    Attributes
    ----------
    measured : MeasuredStates
        As given.
    controller : ControllerStates
        The states of the controller, if it publishes them.
    published : Publication or None
        The motion that was published last; None if there is none.
    servo : ServoModel
        Offset, lag and noise of the servos.
    lock : TimedLock
        Held while a motion is published, so that no thread sees half of the change.
    """

    def __init__(self, measured: MeasuredStates) -> None:
        self.measured = measured
        self.controller = ControllerStates(measured.clock)
        # Goals are served in one thread, stops and reports in another.
        self.lock = TimedLock()
        self._forget()

    def _forget(self) -> None:
        self.published: Publication | None = None
        self.servo = ServoModel(len(self.measured.joint_names))

    def expect(self, joint_names: tuple[str, ...]) -> None:
        """Set the joints whose state is needed; states and motions of others are forgotten."""
        with self.lock:
            self.measured.expect(joint_names)
            self._forget()

    def command(self, motion: PublishedMotion, execution: Execution | None = None) -> None:
        """Record that a motion was published."""
        with self.lock:
            lag = self.servo.lag
            self.published = Publication.after(self.published, motion, lag, execution)

    @property
    def execution(self) -> Execution | None:
        """The execution of the motion that was published last; None if there is none."""
        published = self.published
        return None if published is None else published.execution

    @property
    def motion_time(self) -> float:
        """The time by the clock of motions [s]; simulated time has its own rate."""
        return self.measured.clock.now()

    @property
    def commanded(self) -> Progress | None:
        """Where the robot was seen last on its motion; None if time was set back since."""
        published = self.published
        if published is None or self.motion_time < published.current.motion.began - 1.0:
            return None
        return published.current

    @property
    def alternatives(self) -> list[JointState]:
        """The commanded state if the controller has not accepted that motion; else None."""
        with self.lock:
            previous = None if self.published is None else self.published.previous
            return [] if previous is None else [previous.state(self.motion_time)]

    def stated_command(self, measured: JointState, settings: Settings) -> StatedCommand | None:
        """The command that the controller states near a measured state; None if unknown."""
        return self.controller.newest(measured, settings.commanded_tolerance)

    def follow(self, settings: Settings, measured: JointState | None = None) -> Following | None:
        """How the robot follows the motion that was published last; None if there is none.

        Parameters
        ----------
        settings : Settings
            With `state_timeout` and `commanded_tolerance`.
        measured : JointState, optional
            The newest measured state, if the caller has it.

        Raises
        ------
        GoalError
            If there is no usable measured state.
        """
        with self.lock:
            execution = self.execution
            self.measured.clock.settle(is_idle=execution is None or execution.is_reported)
            is_known = self.commanded is not None
            if measured is None:
                measured = self.measured.newest(settings.state_timeout)
            published = self.published
            if not is_known or published is None:
                return None
            at_rest = not self.measured.velocities(measured).any()
            seen = Observation(measured, at_rest, self.measured.history())
            command = self.stated_command(measured, settings)
            if not published.motion.is_path_known:
                command = None
            published.take_late(seen, command, self.servo)
            now, motion = self.motion_time, published.current.motion
            on_time = Progress(motion, now, now - motion.began)
            if command is None:
                following = self._follow(published, on_time, seen)
            else:
                following = self._follow_command(published, command, on_time, seen)
            if following is None:
                return self.follow(settings, measured)
            is_near = following.distance <= settings.commanded_tolerance
            return following if is_near else replace(following, how=How.OFF)

    def _follow(
        self, published: Publication, on_time: Progress, seen: Observation
    ) -> Following | None:
        """How the robot follows a motion; None if the motion or the servo model was wrong."""
        if published.is_arrived:
            return self._following(published, How.ON_TIME, on_time, seen)
        motion, samples = on_time.motion, seen.samples
        servo = self.servo
        window = samples.since(motion.began, servo.offset)
        found = locate(published.current, window, on_time.time)
        conclusion = published.confirm(found, seen, servo)
        if conclusion is Conclusion.REFUSED:
            return None
        published.current = found
        is_over = on_time.place >= motion.duration
        lag = on_time.place - found.place
        is_timed = published.motion.is_on_time
        is_certain = is_timed and conclusion is not Conclusion.DOUBTFUL and not is_over
        if is_certain and abs(found.rate - 1.0) <= Tracking.on_time_rate:
            speed = float(np.linalg.norm(motion.state(found.place).velocities))
            servo.limit_lag(speed, lag)
        is_late = not published.is_on_time(on_time, found, servo)
        if is_late and seen.at_rest and is_over:
            left = np.abs(motion.state(found.place).positions - motion.end).max()
            is_on_path = found.error < Tracking.beside_share * left
            # So near to the end, it may be the load, which pulls differently there.
            is_late = bool(is_on_path and left > np.abs(servo.load).max())
        if is_late and servo.unlearn():
            # The same samples are fitted once more, with another offset.
            published.current = replace(found, newest=-math.inf)
            return None
        if seen.at_rest and len(samples.positions) > 2:
            # Differences of neighbouring samples, so that the settling of the robot is not counted
            # as noise.
            steps = np.diff(samples.positions, axis=0)
            servo.noise = float(steps.std(axis=0).max()) / np.sqrt(2.0)
        published.is_lagging = is_late and not seen.at_rest
        ahead = servo.lag * found.rate - Tracking.cycle * (1.0 - found.rate)
        command = replace(found, place=found.place + ahead)
        if is_late:
            how = How.HELD if seen.at_rest else How.LAGGING
            return self._following(published, how, command, seen)
        if len(window.times) and is_certain and published.motion.is_path_known:
            servo.learn(motion, float(samples.times[-1]), seen.state.positions, lag)
        # For a motion that the controller started on receipt, the clock does not determine the
        # place.
        command = on_time if is_timed or is_over else command
        following = self._following(published, How.ON_TIME, command, seen)
        # A state from before the end of the motion is no evidence of an arrival, nor of a miss.
        is_known = following.at_rest and is_over
        return self._arrival(published, following, seen) if is_known else following

    def _follow_command(
        self,
        published: Publication,
        command: StatedCommand,
        on_time: Progress,
        seen: Observation,
    ) -> Following | None:
        """How the robot follows a motion by the command that the controller states.

        None if it has not accepted the newest motion.
        """
        servo, motion, now = self.servo, on_time.motion, on_time.time
        previous, current = published.previous, published.current
        found = command.on(motion)
        if found is not None:
            published.previous = None
        elif previous is not None and command.near(previous) is not None:
            is_from_rest = previous.motion.duration == 0.0
            late = Tracking.late_start if is_from_rest else Tracking.visible_time
            if command.time >= published.unconfirmed_since + late:
                published.give_up(may_be_late=True)
                return None
        guesses = on_time, replace(current, place=current.place + servo.lag * current.rate)
        for guess in guesses:
            found = found or command.near(guess)
        if found is None:
            # Nothing of ours is commanded, unless the message is still on its way.
            is_known = command.time >= published.unconfirmed_since + Tracking.visible_time
            how = How.OFF if is_known or previous is None else How.ON_TIME
            return self._following(published, how, on_time, seen)
        found = replace(found, time=now, place=found.at(now), rate=found.rate)
        published.current = replace(found, place=found.place - servo.lag * found.rate)
        is_full = abs(found.rate - 1.0) <= Tracking.full_rate
        is_over = found.place >= motion.duration
        lag = abs(on_time.place - found.place)
        is_late = not (is_over or (is_full and lag <= Tracking.max_lag))
        published.is_lagging = is_late and not seen.at_rest
        if is_late:
            how = How.HELD if seen.at_rest else How.LAGGING
            return self._following(published, how, found, seen)
        following = self._following(published, How.ON_TIME, found, seen)
        if not (following.at_rest and is_over) or published.is_arrived:
            return following
        return self._arrival(published, following, seen)

    def _arrival(
        self, published: Publication, following: Following, seen: Observation
    ) -> Following:
        """Record the arrival of a robot at rest after its motion, unless far from the end."""
        motion = following.motion
        away = np.abs(seen.state.positions - motion.end - self.servo.offset).max()
        is_known = following.is_path_known
        if away > (Tracking.missed_distance if is_known else Tracking.missed_stop_distance):
            return replace(following, how=How.OFF)
        published.is_arrived, published.previous = True, None
        return following

    def _following(
        self, published: Publication, how: How, progress: Progress, seen: Observation
    ) -> Following:
        motion, when = progress.motion, self.measured.newest_time
        place = progress.at(when)
        if how is How.ON_TIME and place < motion.duration:
            # The measured position lags behind the command of its own time.
            place = published.current.at(when)
        away = np.abs(seen.state.positions - motion.state(place).positions)
        worst = int(away.argmax())
        is_known = progress.place < motion.duration or when >= motion.began + motion.duration
        joint, at_rest = seen.state.joint_names[worst], is_known and seen.at_rest
        is_path_known = published.motion.is_path_known
        return Following(how, progress, float(away[worst]), joint, at_rest, is_path_known)
