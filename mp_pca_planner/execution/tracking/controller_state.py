# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the controller states of its own command.

Where it is known, the place of the command on a motion is read from it, not estimated from measured
positions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError
from ...motion.goal import JointState
from ..options import FollowingOptions
from .estimation import Progress
from .published_motion import PublishedMotion
from .state_sources import Receipt, RobotClock


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

    def on(self, motion: PublishedMotion, options: FollowingOptions) -> Progress | None:
        """The place on the trajectory that was sent for a motion; None if it is not that one."""
        # What was sent begins after the last moments of the motion before, which the motion has.
        place = max(motion.time - motion.began, 0.0) + self.since
        return self._there(motion, place, self.rate, options)

    def near(self, guess: Progress, options: FollowingOptions) -> Progress | None:
        """The place on a motion near a guess, whatever was sent; None if it is off the path."""
        motion, place = guess.motion, min(max(guess.at(self.time), 0.0), guess.motion.duration)
        for _ in range(5):
            q, v, _ = (x[0] for x in motion.sample(np.array([place])))
            step = float(v @ (self.state.positions - q)) / max(float(v @ v), 1e-9)
            place = min(max(place + np.clip(step, -0.1, 0.1), 0.0), motion.duration)
        rate = 0.0 if self.at_rest else self.rate
        found = self._there(motion, float(place), rate, options)
        is_at_end = found is not None and place == motion.duration
        # At the end, time goes on.
        return replace(found, place=guess.at(self.time)) if found and is_at_end else found

    def _there(
        self, motion: PublishedMotion, place: float, rate: float, options: FollowingOptions
    ) -> Progress | None:
        away = np.abs(motion.state(place).positions - self.state.positions).max()
        if away > options.same_distance:
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
    options : FollowingOptions
        With the age up to which a state counts.
    """

    def __init__(self, clock: RobotClock, options: FollowingOptions) -> None:
        self._clock, self._options = clock, options
        # One value, because threads that read do not wait for the one that receives.
        self._message: tuple[Read, Receipt] | None = None
        self._last: StatedCommand | None = None

    def receive(self, read: Read, stamp: float, age: float = 0.0) -> None:
        """Keep a message that a controller sent at a time by the clock of the robot [s]."""
        self._message = read, self._clock.receipt(age, stamp)

    @property
    def is_fresh(self) -> bool:
        """Whether a state was received lately."""
        message = self._message
        return message is not None and self._is_fresh(self._clock.time(message[1]))

    def _is_fresh(self, time: float) -> bool:
        return abs(self._clock.now() - time) <= self._options.max_age

    def newest(
        self, joint_names: Sequence[str], measured: FloatArray, distance: float
    ) -> StatedCommand | None:
        """The command that was stated last.

        Parameters
        ----------
        joint_names : sequence of str
            Joints whose command is needed.
        measured : array, shape (n_joints,)
            Their measured positions [rad or m].
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
        read, time = message[0], self._clock.time(message[1])
        if not self._is_fresh(time):
            return None
        if last is not None and last.time == time and last.state.joint_names == (*joint_names,):
            return last
        try:
            found = replace(read(joint_names), time=time)
        except GoalError:
            return None
        if np.abs(found.state.positions - measured).max() > distance:
            return None
        if last is not None and 0.0 < time - last.time <= self._options.max_age:
            found = replace(found, change=(found.rate - last.rate) / (time - last.time))
        self._last = found
        return found
