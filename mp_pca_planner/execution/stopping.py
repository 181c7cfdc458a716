# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that bring a robot to rest within its limits.

A robot that follows its motion is slowed down along the path, which was checked. If its place on
the motion is unknown, a single point is sent. The controller leads there from its own state, in a
time that is long enough for every state it may have.
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
from .published_motion import PublishedMotion, states_of

# Durations of stops [s]: 0.05 to 88 s; the shortest that the limits allow is used.
_STOPPING_TIMES: FloatArray = 0.05 * 1.2 ** np.arange(42.0)


def stop_on_path(
    motion: PublishedMotion, place: float, robot: Robot, limits: JointLimits, period: float
) -> Trajectory:
    """Slow a motion down along its path as fast as the limits allow.

    The rate at which the place advances falls from 1 to 0 as 1 − 3u² + 2u³, so the stop continues
    positions, velocities and accelerations of the motion.

    Parameters
    ----------
    motion : PublishedMotion
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
        The stop from that place; the rest of the motion if every stop breaks a limit.
    """

    def is_allowed(time: float) -> bool:
        stop = _slowed(motion, place, time, period)
        return not check_limits(stop, robot, limits).violations

    times = _STOPPING_TIMES[2.0 * (motion.duration - place) > _STOPPING_TIMES]
    first = bisect_left(times, True, key=is_allowed)
    if first == len(times):
        return _rest_of(motion, place)
    return _slowed(motion, place, times[first], period)


def stop_at_point(
    states: Sequence[JointState], ends: Sequence[FloatArray], robot: Robot, limits: JointLimits
) -> Trajectory | None:
    """Find a point that the controller can lead to within the limits from each of some states.

    Parameters
    ----------
    states : sequence of JointState
        Possible states of the controller.
    ends : sequence of array, shape (n_joints,)
        End of the stop [rad or m], for each duration of a stop.
    robot, limits :
        Of the same joints.

    Returns
    -------
    stop : Trajectory or None
        From the first state to the end; None if every stop breaks a limit.
    """
    for time, end in zip(_STOPPING_TIMES, ends, strict=True):
        stops = [stop for state in states for stop in _interpolated(state, end, time)]
        if all(not check_limits(stop, robot, limits).violations for stop in stops):
            return stops[0]
    return None


def braking_ends(state: JointState) -> list[FloatArray]:
    """Where a moving robot comes to rest most smoothly, for each duration of a stop.

    There the controller's quintic is the quartic of least jerk. Without an initial acceleration,
    its cubic has a constant deceleration.
    """
    q, v, a = state.positions, state.velocities, state.accelerations
    return [q + v * time / 2.0 + a * time**2 / 12.0 for time in _STOPPING_TIMES]


def ends_at(positions: FloatArray) -> list[FloatArray]:
    """The same end, for each duration of a stop."""
    return [positions] * len(_STOPPING_TIMES)


def ends_on_path(motion: PublishedMotion, place: float) -> list[FloatArray]:
    """Where a constant deceleration along a motion ends, for each duration of a stop."""
    q, _, _ = motion.sample(np.asarray(place + 0.5 * _STOPPING_TIMES))
    return list(q)


def hold(joint_names: Sequence[str], positions: FloatArray) -> Trajectory:
    """A trajectory of one point at rest."""
    zero = np.zeros((1, len(positions)))
    return Trajectory(joint_names, [0.0], [positions], zero, zero)


def _slowed(motion: PublishedMotion, place: float, time: float, period: float) -> Trajectory:
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


def _rest_of(motion: PublishedMotion, place: float) -> Trajectory:
    """The motion from a place on; its end if it is over."""
    old = motion.trajectory
    if place >= old.duration:
        return hold(old.joint_names, motion.end)
    last = Trajectory(old.joint_names, [0.0], *(x[-1:] for x in states_of(old)))
    return motion.followed_by(last, old.duration, place)


def _interpolated(state: JointState, end: FloatArray, time: float) -> list[Trajectory]:
    """How a controller leads to a single point: a quintic, or a cubic without accelerations."""
    q, v, a = state.positions, state.velocities, state.accelerations
    zero = np.zeros_like(q)
    way = (end - q) / time
    cubic = [(6.0 * way - 4.0 * v) / time, (2.0 * v - 6.0 * way) / time]
    return [
        Trajectory(state.joint_names, [0.0, time], [q, end], [v, zero], accelerations)
        for accelerations in ([a, zero], cubic)
    ]
