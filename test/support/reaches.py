# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Minimum-jerk motions."""

from support.arm import arm_robot
from support.dense import minimum_jerk_motion

from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.model import Robot


def reach(robot: Robot, start: list[float], goal: list[float], duration: float) -> Trajectory:
    """Minimum-jerk motion."""
    n = round(duration / 0.01) + 1
    return minimum_jerk_motion(robot.joint_names, start, goal, duration, n)


def arm_reach(duration: float = 0.8) -> Trajectory:
    """Away from postures in which axes of the shoulder are parallel."""
    return reach(arm_robot(), [-0.5, -0.9, 0.9, -0.5], [-0.2, -0.4, 0.9, -0.9], duration)
