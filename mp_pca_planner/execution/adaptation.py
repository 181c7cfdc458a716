# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Online goal adaptation: a running motion plus a smooth displacement of its end.

The displacement is the minimum-jerk polynomial from 0 to the change of the goal. Dynamic movement
primitives adapt to changed goals likewise. Goals that repeat or drift are reached, whatever their
rate, since no motion begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..motion.interpolation import hermite_functions
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..planning.plan import SOLVED
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .commanded import CommandedMotion

# Shortest displacement [s], and how much longer each next one is that is tried.
_SHORTEST, _GROWTH, _N_TRIED = 0.25, 1.25, 7
# The greatest velocity, acceleration and jerk of the minimum-jerk polynomial from 0 to 1 in a unit
# of time, and the orders of time that they fall with.
_PEAKS = ((1.875, 1), (5.7735, 2), (60.0, 3))


@dataclass(frozen=True, eq=False)
class AdaptedPlan:
    """A displaced motion within the limits, in place of a planned one.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, with its efforts.
    limit_check : LimitCheck
        That it keeps the limits.
    primitive : str
        Name of the primitive of the motion that was displaced.
    in_span_score : float
        That of the motion that was displaced.
    message : str
        One sentence for a person.
    solve_time : float
        Time taken to find it [s].
    """

    trajectory: Trajectory
    limit_check: LimitCheck
    primitive: str
    in_span_score: float
    message: str
    solve_time: float
    status: str = SOLVED
    is_executable: bool = True

    @property
    def effort_cost(self) -> float:
        """J = ½∫‖τ‖²dt [N²·m²·s]."""
        return effort_cost(self.trajectory)

    def summary(self) -> dict[str, str | float | int]:
        """Scalar facts, by the names of the package's public interface."""
        return {
            "status": self.status,
            "message": self.message,
            "primitive": self.primitive,
            "duration": self.trajectory.duration,
            "effort_cost": self.effort_cost,
            "solve_time_s": self.solve_time,
            "iterations": 0,
            "in_span_score": self.in_span_score,
            "limit_violation": self.limit_check.worst_excess,
            "start_error": 0.0,
            "goal_error": 0.0,
        }


def effort_cost(trajectory: Trajectory) -> float:
    """J = ½∫‖τ‖²dt of a trajectory with efforts [N²·m²·s], by the trapezoidal rule."""
    assert trajectory.efforts is not None
    power = np.square(trajectory.efforts).sum(axis=1)
    return float(0.25 * np.diff(trajectory.times) @ (power[1:] + power[:-1]))


def displaced(
    motion: CommandedMotion,
    place: float,
    goal: JointState,
    robot: Robot,
    limits: JointLimits,
    period: float,
) -> tuple[Trajectory, LimitCheck] | None:
    """Displace a motion to another end, within the limits and no sooner than it ends.

    Parameters
    ----------
    motion : CommandedMotion
        The motion.
    place : float
        Where on it the displacement begins [s].
    goal : JointState
        The new end, with its velocities; of the joints of the motion.
    robot, limits :
        Of the same joints.
    period : float
        Longest time between points [s].

    Returns
    -------
    trajectory, check :
        The motion from the place on with its efforts, and that it keeps the limits; None if no
        displacement does.
    """
    change = goal.positions - motion.end
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    needed = [
        float(np.max(peak * np.abs(change) / bound)) ** (1.0 / order)
        for (peak, order), bound in zip(_PEAKS, bounds, strict=True)
    ]
    duration = max(motion.duration - place, _SHORTEST, *needed)
    for _ in range(_N_TRIED):
        trajectory = _add(motion, place, goal, duration, period)
        check = check_limits(trajectory, robot, limits)
        if not check.violations:
            columns = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
            efforts = robot.inverse_dynamics(*columns)
            names = trajectory.joint_names
            return Trajectory(names, trajectory.times, *columns, efforts), check
        duration *= _GROWTH
    return None


def _add(
    motion: CommandedMotion, place: float, goal: JointState, duration: float, period: float
) -> Trajectory:
    n_steps = max(int(np.ceil(duration / period)), 5)
    times = np.linspace(0.0, duration, n_steps + 1)
    boundary = _boundary(motion, goal, duration)
    sums = [
        x + hermite_functions(times / duration, d) @ boundary / duration**d
        for d, x in enumerate(motion.sample(place + times))
    ]
    for x, end in zip(sums, (goal.positions, goal.velocities, goal.accelerations), strict=True):
        x[-1] = end
    return Trajectory(motion.trajectory.joint_names, times, *sums)


def _boundary(motion: CommandedMotion, goal: JointState, duration: float) -> FloatArray:
    """The change at both ends by phase, shape (6, n_joints): none at the first."""
    last = motion.state(motion.duration)
    change = [
        (new - old) * duration**d
        for d, (new, old) in enumerate(
            (
                (goal.positions, last.positions),
                (goal.velocities, last.velocities),
                (goal.accelerations, last.accelerations),
            )
        )
    ]
    return np.vstack([np.zeros((3, len(last.positions))), change])
