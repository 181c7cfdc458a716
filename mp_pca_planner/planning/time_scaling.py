# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Laws of time scaling: durations in which motions keep limits.

With the duration T of a motion from rest to rest, velocities fall as 1/T, accelerations as 1/T²,
jerks as 1/T³, and efforts tend to those of gravity, τ(s) = g(s) + m(s)/T².
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.goal import JointState
from ..motion.interpolation import quintics
from ..motion.validation import Violation
from ..robot.limits import JointLimits
from ..robot.model import Robot

# Phases at which the minimum-jerk motion is compared with limits, those of its peaks included.
_PHASES = np.union1d(np.linspace(0.0, 1.0, 41), 0.5 + np.array([-1.0, 1.0]) / np.sqrt(12.0))
_POWERS = {"velocity": 1.0, "acceleration": 1.0 / 2.0, "jerk": 1.0 / 3.0, "effort": 1.0 / 2.0}


def slowdown(violations: Sequence[Violation]) -> float:
    """Factor of the duration that may restore the limits; 1 if none can."""
    # A longer duration does not change the path, so it can't restore position limits.
    factors = [(1.0 + v.excess) ** _POWERS[v.quantity] for v in violations if v.quantity in _POWERS]
    # Time scaling alone does not determine efforts, because they have a static part.
    return float(np.clip(1.02 * max(factors), 1.05, 2.0)) if factors else 1.0


def least_stretch(robot: Robot, limits: JointLimits, states: FloatArray) -> float:
    """Factor of the duration at which a motion from rest to rest just keeps its limits.

    Parameters
    ----------
    robot, limits
        The robot and the limits of its joints; those of position are not considered.
    states : array, shape (4, n_steps, n_joints)
        Positions, velocities, accelerations and jerks of the motion.

    Returns
    -------
    factor : float
        Infinite if gravity and friction alone exceed the limits of effort, unless the motion keeps
        them and another limit asks for a longer duration.
    """
    kinematic = kinematic_stretch(limits, states[1:])
    if not np.isfinite(limits.effort).any():
        return kinematic
    tau = robot.inverse_dynamics(*states[:3])
    if kinematic >= 1.0 and np.all(np.abs(tau) <= limits.effort):
        return kinematic
    rest, (viscous, coulomb) = np.zeros_like(states[0]), robot.drag(states[1])
    gravity = robot.inverse_dynamics(states[0], rest, rest)
    # Friction counts in full at any speed, so that it is not underestimated in shorter motions.
    static = gravity + robot.friction * np.sign(states[1])
    inertial = tau - gravity - viscous - coulomb
    if not np.all(np.abs(static) < limits.effort):
        return float("inf")
    # The least factor k with |s + d/k + m/k²| ≤ τ_max there and beyond.
    for side in (1.0, -1.0):
        room = np.maximum(limits.effort - side * static, np.finfo(float).tiny)
        half, square = side * viscous / (2.0 * room), side * inertial / room
        roots = np.sqrt(np.maximum(half**2 + square, 0.0))
        factor = np.max(np.where(half**2 + square < 0.0, 0.0, half + roots))
        kinematic = max(kinematic, float(factor))
    return kinematic


def kinematic_stretch(limits: JointLimits, rates: FloatArray) -> float:
    """Factor of the duration at which a motion just keeps its limits but those of effort.

    Parameters
    ----------
    limits : JointLimits
        Limits of the joints; those of position are not considered.
    rates : array, shape (3, n_steps, n_joints)
        Velocities, accelerations and jerks of the motion.
    """
    bounds = np.array([limits.velocity, limits.acceleration, limits.jerk])
    shares = np.max(np.abs(rates) / bounds[:, None], axis=(1, 2))
    return float(np.max(shares ** (1.0 / np.arange(1, 4))))


def shortest_durations(limits: JointLimits, start: JointState, goal: JointState) -> FloatArray:
    """Times [s], shape (n_joints,), in which no motion within the limits can be shorter.

    Between rests, with the largest acceleration up to the largest velocity, and back; from or to a
    motion, with the largest velocity alone.
    """
    distance = np.abs(goal.positions - start.positions)
    is_at_rest = not np.any([start.velocities, goal.velocities])
    acceleration = limits.acceleration if is_at_rest else np.inf
    with np.errstate(invalid="ignore", divide="ignore"):  # no distance, or no limits
        peak = np.minimum(limits.velocity, np.sqrt(distance * acceleration))
        return np.nan_to_num(distance / peak + peak / acceleration, nan=0.0)


def least_duration(robot: Robot, limits: JointLimits, start: FloatArray, goal: FloatArray) -> float:
    """Least duration [s] of the minimum-jerk motion between two configurations at rest.

    Parameters
    ----------
    robot, limits
        The robot and the limits of its joints.
    start, goal : array, shape (n_joints,)
        Positions within the limits [rad or m].

    Raises
    ------
    TrajectoryError
        If gravity and friction alone exceed the limits of effort between them.
    """
    ends = np.zeros((6, len(start)))
    ends[3] = goal - start
    states = quintics(_PHASES, ends, 3)
    states[0] += start
    duration = least_stretch(robot, limits, states)
    if duration == np.inf:
        raise TrajectoryError(
            "gravity and friction alone exceed a limit of effort on the straight path"
        )
    return duration
