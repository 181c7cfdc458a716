# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions to show, and the clock that plays them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """A motion to show.

    Attributes
    ----------
    name : str
        What it is, for people.
    times : array, shape (n_steps,)
        Increasing times [s], the first 0.
    positions : array, shape (n_steps, n_joints)
        Joint positions [rad or m].
    """

    name: str
    times: FloatArray
    positions: FloatArray

    @classmethod
    def of(cls, name: str, trajectory: Trajectory) -> ShownMotion:
        """The motion of a trajectory."""
        return cls(name, trajectory.times, trajectory.positions)

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> FloatArray:
        """The configuration at a time [s], shape (n_joints,); held before and after the motion."""
        return np.array([np.interp(time, self.times, column) for column in self.positions.T])

    def thinned(self, n: int) -> FloatArray:
        """At most n configurations, evenly spaced in time, ends included."""
        return np.array([self.at(t) for t in np.linspace(0.0, self.duration, n)])


class Playback:
    """The clock of the shown motion.

    Attributes
    ----------
    motion : ShownMotion
        The motion.
    time : float
        Present time in the motion [s].
    speed : float
        Seconds of the motion per second.
    is_playing : bool
        Whether the clock runs. It starts again after the end, with a rest between.
    """

    REST = 0.6
    """Rest at the end of the motion before it starts again [s]."""

    def __init__(self, motion: ShownMotion) -> None:
        self.motion, self.time, self.speed, self.is_playing = motion, 0.0, 1.0, True
        self._rested = 0.0

    @property
    def configuration(self) -> FloatArray:
        """The present configuration, shape (n_joints,)."""
        return self.motion.at(self.time)

    @property
    def share(self) -> float:
        """Share of the motion that has passed, 0 to 1."""
        duration = self.motion.duration
        return min(self.time / duration, 1.0) if duration > 0.0 else 0.0

    def show(self, motion: ShownMotion) -> None:
        """Show another motion, at the same share of its duration."""
        share = self.share
        self.motion = motion
        self.time = share * motion.duration

    def seek(self, share: float) -> None:
        """Go to a share of the motion."""
        self.time, self._rested = share * self.motion.duration, 0.0

    def advance(self, elapsed: float) -> bool:
        """Let time pass [s]; returns whether the configuration may have changed."""
        if not self.is_playing:
            return False
        if self.time < self.motion.duration:
            self.time = min(self.time + self.speed * elapsed, self.motion.duration)
            self._rested = 0.0
            return True
        self._rested += elapsed
        if self._rested < self.REST:
            return False
        self.seek(0.0)
        return True
