# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Poses at the ends of segments, as equations of their unknowns."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ...motion.goal import Pose
from ...robot.model import Robot
from .tables import Tables
from .unknowns import Unknowns, all_states


class PoseTarget:
    """The equations of a pose at the goal of a segment whose goal positions are unknowns.

    Parameters
    ----------
    robot : Robot
        The model.
    tables : Tables
        The basis of the segment.
    unknowns : Unknowns
        Its unknowns.
    pose : Pose
        The frame and its pose.
    """

    def __init__(self, robot: Robot, tables: Tables, unknowns: Unknowns, pose: Pose) -> None:
        self._robot, self._pose = robot, pose
        self._goal = all_states(unknowns, tables.hermite[:1, -1:], tables.values[:1, -1:])

    def errors(self, x: FloatArray) -> FloatArray:
        """Distance [m] and, with an orientation, rotation vector [rad]."""
        return pose_error(self._robot, self._pose, self._goal.values(x)[:, 0])[0]

    def equations(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same with the derivatives by the unknowns, shape (n_errors, n_unknowns)."""
        q = self._goal.values(x)
        error, by_position = pose_error(self._robot, self._pose, q[:, 0])
        return error, np.asarray(by_position @ self._goal.jacobian(x, q))


def pose_error(robot: Robot, pose: Pose, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of a pose at one configuration, and their derivatives, see `Robot.pose_error`."""
    return robot.pose_error(pose.frame, q, pose.position, pose.orientation)
