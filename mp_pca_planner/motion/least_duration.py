# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The least duration of a path: how fast the limits allow to follow it.

With the length σ of a path as its parameter, x = σ̇² and u = σ̈, velocities are q'√x, accelerations
q'u + q''x, and efforts M(q'u + q''x) + C(q')x + g. So limits of acceleration and effort are linear
in (x, u), and those of velocity bound x. The fastest motion follows from two passes over a grid
(Pham and Pham, A new approach to time-optimal path parameterization based on reachability
analysis, 2018): backward, the largest x from which the end can be reached; forward, the largest
next x. Limits of jerk are ignored.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .interpolation import interpolate_at, segment_ends
from .trajectory import Trajectory

# Steps of the path between two rests, and samples by which its length is measured.
_N_STEPS, _N_SAMPLES = 48, 193
# Lengths and, relative to the largest, speeds that count as zero.
_NO_LENGTH, _NO_SPEED = 1e-9, 1e-9
# Multiple of the largest speed of the motion that counts as unlimited.
_UNLIMITED = 1e3


def least_path_duration(trajectory: Trajectory, robot: Robot, limits: JointLimits) -> float:
    """Least duration [s] in which the path of a motion can be followed within the limits.

    The motion starts and ends at the same velocities, and rests where it rests, for no time.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    robot : Robot
        Computes the efforts.
    limits : JointLimits
        Limits of its joints. Limits of velocity, acceleration and effort are kept, those of jerk
        are ignored.

    Returns
    -------
    duration : float
        NaN if the limits don't bound the speed, or if gravity alone
        exceeds a limit of effort.
    """
    times = trajectory.times
    if len(times) < 2:
        return 0.0
    ends = segment_ends(times, *trajectory.states)
    speeds = np.linalg.norm(trajectory.velocities, axis=1)
    rests = np.flatnonzero(speeds <= _NO_SPEED * speeds.max())
    corners = np.unique([0, *rests.tolist(), len(times) - 1]).tolist()
    durations = []
    for first, last in pairwise(corners):
        instants = np.linspace(times[first], times[last], _N_SAMPLES)
        path = _by_length(instants, times, ends)
        if path is not None:
            bounds = speeds[first] ** 2, speeds[last] ** 2
            durations.append(_least_duration(*path, bounds, robot, limits, speeds.max()))
    return float(np.sum(durations))


def _by_length(
    instants: FloatArray, times: FloatArray, ends: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """A part of a path by its length; None if it has none.

    Returns
    -------
    steps : array, shape (n_steps,)
        Lengths of the steps [rad or m].
    q, slope, curvature : array, shape (n_steps + 1, n_joints)
        Positions, and their first and second derivatives by length.
    """
    speeds = np.linalg.norm(interpolate_at(instants, times, ends)[1], axis=1)
    pieces = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(instants)
    lengths = np.concatenate([[0.0], np.cumsum(pieces)])
    if lengths[-1] <= _NO_LENGTH:
        return None
    # Denser towards the ends, where paths from rest are curved most.
    places = 0.5 * lengths[-1] * (1.0 - np.cos(np.linspace(0.0, np.pi, _N_STEPS + 1)))
    at = np.interp(places, lengths, instants)
    q, v, a = interpolate_at(at, times, ends)
    speeds = np.linalg.norm(v, axis=1, keepdims=True)
    moves = speeds[:, 0] > _NO_SPEED * speeds.max()
    ahead = np.diff(q, axis=0)
    slope = np.where(moves[:, None], v, np.concatenate([ahead, ahead[-1:]]))
    slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), np.finfo(float).tiny)
    across = a - np.sum(a * slope, axis=1, keepdims=True) * slope
    # At a rest x is 0, and the curvature may be infinite.
    curvature = np.divide(across, speeds**2, out=np.zeros_like(a), where=moves[:, None])
    return np.diff(places), q, slope, curvature


def _least_duration(
    steps: FloatArray,
    q: FloatArray,
    slope: FloatArray,
    curvature: FloatArray,
    ends: tuple[float, float],
    robot: Robot,
    limits: JointLimits,
    fastest: float,
) -> float:
    """Least duration of a part of a path between squared speeds at its ends [s].

    With x at a point and y at the next one, u = (y − x) / (2 step). Each limit of acceleration or
    effort is a row a y + b x ≤ c.
    """
    upper, lower = _rows(steps, q, slope, curvature, robot, limits)
    a, b, c = np.concatenate([upper, lower], axis=2)
    if np.any(c < 0.0):
        return float("nan")
    with np.errstate(divide="ignore"):
        most = np.min(limits.velocity / np.abs(slope), axis=1) ** 2
    most = np.minimum(most, (_UNLIMITED * fastest) ** 2)
    # Where a path turns back it rests.
    most[1:][np.sum(slope[1:] * slope[:-1], axis=1) <= 0.0] = 0.0
    highest, lowest_next = _largest(upper, lower, most)
    # Backward. On the line y = reachable, the rows bound x from above where b > 0.
    c_by_b, a_by_b = _ratios(c, a, b)
    reachable = np.empty(len(most))
    reachable[-1] = ends[1]
    for i in range(len(most) - 2, -1, -1):
        if lowest_next[i] <= reachable[i + 1]:
            reachable[i] = highest[i]
        else:
            reachable[i] = max(np.min(c_by_b[i] - a_by_b[i] * reachable[i + 1]), 0.0)
    # Forward. At a given x, the rows bound y from above where a > 0.
    c_by_a, b_by_a = _ratios(c, b, a)
    chosen = np.empty(len(most))
    chosen[0] = min(ends[0], reachable[0])
    for i in range(len(most) - 1):
        following = np.min(c_by_a[i] - b_by_a[i] * chosen[i])
        chosen[i + 1] = max(min(following, reachable[i + 1]), 0.0)
    speeds = np.sqrt(chosen)
    if speeds.max() >= _UNLIMITED * fastest * (1.0 - 1e-6):
        return float("nan")
    with np.errstate(divide="ignore"):
        return float(np.sum(2.0 * steps / (speeds[1:] + speeds[:-1])))


def _rows(
    steps: FloatArray,
    q: FloatArray,
    slope: FloatArray,
    curvature: FloatArray,
    robot: Robot,
    limits: JointLimits,
) -> tuple[FloatArray, FloatArray]:
    """Coefficients a, b and c of the rows, shape (3, n_points, n_rows); a ≥ 0, then a ≤ 0."""
    bounded = np.isfinite(limits.acceleration)
    u, x, fixed = slope[:, bounded], curvature[:, bounded], np.zeros((len(q), int(bounded.sum())))
    bound = limits.acceleration[bounded]
    bounded = np.isfinite(limits.effort)
    if bounded.any():
        rest = np.zeros_like(q)
        gravity = robot.inverse_dynamics(q, rest, rest)
        inertial = robot.inverse_dynamics(q, rest, slope) - gravity
        moving = robot.inverse_dynamics(q, slope, curvature) - gravity
        u = np.concatenate([u, inertial[:, bounded]], axis=1)
        x = np.concatenate([x, moving[:, bounded]], axis=1)
        fixed = np.concatenate([fixed, gravity[:, bounded]], axis=1)
        bound = np.concatenate([bound, limits.effort[bounded]])
    sign = np.where(u < 0.0, -1.0, 1.0)
    a, x, fixed = sign * u / (2.0 * np.append(steps, steps[-1])[:, None]), sign * x, sign * fixed
    upper, lower = np.array([a, x - a, bound - fixed]), np.array([-a, a - x, bound + fixed])
    # y ≥ 0
    not_negative = np.zeros((3, len(q), 1))
    not_negative[0] = -1.0
    return upper, np.concatenate([lower, not_negative], axis=2)


def _largest(
    upper: FloatArray, lower: FloatArray, most: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The largest x that the rows allow at each point for any y, and the least y there.

    A row above y and one below it leave room between them up to an x.
    """
    c_above, b_above = _ratios(upper[2], upper[1], upper[0])
    c_below, b_below = _ratios(lower[2], lower[1], -lower[0])
    slopes = b_above[:, :, None] + b_below[:, None]
    rooms = c_above[:, :, None] + c_below[:, None]
    closing = np.divide(rooms, slopes, out=np.full_like(rooms, np.inf), where=slopes > 0.0)
    highest = np.minimum(most, closing.min(axis=(1, 2), initial=np.inf))
    for a, b, c in (upper, lower):
        alone = np.divide(c, b, out=np.full_like(c, np.inf), where=(a == 0.0) & (b > 0.0))
        highest = np.minimum(highest, alone.min(axis=1, initial=np.inf))
    return highest, np.max(b_below * highest[:, None] - c_below, axis=1)


def _ratios(c: FloatArray, other: FloatArray, by: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The ratios c / by and other / by where by > 0; infinity and 0 elsewhere."""
    positive = by > 0.0
    ratio = np.divide(c, by, out=np.full_like(c, np.inf), where=positive)
    return ratio, np.divide(other, by, out=np.zeros_like(c), where=positive)
