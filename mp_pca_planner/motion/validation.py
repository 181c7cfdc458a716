# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The one validator of trajectories: every published one has passed it.

It checks the quintic polynomials by which joint_trajectory_controller joins the points, on a grid
of at most 1 ms. So its result depends neither on how a trajectory was planned nor on how densely
it is sampled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .goal import JointState
from .interpolation import GRID_PERIOD, curve_bounds, interpolate, segment_ends
from .trajectory import Trajectory

LIMIT_TOLERANCE = 1e-6
"""Relative excess over a limit that counts as rounding."""

LIMIT_NEAR = 1e-4
"""Relative distance from a limit within which the grid may miss a violation."""

# Samples of efforts of a short motion at least: between them, peaks of random reaches in 0.02 to
# 0.09 s exceeded the largest sample by at most 6e-5.
_N_EFFORTS = 400

START_TOLERANCE = 1e-3
"""Distance outside the limits of position from which a motion may start [rad or m]: what an encoder
errs, or an end stop gives way. No joint may move further out, or out again."""


@dataclass(frozen=True)
class Violation:
    """A violated limit of a trajectory.

    Attributes
    ----------
    quantity : str
        'position', 'velocity', 'acceleration', 'jerk' or 'effort'.
    joint : str
        Name of the joint.
    time : float
        Time of the largest violation [s].
    value, limit : float
        The value at that time and the limit, in SI units.
    excess : float
        Relative excess: |value| / limit − 1, for positions the distance outside divided
        by the length of the range (or by 1 rad or m if that is infinite).
    """

    quantity: str
    joint: str
    time: float
    value: float
    limit: float
    excess: float

    def __str__(self) -> str:
        return (
            f"{self.quantity} of joint '{self.joint}' is {self.value:.4g} at {self.time:.3f} s, "
            f"limit {self.limit:.4g}"
        )


@dataclass(frozen=True, eq=False)
class LimitCheck:
    """Result of comparing a trajectory with limits.

    Attributes
    ----------
    touched : tuple of Violation
        Every limit that is violated or nearer than `LIMIT_NEAR`, the worst first.
    efforts : array, shape (n_points, n_joints), or None
        Efforts at the points of the trajectory [N·m or N]; None if they are not known.
    remark : str
        Which joint starts outside its limits of position, within `START_TOLERANCE`; empty if none.
    """

    touched: tuple[Violation, ...] = ()
    efforts: FloatArray | None = None
    remark: str = ""

    @property
    def violations(self) -> tuple[Violation, ...]:
        """Every limit violated by more than rounding, the worst first."""
        return tuple(one for one in self.touched if not one.excess <= LIMIT_TOLERANCE)

    @property
    def worst_excess(self) -> float:
        """Largest relative excess, 0 if every limit holds."""
        return max((v.excess for v in self.touched if not v.excess <= 0.0), default=0.0)


def check_limits(trajectory: Trajectory, robot: Robot, limits: JointLimits) -> LimitCheck:
    """Compare a trajectory with limits on a grid of at most 1 ms.

    Efforts of motions below 0.4 s are compared on a finer grid.

    Parameters
    ----------
    trajectory : Trajectory
        Of the joints of the robot, in its order.
    robot : Robot
        Computes the efforts; those of the trajectory are ignored.
    limits : JointLimits
        Limits of the same joints.

    Raises
    ------
    RobotError
        If efforts are limited, and a moving link of the robot has no valid inertia.
    """
    require_effort_limits(robot, limits)
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    steps, ends = np.diff(trajectory.times), segment_ends(trajectory.times, q, v, a)
    at_points, start = robot.inverse_dynamics(q, v, a), q[0]
    inside = nearest_start(start, limits)
    # Only segments that come near a limit are sampled, and a single point.
    near, near_efforts = np.ones(1, dtype=bool), np.isfinite(limits.effort)
    if steps.size:
        lowest, highest = curve_bounds(ends, steps)
        near = _near_limits(lowest, highest, limits)
        if near_efforts.any():
            distances = np.maximum(-lowest, highest[0])
            slopes = robot.effort_slopes(distances, *highest[1:])
            near_efforts = _near_effort_limits(slopes, steps, at_points, limits)
    touched: list[Violation] = []
    if near.any():
        dense, span = interpolate(trajectory, segments=near), _span(limits)
        lower, upper = reached_bounds(dense.q, limits, start - inside)
        for compared in (
            ("position", dense.q, limits.lower, (lower - dense.q) / span),
            ("position", dense.q, limits.upper, (dense.q - upper) / span),
            _magnitude("velocity", dense.v, limits.velocity),
            _magnitude("acceleration", dense.a, limits.acceleration),
            _magnitude("jerk", dense.jerk, limits.jerk),
        ):
            touched += _worst(limits.joint_names, dense.times, *compared)
    if near_efforts.any():
        period = min(GRID_PERIOD, trajectory.duration / _N_EFFORTS)
        dense = interpolate(trajectory, period, near_efforts)
        tau = _magnitude("effort", robot.inverse_dynamics(dense.q, dense.v, dense.a), limits.effort)
        touched += _worst(limits.joint_names, dense.times, *tau)
    touched.sort(key=lambda one: -one.excess)
    efforts = None if np.isnan(at_points).any() else at_points
    remark = "" if np.array_equal(start, inside) else _start_remark(start, inside, limits)
    return LimitCheck(tuple(touched), efforts, remark)


def nearest_start(positions: FloatArray, limits: JointLimits) -> FloatArray:
    """The nearest positions within the limits; the same where they are not `START_TOLERANCE` near.

    Parameters
    ----------
    positions : array, shape (..., n_joints)
        Positions at which a motion starts [rad or m].
    limits : JointLimits
        Limits of the joints.
    """
    inside = np.clip(positions, limits.lower, limits.upper)
    return np.where(np.abs(positions - inside) <= START_TOLERANCE, inside, positions)


def reached_bounds(
    q: FloatArray, limits: JointLimits, outside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds of positions that follow one another, for joints that start this far outside.

    A joint outside may stay where it is or move inwards; then its bound moves with it.

    Parameters
    ----------
    q : array, shape (n_samples, ..., n_joints)
        Positions [rad or m].
    limits : JointLimits
        Limits of the joints.
    outside : array, shape (..., n_joints)
        How far each starts above its bounds; negative below them [rad or m].
    """
    if not outside.any():
        return limits.lower, limits.upper
    lowest = np.minimum(limits.lower, np.maximum.accumulate(q))
    highest = np.maximum(limits.upper, np.minimum.accumulate(q))
    lower = np.where(outside < 0.0, lowest, limits.lower)
    return lower, np.where(outside > 0.0, highest, limits.upper)


def _start_remark(start: FloatArray, inside: FloatArray, limits: JointLimits) -> str:
    """Which joint starts furthest outside its limits of position."""
    worst = int(np.abs(start - inside).argmax())
    return (
        f"joint '{limits.joint_names[worst]}' starts {abs(start[worst] - inside[worst]):.2g} rad "
        f"(or m) outside its limits of position, at most {START_TOLERANCE:g} is accepted: it moves "
        "inwards"
    )


def _worst(
    names: Sequence[str],
    times: FloatArray,
    quantity: str,
    values: FloatArray,
    bound: FloatArray,
    excess: FloatArray,
) -> Iterator[Violation]:
    """The worst sample of each joint, if it is near a limit."""
    for j, (name, k) in enumerate(zip(names, excess.argmax(axis=0), strict=True)):
        if not excess[k, j] <= -LIMIT_NEAR:  # a NaN is a violation
            at = (times[k], values[k, j], bound[j], excess[k, j])
            yield Violation(quantity, name, *map(float, at))


def _magnitude(
    quantity: str, values: FloatArray, bound: FloatArray
) -> tuple[str, FloatArray, FloatArray, FloatArray]:
    """Values with a bound on their magnitude, and their relative excess."""
    return quantity, values, bound, np.abs(values) / bound - 1.0


def require_effort_limits(robot: Robot, limits: JointLimits) -> None:
    """Reject a robot whose efforts are limited, but can't be computed.

    Raises
    ------
    RobotError
        If a moving link has no valid inertia.
    """
    if np.isfinite(limits.effort).any():
        robot.require_inertias("limits of efforts", "remove those limits (max_effort: .inf)")


def _near_limits(lowest: FloatArray, highest: FloatArray, limits: JointLimits) -> NDArray[np.bool_]:
    """Segments with positions or their derivatives near or beyond a limit, by their bounds."""
    room = LIMIT_NEAR * _span(limits)
    inside = (lowest > limits.lower + room) & (highest[0] < limits.upper - room)
    bounds = np.array([limits.velocity, limits.acceleration, limits.jerk])
    inside &= np.all(highest[1:] < (1.0 - LIMIT_NEAR) * bounds[:, None], axis=0)
    return np.asarray(~inside.all(axis=1))


def _near_effort_limits(
    slopes: FloatArray, steps: FloatArray, at_points: FloatArray, limits: JointLimits
) -> NDArray[np.bool_]:
    """Segments whose efforts may be near or beyond a limit."""
    # An instant is at most half a step from a point, where the effort is known, and between them it
    # changes at most as fast as the bounds of its slopes allow.
    tau = np.abs(at_points)
    values = np.maximum(tau[:-1], tau[1:]) + 0.5 * steps[:, None] * slopes
    return np.asarray(~np.all(values < (1.0 - LIMIT_NEAR) * limits.effort, axis=1))


def _span(limits: JointLimits) -> FloatArray:
    """Lengths of the ranges of positions, 1 rad or m where they are infinite."""
    span = limits.upper - limits.lower
    return np.where(np.isfinite(span), span, 1.0)


def check_executable(
    trajectory: Trajectory,
    check: LimitCheck,
    start: JointState,
    *,
    allow_nonzero_end_velocity: bool = False,
) -> None:
    """Reject a trajectory that must not be sent to joint_trajectory_controller.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory. Its constructor has checked for finite numbers, unique joints and
        increasing times from 0.
    check : LimitCheck
        Result of :func:`check_limits` for it.
    start : JointState
        Present (or commanded) state of the same joints.
    allow_nonzero_end_velocity : bool
        Whether the controller is set to accept a motion that doesn't end at rest.

    Raises
    ------
    TrajectoryError
        If it violates a limit, doesn't start at the present state, or doesn't end at rest.
    """
    if check.violations:
        raise TrajectoryError(str(check.violations[0]))
    if trajectory.joint_names != start.joint_names:
        raise TrajectoryError(
            f"the trajectory moves {trajectory.joint_names}, the state is of {start.joint_names}"
        )
    jump = np.abs(trajectory.positions[0] - start.positions)
    worst = int(jump.argmax())
    if not jump[worst] <= 1e-9:  # rounding
        raise TrajectoryError(
            f"the trajectory starts {jump[worst]:.3g} rad (or m) from the present position of "
            f"joint '{trajectory.joint_names[worst]}'"
        )
    if not allow_nonzero_end_velocity and np.any(trajectory.velocities[-1] != 0.0):
        worst = int(np.abs(trajectory.velocities[-1]).argmax())
        raise TrajectoryError(
            f"the trajectory ends with a velocity of {trajectory.velocities[-1, worst]:.3g} of "
            f"joint '{trajectory.joint_names[worst]}', and the controller accepts only exactly 0"
        )
