# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that are ready to be published: they start where the robot is commanded to be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..motion.trajectory import Trajectory
from .published_motion import PublishedMotion, states_of

TRANSPORT = 0.02
"""Longest time that a message takes to the controller [s]."""

USUAL_TRANSPORT = 0.001
"""Usual time of a message to the next cycle of a controller on the same machine [s]."""


@dataclass(frozen=True, eq=False)
class Joined:
    """A motion that may be published at once.

    Attributes
    ----------
    trajectory : Trajectory
        What to publish: it starts where the robot is commanded to be.
    motion : PublishedMotion
        The same, preceded by the last moments of the motion that it continues.
    time : float
        When its first point is commanded [s].
    is_timed : bool
        Whether its first point belongs to that time, not to the arrival of the message.
    is_on_time : bool
        Whether that time is known precisely. It is not if the motion starts on arrival or
        continues the motion of a robot that lags.
    is_path_known : bool
        Whether the controller follows its path, not only leads to its end.
    """

    trajectory: Trajectory
    motion: PublishedMotion
    time: float
    is_timed: bool = False
    is_on_time: bool = False
    is_path_known: bool = True

    @property
    def last_point_only(self) -> bool:
        """Whether only the last point is sent, to which the controller interpolates by itself."""
        return self.trajectory.n_steps == 1 or not self.is_path_known

    @classmethod
    def on_receipt(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion that starts when the controller receives it."""
        return cls(trajectory, PublishedMotion(trajectory, time + USUAL_TRANSPORT), time)

    @classmethod
    def to_last_point(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion of which only the last point is sent."""
        return replace(cls.on_receipt(trajectory, time), is_path_known=False)

    @classmethod
    def after_wait(cls, trajectory: Trajectory, time: float) -> Joined:
        """A motion from rest that starts after a hold of its first point.

        The hold lasts as long as a message may take, so the start is known precisely. Without it,
        an error of each millisecond would be a jump where another motion continues this one.
        """
        times = np.concatenate([[0.0], trajectory.times + TRANSPORT])
        q, v, a = (np.vstack([x[:1], x]) for x in states_of(trajectory))
        efforts = trajectory.efforts
        if efforts is not None:
            efforts = np.vstack([efforts[:1], efforts])
        held = Trajectory(trajectory.joint_names, times, q, v, a, efforts)
        return cls(held, PublishedMotion(held, time), time, is_timed=True, is_on_time=True)
