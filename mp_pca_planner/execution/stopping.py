# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that bring a robot to rest within its limits.

A robot that follows its motion is slowed down along it, which leaves the path that was checked.
Where it is not known where on its motion the controller is, a single point is sent: the controller
leads there from where it is, in a time that is long enough from everywhere it may be.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_limits
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .commanded import CommandedMotion

# Times that a stop may take [s]; the shortest that the limits allow is used.
_STOPPING_TIMES: FloatArray = 0.05 * 1.2 ** np.arange(42.0)


def stop_on_path(
    motion: CommandedMotion, place: float, robot: Robot, limits: JointLimits, period: float
) -> Trajectory:
    """Slow a motion down along its path as fast as the limits allow.

    The rate at which the place advances falls from 1 to 0 as 1 − 3u² + 2u³, so the stop continues
    positions, velocities and accelerations of the motion.

    Parameters
    ----------
    motion : CommandedMotion
        The motion.
    place : float
        Where on it the stop begins [s].
    robot, limits :
        Of the joints of the motion.
    period : float
        Longest time between points [s].

    Returns
    -------
    stop : Trajectory
        Starts at the place; the rest of the motion itself if every stop breaks a limit.
    """

    def is_allowed(time: float) -> bool:
        stop = _slowed(motion, place, time, period)
        return not check_limits(stop, robot, limits).violations

    times = _STOPPING_TIMES[2.0 * (motion.duration - place) > _STOPPING_TIMES]
    first = bisect_left(times, True, key=is_allowed)
    return (
        _slowed(motion, place, times[first], period)
        if first < len(times)
        else _rest_of(motion, place)
    )


def stop_at_point(
    states: Sequence[JointState],
    ends: Sequence[FloatArray],
    robot: Robot,
    limits: JointLimits,
) -> Trajectory | None:
    """Find a last point that a controller may lead to from any of some states.

    Parameters
    ----------
    states : sequence of JointState
        Where the controller may be.
    ends : sequence of array, shape (n_joints,)
        Where the stop may end [rad or m]: one for each time that a stop may take.
    robot, limits :
        Of the same joints.

    Returns
    -------
    stop : Trajectory or None
        Two points, the first of them the first state; none if every stop breaks a limit.
    """
    for time, end in zip(_STOPPING_TIMES, ends, strict=True):
        stops = [stop for state in states for stop in _interpolated(state, end, time)]
        if all(not check_limits(stop, robot, limits).violations for stop in stops):
            return stops[0]
    return None


def braking_ends(state: JointState) -> list[FloatArray]:
    """Where a moving robot comes to rest most smoothly, for each time that a stop may take.

    There the quintic is the quartic of least jerk, and without an acceleration to start from
    the controller's cubic brakes evenly.
    """
    q, v, a = state.positions, state.velocities, state.accelerations
    return [q + v * time / 2.0 + a * time**2 / 12.0 for time in _STOPPING_TIMES]


def ends_at(positions: FloatArray) -> list[FloatArray]:
    """The same end, for each time that a stop may take."""
    return [positions] * len(_STOPPING_TIMES)


def ends_on_path(motion: CommandedMotion, place: float) -> list[FloatArray]:
    """Where an even braking along a motion ends, for each time that a stop may take."""
    q, _, _ = motion.sample(np.asarray(place + 0.5 * _STOPPING_TIMES))
    return list(q)


def hold(joint_names: Sequence[str], positions: FloatArray) -> Trajectory:
    """Stay at positions: one point, at once."""
    zero = np.zeros((1, len(positions)))
    return Trajectory(joint_names, [0.0], [positions], zero, zero)


def _slowed(motion: CommandedMotion, place: float, time: float, period: float) -> Trajectory:
    n_steps = max(int(np.ceil(time / period)), 5)
    times = np.linspace(0.0, time, n_steps + 1)
    u = times / time
    rate = 1.0 - 3.0 * u**2 + 2.0 * u**3
    change = (-6.0 * u + 6.0 * u**2) / time
    q, v, a = motion.sample(place + time * (u - u**3 + 0.5 * u**4))
    a = a * rate[:, None] ** 2 + v * change[:, None]
    v = v * rate[:, None]
    v[-1] = a[-1] = 0.0
    return Trajectory(motion.trajectory.joint_names, times, q, v, a)


def _rest_of(motion: CommandedMotion, place: float) -> Trajectory:
    """The motion from a place on, or a hold where it is over."""
    old = motion.trajectory
    if place >= old.duration:
        return hold(old.joint_names, motion.end)
    last = Trajectory(
        old.joint_names,
        [0.0],
        old.positions[-1:],
        old.velocities[-1:],
        old.accelerations[-1:],
    )
    return motion.followed_by(last, old.duration, place)


def _interpolated(state: JointState, end: FloatArray, time: float) -> list[Trajectory]:
    """What a controller makes of a single point: a quintic, or a cubic without accelerations."""
    q, v, a = state.positions, state.velocities, state.accelerations
    zero = np.zeros_like(q)
    way = (end - q) / time
    cubic = [(6.0 * way - 4.0 * v) / time, (2.0 * v - 6.0 * way) / time]
    return [
        Trajectory(state.joint_names, [0.0, time], [q, end], [v, zero], accelerations)
        for accelerations in ([a, zero], cubic)
    ]
