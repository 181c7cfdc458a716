# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Online goal adaptation: a running motion plus a smooth displacement of its end.

The displacement is the minimum-jerk polynomial from 0 to the change of the goal, similar to how
dynamic movement primitives adapt to changed goals. No motion starts anew, so goals that repeat or
drift are reached at any rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..motion.goal import JointState
from ..motion.interpolation import hermite_functions
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..planning.plan import SOLVED
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .published_motion import PublishedMotion


@dataclass(frozen=True, eq=False)
class AdaptedPlan:
    """A displaced motion within the limits, in place of a planned one.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, with its efforts.
    limit_check : LimitCheck
        Its comparison with the limits.
    primitive : str
        Name of the primitive of the motion that was displaced.
    in_span_score : float
        In-span score of the motion that was displaced.
    solve_time : float
        Time taken to find it [s].
    """

    trajectory: Trajectory
    limit_check: LimitCheck
    primitive: str
    in_span_score: float
    solve_time: float
    status: ClassVar[str] = SOLVED
    message: ClassVar[str] = "the motion is continued to the new goal"

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
    motion: PublishedMotion,
    place: float,
    goal: JointState,
    robot: Robot,
    limits: JointLimits,
    period: float,
) -> tuple[Trajectory, LimitCheck] | None:
    """Displace the end of a motion, within the limits and without shortening it.

    Parameters
    ----------
    motion : PublishedMotion
        The motion.
    place : float
        Place on the motion at which the displacement begins [s].
    goal : JointState
        The new end, with its velocities; of the joints of the motion.
    robot, limits :
        Of the same joints.
    period : float
        Longest time between points [s].

    Returns
    -------
    trajectory, check :
        The displaced motion from the place on with its efforts, and its comparison with the
        limits; None if every displacement breaks a limit.
    """
    change = np.abs(goal.positions - motion.end)
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    # Of the minimum-jerk polynomial from 0 to 1 in unit time.
    peaks = (1.875, 5.7735, 60.0)
    needed = [
        float(np.max(peak * change / bound)) ** (1.0 / order)
        for order, (peak, bound) in enumerate(zip(peaks, bounds, strict=True), start=1)
    ]
    # Small displacements are smooth, too, if they take a quarter of a second.
    duration = max(motion.duration - place, 0.25, *needed)
    # Durations up to four times as long are tried, because the sum with the motion must keep the
    # limits.
    for _ in range(7):
        trajectory = _displaced_in(duration, motion, place, goal, period)
        check = check_limits(trajectory, robot, limits)
        if not check.violations:
            return replace(trajectory, efforts=robot.inverse_dynamics(*trajectory.states)), check
        duration *= 1.25
    return None


def _displaced_in(
    duration: float, motion: PublishedMotion, place: float, goal: JointState, period: float
) -> Trajectory:
    """The motion from a place on, plus the polynomial to the change of its end."""
    times = np.linspace(0.0, duration, max(int(np.ceil(duration / period)), 5) + 1)
    last = motion.state(motion.duration)
    ends = zip(last.values, goal.values, strict=True)
    change = [(new - old) * duration**d for d, (old, new) in enumerate(ends)]
    boundary = np.vstack([np.zeros((3, len(goal.positions))), change])
    columns = [
        x + hermite_functions(times / duration, d) @ boundary / duration**d
        for d, x in enumerate(motion.sample(place + times))
    ]
    for x, end in zip(columns, goal.values, strict=True):
        x[-1] = end
    return Trajectory(motion.trajectory.joint_names, times, *columns)
