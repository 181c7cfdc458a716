# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Laws of time scaling: durations in which motions keep limits.

With the duration T of a motion from rest to rest, velocities fall as 1/T, accelerations as 1/T²,
jerks as 1/T³, and efforts tend to those of gravity, τ(s) = g(s) + m(s)/T².

A path alone can be followed faster. With its length σ as the parameter, x = σ̇² and u = σ̈,
velocities are q'√x, accelerations q'u + q''x, and efforts M(q'u + q''x) + C(q')x + g. So limits of
acceleration and effort are linear in (x, u), and those of velocity bound x. The fastest motion
follows from two passes over a grid (Pham and Pham, A new approach to time-optimal path
parameterization based on reachability analysis, 2018): backward, the largest x from which the end
can be reached; forward, the largest next x. Limits of jerk are ignored there.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.interpolation import interpolate_at, quintics, segment_ends
from ..motion.trajectory import Trajectory
from ..motion.validation import Violation
from ..robot.limits import JointLimits
from ..robot.model import Robot

# Largest velocity, acceleration and jerk of the minimum-jerk motion of distance 1 in a time of 1.
_PEAKS = (15.0 / 8.0, 10.0 / np.sqrt(3.0), 60.0)
_PHASES = np.linspace(0.0, 1.0, 41)
_POWERS = {"velocity": 1.0, "acceleration": 1.0 / 2.0, "jerk": 1.0 / 3.0, "effort": 1.0 / 2.0}
# Steps of the path between two rests, and samples by which its length is measured.
_N_STEPS, _N_SAMPLES = 48, 193
# Lengths and, relative to the largest, speeds that count as zero.
_NO_LENGTH, _NO_SPEED = 1e-9, 1e-9
# Multiple of the largest speed of the motion that counts as unlimited.
_UNLIMITED = 1e3


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
        Infinite if gravity alone exceeds the limits of effort, unless the motion keeps them and
        another limit asks for a longer duration.
    """
    kinematic = kinematic_stretch(limits, states[1:])
    if not np.isfinite(limits.effort).any():
        return kinematic
    tau = robot.inverse_dynamics(*states[:3])
    if kinematic >= 1.0 and np.all(np.abs(tau) <= limits.effort):
        return kinematic
    gravity = _gravity(robot, states[0])
    if not np.all(np.abs(gravity) < limits.effort):
        return float("inf")
    return max(kinematic, _stretch_of_efforts(limits, gravity, tau - gravity))


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


def _gravity(robot: Robot, q: FloatArray) -> FloatArray:
    """Efforts of gravity, the part of efforts that does not depend on the duration."""
    rest = np.zeros_like(q)
    return robot.inverse_dynamics(q, rest, rest)


def _stretch_of_efforts(limits: JointLimits, gravity: FloatArray, moving: FloatArray) -> float:
    """The least factor k with |g + m/k²| ≤ τ_max."""
    room = limits.effort - np.sign(moving) * gravity
    return float(np.sqrt(np.max(np.abs(moving) / np.maximum(room, np.finfo(float).tiny))))


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
        If gravity alone exceeds the limits of effort between them.
    """
    displacement = goal - start
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    kinematic = [
        float(np.max(peak * np.abs(displacement) / bound)) ** (1.0 / order)
        for order, (peak, bound) in enumerate(zip(_PEAKS, bounds, strict=True), start=1)
    ]
    if not np.isfinite(limits.effort).any():
        return float(max(kinematic))
    ends = np.zeros((6, displacement.size))
    ends[0], ends[3] = start, goal
    q, v, a = quintics(_PHASES, ends, 2)
    gravity = _gravity(robot, q)
    _check_gravity(gravity, limits)
    moving = robot.inverse_dynamics(q, v, a) - gravity
    return float(max(*kinematic, _stretch_of_efforts(limits, gravity, moving)))


def _check_gravity(gravity: FloatArray, limits: JointLimits) -> None:
    share = np.abs(gravity) / limits.effort
    k, j = np.unravel_index(int(share.argmax()), share.shape)
    if share[k, j] >= 1.0:
        raise TrajectoryError(
            f"on the straight path gravity alone takes an effort of {abs(gravity[k, j]):.4g} of "
            f"joint '{limits.joint_names[j]}', limit {limits.effort[j]:.4g}"
        )


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
        gravity = _gravity(robot, q)
        inertial = robot.inverse_dynamics(q, np.zeros_like(q), slope) - gravity
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
