# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Model of measured less commanded positions: the offset of a load and the lag of servos."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..arrays import FloatArray
from .commanded import CommandedMotion

# What is learned is kept for this time [s] until it counts: that a robot begins to lag shows late.
_DELAY = 0.35
# The offset of a load is adapted in this time [s], and the lag in so many times that, up to a
# longest one [s]. Slower than this [rad/s or m/s], an offset along the path looks like a lag.
_ADAPTATION, _LAG_SHARE, _SLOW, _LAG_NOISE = 0.2, 0.2, 0.1, 0.005
# Until it is learned: servos of arms lag by some milliseconds [s].
_USUAL_LAG = 0.002

LONGEST_LAG = 0.1
"""Largest lag of servos and messages together [s]; a robot that lags more is late."""


class ServoModel:
    """Offset of a load and lag of the servos, learned from a robot that runs on time.

    Parameters
    ----------
    n_joints : int
        Number of joints.

    Attributes
    ----------
    load : array, shape (n_joints,)
        Measured less commanded positions when the robot rested last [rad or m].
    offset : array, shape (n_joints,)
        The same of the last moments, in which servos yield to accelerations, too [rad or m].
    lag : float
        How late commands are followed [s].
    """

    def __init__(self, n_joints: int) -> None:
        self.load: FloatArray = np.zeros(n_joints)
        self.offset = self.load
        self.lag = _USUAL_LAG
        # How long a fast motion was learned from [s].
        self._experience = 0.0
        self._learned: deque[tuple[float, FloatArray, float]] = deque()

    def rest(self, offset: FloatArray) -> None:
        """Set the offset that was measured at rest."""
        self.load = self.offset = offset
        self._learned.clear()

    def learn(
        self, motion: CommandedMotion, time: float, positions: FloatArray, lag: float
    ) -> None:
        """Learn from a robot that runs on time.

        Parameters
        ----------
        motion : CommandedMotion
            What it follows.
        time : float
            When it was measured [s].
        positions : array, shape (n_joints,)
            What was measured [rad or m].
        lag : float
            How far behind the clock it was located [s].
        """
        last = self._learned[-1][0] if self._learned else time - 0.01
        since = min(max(time - last, 0.0), _ADAPTATION)
        share = 1.0 - np.exp(-since / _ADAPTATION)
        self._learned.append((time, self.offset, self.lag))
        while self._learned[0][0] < time - _DELAY:
            self._learned.popleft()
        q, v, _ = (x[0] for x in motion.sample(np.array([time - motion.began - self.lag])))
        is_new = self._experience < _ADAPTATION
        fast = float(v @ v) / (float(v @ v) + _SLOW**2)
        self._experience += fast * since
        gain = fast * (1.0 if is_new else _LAG_SHARE * share)
        self.lag = float(np.clip(self.lag + gain * (lag - self.lag), 0.0, LONGEST_LAG))
        if not is_new:
            error = positions - q - self.offset
            along = float(v @ error) / (float(v @ v) + _SLOW**2)
            self.offset = self.offset + share * (error - v * along)

    @property
    def longest_lag(self) -> float:
        """Largest lag of a robot that counts as on time [s]."""
        return LONGEST_LAG if self._experience < 2.0 * _ADAPTATION else self.lag + _LAG_NOISE

    def unlearn(self) -> bool:
        """Forget what was learned last, if anything was: the robot was no longer on time."""
        if not self._learned:
            return False
        _, self.offset, self.lag = self._learned[0]
        self._learned.clear()
        return True
