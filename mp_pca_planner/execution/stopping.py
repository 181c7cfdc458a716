# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that bring a robot to rest within its limits.

A robot that follows its motion is slowed down along the path, which was checked. Else, a single
point is sent. The controller leads there from its own state, in a time that is long enough for
every state it may have.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..motion.interpolation import quintics
from ..motion.trajectory import Trajectory
from ..motion.validation import LIMIT_TOLERANCE, check_limits, nearest_start, reached_bounds
from ..planning.search.stop_and_go import brakes
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .motions import TRANSPORT, USUAL_TRANSPORT, PublishedMotion, hold
from .parameters import Settings
from .tracking import TooLateError, Tracker, Where, continued

LATENCY = 0.02
"""Time to find a stop, from whose end on it begins [s]."""

# The shortest stop [s], and durations of stops in the shortest one: the first that the limits allow
# is used.
_SHORTEST, _PROLONGED = 0.05, 1.2 ** np.arange(42.0)
# Durations of stops along a path [s]: 0.05 to 88 s.
_STOPPING_TIMES: FloatArray = _SHORTEST * _PROLONGED
# Phases at which stops at a point are compared with limits, before the one found is checked.
_PHASES: FloatArray = np.linspace(0.0, 1.0, 21)
_ROUNDING = 1e-9  # of positions [rad or m]

Stop = tuple[str, PublishedMotion]
"""What the robot does, as the begin of a sentence, and the motion to publish."""


def find_stop(
    where: Where | GoalError,
    tracker: Tracker,
    robot: Robot,
    limits: JointLimits,
    settings: Settings,
    time_left: float = np.inf,
    *,
    leaves_path: bool = False,
) -> Stop:
    """Find a stop.

    Parameters
    ----------
    where : Where or GoalError
        Where the robot is, or why that is not known.
    tracker : Tracker
        Has the motion that was published last.
    robot, limits, settings :
        Of the joints of the motion.
    time_left : float
        Time until the robot would hit something on its path [s]: where the stop along the path
        takes longer, the quickest one is used.
    leaves_path : bool
        Whether the path is left. A controller that gets stops along it only when they are over
        rejects them, and takes a single point.

    Raises
    ------
    GoalError
        If neither a measured nor a commanded state is known.
    """
    may_stamp = settings.stamp_trajectories and tracker.measured.stamps.is_usable
    if isinstance(where, GoalError):
        return _silent_stop(where, tracker, robot, limits)
    following, command, now = where.following, where.command, where.now
    names = where.measured.state.joint_names
    is_on_path = following is not None and following.motion.is_path_known and following.is_running
    if is_on_path and not leaves_path:
        try:
            return _stop_along(where, robot, limits, settings, time_left, stamp=may_stamp)
        except TooLateError:
            pass
    if command is not None and not command.at_rest:
        # Under way, a message ages: a stamped one advances with the clock meanwhile.
        is_timed = may_stamp and command.rate > 0.5
        state = command.at(now if is_timed else now + USUAL_TRANSPORT)
        for stop, check in brakes(robot, limits, state, settings.sample_period):
            if not check.violations:
                said = f"the robot comes to rest off its path within {stop.duration:.3g} s"
                if is_timed:
                    return said, PublishedMotion(stop, now, stop, now, is_timed)
                return said, PublishedMotion.on_receipt(stop, now)
    is_over = following is not None and following.is_over
    if where.at_rest or is_over:
        held = where.measured.positions
        if command is not None:
            held = command.held
        elif following is not None and is_over:
            held = following.motion.end
        said = "the robot is at rest and holds its position"
        return said, PublishedMotion.on_receipt(hold(names, held), now)
    # Since the measurement, it has moved at its velocity or a lower one.
    q, v = where.measured.positions, where.measured.velocities
    moved_by = v * max(now - where.measured.time, 0.0)
    possible = [JointState(names, q + share * moved_by, v) for share in (1.0, 0.0)]
    return _stop_at_point(possible, lambda time: q + 0.5 * time * v, now, robot, limits)


def _stop_along(
    where: Where,
    robot: Robot,
    limits: JointLimits,
    settings: Settings,
    time_left: float,
    *,
    stamp: bool,
) -> Stop:
    """Stop a robot that follows its motion."""
    following, now, period = where.following, where.now, settings.sample_period
    assert following is not None
    motion = following.motion
    place = motion.near_point(following.at(now + LATENCY + 2.0 * TRANSPORT))
    stop, said = stop_on_path(motion, place, robot, limits, period), "on its path"
    if LATENCY + 2.0 * TRANSPORT + stop.duration > time_left:
        quickest = brakes(robot, limits, motion.state(place), period)
        found = next((brake for brake, check in quickest if not check.violations), None)
        if found is not None and found.duration < stop.duration:
            stop, said = found, "off its path"
    joined = continued(stop, place, following, now, stamp=stamp)
    return f"the robot comes to rest {said} within {joined.sent.duration:.3g} s", joined


def _silent_stop(error: GoalError, tracker: Tracker, robot: Robot, limits: JointLimits) -> Stop:
    """Stop a robot that sends no joint_states, so it may be anywhere on its motion."""
    motion, now = tracker.motion, tracker.clock()
    if motion is None:
        raise error
    place = now - motion.began
    # It may be held since it was seen last.
    seen = motion.state(place - (tracker.measured.age or 0.0))
    possible = [motion.state(place), JointState(seen.joint_names, seen.positions)]

    def end_after(time: float) -> FloatArray:
        """Where a constant deceleration along the path ends."""
        return motion.state(place + 0.5 * time).positions

    # The command is at `place`: a point where it was seen would move a robot that is not held.
    said, stop = _stop_at_point(possible, end_after, now, robot, limits, held=0)
    return f"{said}; it is not known whether the robot stops: {error}", stop


def _stop_at_point(
    possible: list[JointState],
    end_after: Callable[[float], FloatArray],
    now: float,
    robot: Robot,
    limits: JointLimits,
    held: int = -1,
) -> Stop:
    """Stop at a single point, within the limits from each of some possible commands.

    Else, from the first one alone; else, the robot is sent to the position of the one held.
    """
    stop = stop_at_point(possible, end_after, robot, limits)
    if stop is None:
        stop = stop_at_point(possible[:1], end_after, robot, limits)
    if stop is None:
        # A controller does the same when its goal is cancelled.
        stop = hold(possible[held].joint_names, possible[held].positions)
        said = "no stop within the limits was found: the robot is sent to hold its position"
    else:
        said = f"the robot is sent to a single point, at rest within {stop.duration:.3g} s"
    return said, PublishedMotion.to_last_point(stop, now)


def stop_at_point(
    possible: Sequence[JointState],
    end_after: Callable[[float], FloatArray],
    robot: Robot,
    limits: JointLimits,
) -> Trajectory | None:
    """Find a point that the controller can lead to within the limits from each of some states.

    Parameters
    ----------
    possible : sequence of JointState
        Possible states of the controller.
    end_after : callable
        The end of a stop by its duration [s], shape (n_joints,) [rad or m].
    robot, limits :
        Of the same joints.

    Returns
    -------
    stop : Trajectory or None
        The quintic from the first state to the point; None if no duration keeps the limits.
    """
    names, v = possible[0].joint_names, possible[0].velocities
    slack = 1.0 + LIMIT_TOLERANCE
    most = slack * np.array([limits.velocity, limits.acceleration, limits.jerk])
    if any(np.any(np.abs(state.velocities) > most[0]) for state in possible):
        return None
    # Peaks of the quintic to the end of an even deceleration.
    speed = np.abs(v)
    peaks = np.max(1.5 * speed / limits.acceleration), np.sqrt(np.max(6.0 * speed / limits.jerk))
    durations = max(_SHORTEST, *map(float, peaks)) * _PROLONGED
    # From slightly outside the limits, a stop may only lead inwards.
    ends = nearest_start(np.array([end_after(time) for time in durations]), limits)
    samples = _ways(possible, ends, durations)
    path, greatest = samples[0], np.abs(samples[1:]).max(axis=(1, 2))
    fits = np.all(greatest <= most[:, None], axis=(0, 2))
    lower, upper = reached_bounds(path, limits, path[0] - nearest_start(path[0], limits))
    outside = (path < lower - _ROUNDING) | (path > upper + _ROUNDING)
    fits &= ~outside.any(axis=(0, 1, 3))
    # A few samples show what most durations break: the check takes several times longer, and the
    # node waits meanwhile.
    for k in np.flatnonzero(fits):
        tau = robot.inverse_dynamics(*samples[:3, :, :, k].reshape(3, -1, len(v)))
        if np.any(np.abs(tau) > slack * limits.effort):
            continue
        # Between close points, most of a stop is far from its limits, and need not be sampled.
        ways = (
            Trajectory(names, durations[k] * _PHASES, *samples[:3, :, way, k])
            for way in range(samples.shape[2])
        )
        if not any(check_limits(way, robot, limits).violations for way in ways):
            q, zero = [possible[0].positions, ends[k]], np.zeros_like(v)
            a = [possible[0].accelerations, zero]
            return Trajectory(names, [0.0, durations[k]], q, [v, zero], a)
    return None


def _ways(possible: Sequence[JointState], ends: FloatArray, durations: FloatArray) -> FloatArray:
    """How controllers lead to the ends: by quintics, or by cubics if they have no accelerations.

    Positions and their first three derivatives, shape (4, n_phases, n_ways, n_durations, n_joints)
    """
    time, zero = durations[:, None], np.zeros_like(ends)
    columns = [
        [zero + state.positions, time * state.velocities, time**2 * a, ends, zero, time**2 * last]
        for state in possible
        for a, last in ((state.accelerations, zero), _cubic(state, ends, time))
    ]
    at_ends = np.array(columns).swapaxes(0, 1)
    values = quintics(_PHASES, at_ends.reshape(6, -1), 3).reshape(
        4, len(_PHASES), *at_ends.shape[1:]
    )
    return np.asarray(values / time ** np.arange(4.0)[:, None, None, None, None])


def _cubic(state: JointState, end: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Accelerations at both ends of the cubics from a state to rest."""
    mean, v = (end - state.positions) / time, state.velocities
    return (6.0 * mean - 4.0 * v) / time, (2.0 * v - 6.0 * mean) / time


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
        Place on the motion at which the stop begins [s].
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
    if first < len(times):
        return _slowed(motion, place, times[first], period)
    if motion.near_point(place) >= motion.duration:
        return hold(motion.trajectory.joint_names, motion.end)
    return motion.rest(place)


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
