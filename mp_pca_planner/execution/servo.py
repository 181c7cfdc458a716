# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Model of measured minus commanded positions: the offset of a load and the lag of servos."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..arrays import FloatArray
from .options import FollowingOptions
from .published_motion import PublishedMotion


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
