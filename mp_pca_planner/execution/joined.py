# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions as they are sent to a controller: from where the robot is commanded to be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from .commanded import CommandedMotion

TRANSPORT = 0.02
"""Time that a message takes to the controller at most [s]."""

USUAL_TRANSPORT = 0.001
"""Time that it usually takes to the next cycle of a controller on the same machine [s]."""


@dataclass(frozen=True, eq=False)
class Joined:
    """A motion that may be published at once.

    Attributes
    ----------
    trajectory : Trajectory
        What to publish: from where the robot is commanded to be.
    motion : CommandedMotion
        The same with the last moments before it.
    time : float
        When its first point is commanded [s].
    is_timed : bool
        Whether its first point belongs to that time, not to the moment at which a controller
        receives it.
    is_on_time : bool
        Whether that time is known precisely: not where it continues the motion of a robot that
        lags, or starts on receipt.
    is_path_known : bool
        Whether the controller leads along it, not just to its end.
    """

    trajectory: Trajectory
    motion: CommandedMotion
    time: float
    is_timed: bool = False
    is_on_time: bool = False
    is_path_known: bool = True

    @classmethod
    def on_receipt(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion that starts when the controller receives it."""
        return cls(trajectory, CommandedMotion(trajectory, time + USUAL_TRANSPORT), time)

    @classmethod
    def to_last_point(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion of which only the last point is sent."""
        return replace(cls.on_receipt(trajectory, time), is_path_known=False)

    @classmethod
    def after_wait(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion from rest that starts after a time in which any message is received.

        When a motion begins that the controller starts on receipt is not known to milliseconds,
        and each of them is a jump where another motion continues it.
        """
        waiting = _after_wait(trajectory)
        return cls(waiting, CommandedMotion(waiting, time), time, True, True)


def _after_wait(trajectory: Trajectory) -> Trajectory:
    """The trajectory after a hold of its first point."""

    def with_first(x: FloatArray) -> FloatArray:
        return np.concatenate([x[:1], x])

    return Trajectory(
        trajectory.joint_names,
        np.concatenate([[0.0], trajectory.times + TRANSPORT]),
        with_first(trajectory.positions),
        with_first(trajectory.velocities),
        with_first(trajectory.accelerations),
        None if trajectory.efforts is None else with_first(trajectory.efforts),
    )
