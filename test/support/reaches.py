# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Minimum-jerk motions."""

import numpy as np
from support.arm import arm_robot

from mp_pca_planner.motion.interpolation import boundary_values, hermite_functions
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.model import Robot


def reach(robot: Robot, start: list[float], goal: list[float], duration: float) -> Trajectory:
    """Minimum-jerk motion."""
    zero = np.zeros(robot.n_joints)
    ends = boundary_values((np.array(start), zero, zero), (np.array(goal), zero, zero), duration)
    phases = np.linspace(0.0, 1.0, round(duration / 0.01) + 1)
    q, v, a = (hermite_functions(phases, d) @ ends / duration**d for d in range(3))
    return Trajectory(robot.joint_names, phases * duration, q, v, a)


def arm_reach(duration: float = 0.8) -> Trajectory:
    """Away from postures in which axes of the shoulder are parallel."""
    return reach(arm_robot(), [-0.5, -0.9, 0.9, -0.5], [-0.2, -0.4, 0.9, -0.9], duration)
