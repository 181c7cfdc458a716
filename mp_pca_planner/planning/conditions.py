# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Targets of positions at a phase: a pose at the end, configurations and poses before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.goal import Pose
from ..robot.model import Robot


class Target(Protocol):
    """A target, as equations of the joint positions."""

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, shape (m,), and their derivatives by q, shape (m, n_joints)."""


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """The condition that a frame is at a pose.

    Attributes
    ----------
    robot : Robot
        The model.
    pose : Pose
        The frame and its pose.
    """

    robot: Robot
    pose: Pose

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance [m] and, with an orientation, rotation vector [rad]."""
        return self.robot.pose_error(self.pose.frame, q, self.pose.position, self.pose.orientation)


@dataclass(frozen=True, eq=False)
class JointTarget:
    """The condition that some joints are at given positions.

    Attributes
    ----------
    index : array, shape (m,)
        Indices of the joints.
    positions : array, shape (m,)
        Their positions [rad or m].
    n_joints : int
        Number of joints of the robot.
    """

    index: NDArray[np.intp]
    positions: FloatArray
    n_joints: int

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The differences of the positions."""
        return q[self.index] - self.positions, np.eye(self.n_joints)[self.index]


@dataclass(frozen=True, eq=False)
class Condition:
    """A target and its phase.

    Attributes
    ----------
    target : Target
        What to reach.
    phase : float or None
        Phase of the target; None: any phase within the `window`.
    window : (float, float)
        Phases between which a free one is searched.
    """

    target: Target
    phase: float | None
    window: tuple[float, float] = (0.0, 1.0)

    def phase_at(self, place: float) -> tuple[float, float]:
        """The phase within the window for an unbounded place, and its derivative by the place."""
        if self.phase is not None:
            return self.phase, 0.0
        low, high = self.window
        share = 0.5 * (1.0 + np.tanh(0.5 * place))
        return low + (high - low) * share, (high - low) * share * (1.0 - share)
