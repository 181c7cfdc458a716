# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where a robot is on a motion: by its servos, or by what the controller states of its command."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError
from ...motion.goal import JointState
from ..options import Tracking
from .measured import MeasuredSamples, Message, RobotClock
from .published_motion import PublishedMotion

_CONVERGED = 1e-12  # steps of places [s] and of the rate that are rounding


@dataclass(frozen=True, eq=False)
class Progress:
    """Place of a robot on a motion.

    Attributes
    ----------
    motion : PublishedMotion
        The motion.
    time : float
        When the robot was there [s].
    place : float
        The place [s].
    rate : float
        Rate at which the place advances: 1 for a robot on time, 0 for one that is held.
    change : float
        Rate at which the rate changes [1/s].
    error : float
        Mean distance of the newest samples from that place [rad or m].
    newest : float
        Time of the newest of the samples that it was estimated from [s].
    """

    motion: PublishedMotion
    time: float
    place: float
    rate: float = 1.0
    change: float = 0.0
    error: float = 0.0
    newest: float = -math.inf

    def at(self, time: float) -> float:
        """The place at another time [s]."""
        since = time - self.time
        if self.change < 0.0:
            # A robot that slows down stops; it does not reverse.
            since = min(since, -self.rate / self.change)
        return self.place + self.rate * since + 0.5 * self.change * since**2

    def state(self, time: float, lag: float = 0.0) -> JointState:
        """The commanded state at another time [s], for servos with this lag [s]."""
        return self.motion.state(self.at(time) + lag * self.rate)


def locate(prior: Progress, samples: MeasuredSamples, now: float) -> Progress:
    """Estimate where on a motion a robot is, from the measured positions of a short window.

    A robot under speed scaling, or one that is held, lags along its path. Then its commanded state
    follows from its place on the path, not from the clock. Place and rate are estimated together by
    regularised least squares. Where the motion is slow, positions carry little information and the
    prior dominates. While a robot is silent, it keeps its last rate: the same samples, fitted again
    and again, would lead ever farther away.

    Parameters
    ----------
    prior : Progress
        The last estimate.
    samples : MeasuredSamples
        Measured positions without the offset of the load.
    now : float
        The time that the progress is stated for [s].
    """
    motion, n = prior.motion, len(samples.times)
    known = replace(prior, time=now, place=prior.at(now))
    if n == 0 or samples.times[-1] == prior.newest:
        return known
    cost, found = _fit(samples, known, known)
    if cost > n:
        # A poor fit: the prior may be wrong, so the nearest place of the whole motion is tried,
        # too.
        places = np.linspace(0.0, motion.duration, 100)
        away = motion.sample(places)[0] - samples.positions[-1]
        nearest = float(places[np.square(away).sum(axis=1).argmin()])
        start = Progress(motion, now, nearest, known.rate)
        other_cost, other = _fit(samples, known, start)
        found = other if other_cost < cost else found
    if found.error <= Tracking.good_error or n < 4 * Tracking.n_newest:
        return found
    newer = MeasuredSamples(samples.times[-(n // 2) :], samples.positions[-(n // 2) :])
    _, other = _fit(newer, known, found)
    # Half a window carries little information on the change of the rate.
    return replace(other, change=found.change) if other.error < found.error else found


def _fit(samples: MeasuredSamples, prior: Progress, start: Progress) -> tuple[float, Progress]:
    """Gauss-Newton steps for the place, the rate and its changes; returns cost and progress."""
    motion, noise = prior.motion, Tracking.position_noise
    since = samples.times - prior.time
    powers = np.stack([np.ones_like(since), since, since**2 / 2.0, since**3 / 6.0])
    precision = np.array(Tracking.prior) ** -2.0
    known, x = (np.array([one.place, one.rate, 0.0, 0.0]) for one in (prior, start))
    best = float("inf"), start
    for _ in range(6):
        q, v, _ = motion.sample(x @ powers)
        away = samples.positions - q
        error = away / noise
        cost = float(np.square(error).sum() + precision @ (x - known) ** 2)
        if cost < best[0]:
            distance = float(np.abs(away[-Tracking.n_newest :].mean(axis=0)).max())
            place, rate, change = (float(value) for value in x[:3])
            newest = float(samples.times[-1])
            best = cost, Progress(motion, prior.time, place, rate, change, distance, newest)
        slopes = (powers[:, :, None] * v).reshape(len(x), -1) / noise
        gradient = slopes @ error.ravel() + precision * (known - x)
        try:
            step = np.linalg.solve(slopes @ slopes.T + np.diag(precision), gradient)
        except np.linalg.LinAlgError:  # times far from now: they outweigh the prior
            break
        if max(np.abs(step[:2]).max(), np.abs(step @ powers).max()) < _CONVERGED:
            break
        # A longer step than 0.2 s leaves the range in which the motion is nearly linear.
        x = x + step * min(1.0, 0.2 / max(abs(step[0]), 1e-9))
        x[:2] = np.clip(x[:2], 0.0, [np.inf, Tracking.max_rate])
    return best


class ServoModel:
    """Offset of a load and lag of the servos, learned from a robot that runs on time.

    Parameters
    ----------
    n_joints : int
        Number of joints.

    Attributes
    ----------
    load : array, shape (n_joints,)
        Measured minus commanded positions at the last rest [rad or m].
    offset : array, shape (n_joints,)
        The current offset, with the effect of accelerations [rad or m].
    lag : float
        Delay with which commands are followed [s].
    noise : float
        Noise of positions at rest [rad or m].
    """

    def __init__(self, n_joints: int) -> None:
        self.noise = 0.0
        self.load: FloatArray = np.zeros(n_joints)
        self.offset = self.load
        self.lag = Tracking.initial_lag
        # Total duration of fast motions used for learning, and shortest lag seen in one [s].
        self._experience, self._shortest = 0.0, Tracking.max_lag
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
        last = self._learned[-1][0] if self._learned else time - 0.01
        since = min(max(time - last, 0.0), Tracking.servo_time)
        share = 1.0 - np.exp(-since / Tracking.servo_time)
        self._learned.append((time, self.offset, self.lag))
        while self._learned[0][0] < time - Tracking.servo_memory:
            self._learned.popleft()
        q, v, _ = (x[0] for x in motion.sample(np.array([time - motion.began - self.lag])))
        is_new = self._experience < Tracking.servo_time
        speed, slow = float(v @ v), Tracking.slow**2
        fast = speed / (speed + slow)
        self._experience += fast * since
        gain = fast * (1.0 if is_new else Tracking.lag_share * share)
        self.lag = float(np.clip(self.lag + gain * (lag - self.lag), 0.0, self.longest_lag))
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
        if speed <= 2.0 * Tracking.slow:
            return
        self._shortest = min(self._shortest, max(lag, 0.0))
        if lag < self.lag - Tracking.lag_noise:
            self.lag = max(lag, 0.0)
            self._learned.clear()

    @property
    def longest_lag(self) -> float:
        """Largest lag of a robot that counts as on time [s]."""
        is_new = self._experience < 2.0 * Tracking.servo_time
        known = self._shortest if is_new else self.lag
        return min(known + Tracking.lag_noise, Tracking.max_lag)

    def unlearn(self) -> bool:
        """Discard the values learned last, because the robot was no longer on time."""
        if not self._learned:
            return False
        _, self.offset, self.lag = self._learned[0]
        self._learned.clear()
        return True


@dataclass(frozen=True, eq=False)
class StatedCommand:
    """The command that a controller has stated.

    Attributes
    ----------
    state : JointState
        The command; velocities and accelerations are those of its trajectory, by the clock of that.
    since : float
        Time since the start of that trajectory, by its own clock [s].
    rate : float
        Speed of that clock, 1 for that of the world.
    time : float
        When that was, by the clock of the robot [s].
    change : float
        Rate at which the rate changes [1/s].
    """

    state: JointState
    since: float
    rate: float
    time: float = 0.0
    change: float = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether a position is held."""
        return not self.state.velocities.any()

    def at(self, time: float) -> JointState:
        """The command at a time soon after [s], if its acceleration stays."""
        since = self.rate * (time - self.time)
        q, v, a = self.state.positions, self.state.velocities, self.state.accelerations
        return JointState(
            self.state.joint_names, q + v * since + 0.5 * a * since**2, v + a * since, a
        )

    def on(self, motion: PublishedMotion) -> Progress | None:
        """The place on the trajectory that was sent for a motion; None if it is not that one."""
        # What was sent begins after the last moments of the motion before, which the motion has.
        place = max(motion.time - motion.began, 0.0) + self.since
        return self._there(motion, place, self.rate)

    def near(self, guess: Progress) -> Progress | None:
        """The place on a motion near a guess, whatever was sent; None if it is off the path."""
        motion, place = guess.motion, min(max(guess.at(self.time), 0.0), guess.motion.duration)
        for _ in range(5):
            q, v, _ = (x[0] for x in motion.sample(np.array([place])))
            step = float(v @ (self.state.positions - q)) / max(float(v @ v), 1e-9)
            place = min(max(place + np.clip(step, -0.1, 0.1), 0.0), motion.duration)
        rate = 0.0 if self.at_rest else self.rate
        found = self._there(motion, float(place), rate)
        is_at_end = found is not None and place == motion.duration
        # At the end, time goes on.
        return replace(found, place=guess.at(self.time)) if found and is_at_end else found

    def _there(self, motion: PublishedMotion, place: float, rate: float) -> Progress | None:
        away = np.abs(motion.state(place).positions - self.state.positions).max()
        if away > Tracking.same_distance:
            return None
        return Progress(motion, self.time, place, rate, self.change if rate else 0.0)


Read = Callable[[Sequence[str]], StatedCommand]
"""Returns the command of some joints of a message; raises a `GoalError` if it is unusable."""


class ControllerStates:
    """The newest state of the controller.

    Parameters
    ----------
    clock : RobotClock
        The clock of motions.
    """

    def __init__(self, clock: RobotClock) -> None:
        self._clock = clock
        # One value, because threads that read do not wait for the one that receives.
        self._message: Message | None = None
        self._last: StatedCommand | None = None

    def receive(self, read: Read, stamp: float, age: float = 0.0) -> None:
        """Keep a message that a controller sent at a time by the clock of the robot [s]."""
        self._message = self._clock.message(read, age, stamp)

    @property
    def is_fresh(self) -> bool:
        """Whether a state was received lately."""
        message = self._message
        return message is not None and self._is_fresh(self._clock.time(message))

    def _is_fresh(self, time: float) -> bool:
        return abs(self._clock.now() - time) <= Tracking.max_age

    def newest(self, measured: JointState, distance: float) -> StatedCommand | None:
        """The command that was stated last.

        Parameters
        ----------
        measured : JointState
            The measured state of the joints whose command is needed.
        distance : float
            Distance from these up to which it is believed [rad or m].

        Returns
        -------
        :
            None if it is not known: none was received lately, or it is unusable.
        """
        message, last = self._message, self._last
        if message is None:
            return None
        time = self._clock.time(message)
        if not self._is_fresh(time):
            return None
        if (
            last is not None
            and last.time == time
            and last.state.joint_names == measured.joint_names
        ):
            return last
        try:
            found: StatedCommand = message.read(measured.joint_names)
        except GoalError:
            return None
        found = replace(found, time=time)
        if np.abs(found.state.positions - measured.positions).max() > distance:
            return None
        if last is not None and 0.0 < time - last.time <= Tracking.max_age:
            found = replace(found, change=(found.rate - last.rate) / (time - last.time))
        self._last = found
        return found
