# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The measured states of the last moments, read from messages only when they are needed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names
from ..motion.goal import JointState

REST_VELOCITY = 0.01
"""Velocity up to which a robot counts as at rest [rad/s or m/s]: the noise of encoders."""

# The same of the slope of positions in the last moments, which has less noise.
_REST_SLOPE = 0.3 * REST_VELOCITY
# A reported velocity that no noise explains, whatever the positions did before [rad/s or m/s].
_CLEAR_VELOCITY = 10.0 * REST_VELOCITY
# States that are kept: as far apart as this [s], for as long.
_SPACING, _WINDOW = 0.008, 0.3
# Positions say how fast a robot moves if they span this time [s].
_SHORTEST_SPAN = 0.08
# The stamp of a state may lie so far behind its receipt, or before it, when clocks agree [s].
_OLDEST_STAMP, _NEWEST_STAMP = 0.1, 0.005

Clock = Callable[[], float]


class StateReader(Protocol):
    """Reads states from messages, which may stay serialised until they are needed."""

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        """Whether the message has all of these joints."""

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        """Read the state of these joints; a `GoalError` says what is wrong with it."""

    def stamp(self, message: bytes) -> float:
        """When the state was measured by the clock of the robot [s]; 0 if it isn't said."""


@dataclass(eq=False)
class _Sample:
    """A message, when it was received (never set back), and when that was for motions."""

    message: bytes
    received: float
    time: float
    reader: StateReader
    joint_names: tuple[str, ...]

    @cached_property
    def state(self) -> JointState:
        return self.reader.read(self.message, self.joint_names)


class MeasuredStates:
    """Keeps the states of the last moments, unread.

    Parameters
    ----------
    reader :
        Reads messages.
    receipt_clock :
        The clock of message ages [s]: never set back.
    motion_clock :
        The clock of motions [s].
    fetch :
        Called before the newest state is used: has those handed over that wait elsewhere.

    Attributes
    ----------
    n_incomplete : int
        Messages ignored because they lack a joint.
    n_unusable : int
        Messages that were refused when a goal needed them.
    """

    def __init__(
        self,
        reader: StateReader,
        receipt_clock: Clock,
        motion_clock: Clock,
        fetch: Callable[[], None] = lambda: None,
    ) -> None:
        self.n_incomplete = 0
        self.n_unusable = 0
        self._joint_names: tuple[str, ...] = ()
        self._reader = reader
        self._receipt_clock = receipt_clock
        self._motion_clock = motion_clock
        self._fetch = fetch
        # Planning reads them in a thread of its own, and gets copies.
        self._kept: deque[_Sample] = deque(maxlen=int(_WINDOW / _SPACING))
        self._newest: _Sample | None = None
        # How far stamps lie behind the receipt, by the clock of motions.
        self._delays: deque[float] = deque(maxlen=20)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints whose state is needed."""
        return self._joint_names

    def expect(self, joint_names: Sequence[str]) -> None:
        """Set the joints whose state is needed, and forget what is known of others."""
        self._joint_names = tuple(joint_names)
        self._newest = None
        self._kept.clear()

    def receive(self, message: bytes, age: float = 0.0) -> None:
        """Keep a message, unless it is of other joints, as that of a gripper's own publisher.

        Parameters
        ----------
        message : bytes
            What the reader reads.
        age : float
            How long ago it was received [s].
        """
        if not self._reader.names_all(message, self._joint_names):
            self.n_incomplete += 1
            return
        received = self._receipt_clock() - age
        time = self._motion_clock() - age
        sample = _Sample(message, received, time, self._reader, self._joint_names)
        stamp = self._reader.stamp(message)
        is_kept = not self._kept or received - self._kept[-1].received >= _SPACING
        if is_kept and stamp != 0.0:
            self._delays.append(time - stamp)
        if stamp != 0.0 and self.clocks_agree:
            sample.time = stamp
        if is_kept:
            self._kept.append(sample)
        self._newest = sample

    @property
    def age(self) -> float | None:
        """Age of the newest message [s]; None if there is none."""
        newest = self._newest
        return None if newest is None else self._receipt_clock() - newest.received

    @property
    def newest_time(self) -> float:
        """When the newest state was measured, by the clock of motions [s]; 0 if there is none."""
        newest = self._newest
        return 0.0 if newest is None else newest.time

    @property
    def clocks_agree(self) -> bool:
        """Whether nothing shows that the clock of the robot is another one than that of motions."""
        delays = list(self._delays)
        return not delays or -_NEWEST_STAMP <= min(delays) <= _OLDEST_STAMP

    @property
    def clock_difference(self) -> float:
        """How far stamps lie behind the clock of motions [s]."""
        return min(list(self._delays), default=0.0)

    def newest(self, timeout: float) -> JointState:
        """The newest state, or a refusal.

        Parameters
        ----------
        timeout : float
            Age at which a message is too old [s]; 0: never.

        Raises
        ------
        GoalError
            If there is none, or it is too old or unusable.
        """
        self._fetch()
        newest = self._newest
        if newest is None:
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(self._joint_names)} has arrived{ignored}"
            )
        age = self._receipt_clock() - newest.received
        if 0.0 < timeout < age:
            raise GoalError(
                f"the present state is not known: the newest joint_states message is {age:.3g} s "
                f"old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        try:
            return newest.state
        except GoalError:
            self.n_unusable += 1
            raise

    def history(self) -> tuple[FloatArray, FloatArray]:
        """When the robot was where in the last moments.

        Returns
        -------
        times : array, shape (n_samples,)
            Times on the clock of motions [s], the newest last; none if nothing is usable.
        positions : array, shape (n_samples, n_joints)
            Positions [rad or m].
        """
        samples, last = list(self._kept), self._newest
        if last is not None and samples and last is not samples[-1]:
            samples.append(last)
        times, positions = [], []
        for sample in samples:
            if last is None or last.received - sample.received > _WINDOW:
                continue
            try:
                positions.append(sample.state.positions)
            except GoalError:
                continue
            times.append(sample.time)
        return np.array(times), np.reshape(positions, (-1, len(self._joint_names)))

    def velocities(self, state: JointState) -> FloatArray:
        """How fast the robot moves [rad/s or m/s], shape (n_joints,); exactly 0 where it rests.

        Positions of the last moments say it, since reported velocities are noisy, and many
        robots report none.
        """
        times, positions = self.history()
        v = np.array(state.velocities)
        clear = np.abs(v) > _CLEAR_VELOCITY
        if len(times) > 2 and times[-1] - times[0] >= _SHORTEST_SPAN:
            since = times - times.mean()
            slope = since @ positions / (since @ since)
            moving = np.abs(slope) > _REST_SLOPE
            if moving.any():
                # How fast a robot is now that slows down, a mean over all that time does not say.
                newest = times >= times[-1] - _SHORTEST_SPAN
                now = np.linalg.pinv(np.vander(times[newest] - times[-1], 3))[1] @ positions[newest]
                slope = np.where(moving, now, 0.0)
            return np.where(clear, v, np.where(moving, slope, 0.0))
        return np.where(np.abs(v) <= REST_VELOCITY, 0.0, v)
