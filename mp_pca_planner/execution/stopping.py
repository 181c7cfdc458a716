# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that bring a robot to rest within its limits.

A robot that follows its motion is slowed down along the path, which was checked. Else, a single
point is sent. The controller leads there from its own state, in a time that is long enough for
every state it may have.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from ..arrays import FloatArray, set_frozen
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
from .tracking import How, TooLateError, Tracker, Where, continued

LATENCY = 0.02
"""Time to find a stop, from whose end on it begins [s]."""

# Durations of stops [s]: 0.05 to 88 s; the shortest that the limits allow is used.
_STOPPING_TIMES: FloatArray = 0.05 * 1.2 ** np.arange(42.0)
_AT_ONCE = 7
# Phases at which a motion to a single point is checked; its efforts at every fifth of them.
_SAMPLES: FloatArray = np.linspace(0.0, 1.0, 201)
_EFFORT_STEP = 5
_ROUNDING = 1e-9  # of positions [rad or m]
# Shares of the limits of acceleration and jerk for stops of a robot whose state is estimated.
_ACCELERATION_SHARE, _JERK_SHARE = 0.7, 0.5

Stop = tuple[str, PublishedMotion]
"""What the robot does, as the begin of a sentence, and the motion to publish."""


def find_stop(
    where: Where | GoalError,
    tracker: Tracker,
    robot: Robot,
    limits: JointLimits,
    settings: Settings,
    time_left: float = np.inf,
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
    if following is not None and following.is_running and following.motion.is_path_known:
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
    # Its command is estimated: since the measurement, it has moved at its velocity or a lower one.
    q, v = where.measured.positions, where.measured.velocities
    moved_by = v * max(now - where.measured.time, 0.0)
    possible = [JointState(names, q + share * moved_by, v) for share in (0.0, 0.5, 1.0)]
    if where.measured.state.velocities.any():
        possible.append(where.measured.state)
    if following is not None and following.how is How.BEHIND:
        possible.append(following.motion.state(following.place))
    return _stop_at_point(possible, [braking_ends(possible[0])], now, robot, _reduced(limits))


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
    latest = now - motion.began
    # After its end, the robot is at one place.
    seen = latest - (tracker.measured.age or 0.0)
    places = np.unique(np.clip(np.linspace(seen, latest, 6), 0.0, motion.duration))
    states = [motion.state(place) for place in places]
    resting = [JointState(state.joint_names, state.positions) for state in states]
    moving = [s for s in states if np.any([s.velocities, s.accelerations])]
    ends = [ends_on_path(motion, latest)]
    said, stop = _stop_at_point([*moving, *resting], ends, now, robot, limits)
    return f"{said}; it is not known whether the robot stops: {error}", stop


def _stop_at_point(
    possible: list[JointState],
    ends: list[FloatArray],
    now: float,
    robot: Robot,
    limits: JointLimits,
) -> Stop:
    """Stop at a single point, within the limits from each of some possible commands."""
    for end in ends:
        # From slightly outside the limits, a stop may only lead inwards.
        inside = nearest_start(end, limits)
        for states in (possible, possible[:1]):
            stop = next(stops_at_points(states, inside, robot, limits), None)
            if stop is not None:
                said = (
                    f"the robot is sent to a single point, at rest within {stop[0].duration:.3g} s"
                )
                return said, PublishedMotion.to_last_point(stop[0], now)
    # A controller does the same when its goal is cancelled.
    point = hold(possible[0].joint_names, possible[0].positions)
    said = "no stop within the limits was found: the robot is sent to hold its position"
    return said, PublishedMotion.to_last_point(point, now)


def _reduced(limits: JointLimits) -> JointLimits:
    """Limits with a margin for errors of an estimated state."""
    reduced = copy(limits)
    acceleration = _ACCELERATION_SHARE * limits.acceleration
    set_frozen(reduced, acceleration=acceleration, jerk=_JERK_SHARE * limits.jerk)
    return reduced


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
    if first == len(times):
        return _rest_of(motion, place)
    return _slowed(motion, place, times[first], period)


def stops_at_points(
    states: Sequence[JointState], ends: FloatArray, robot: Robot, limits: JointLimits
) -> Iterator[list[Trajectory]]:
    """Find points that the controller can lead to within the limits from each of some states.

    Parameters
    ----------
    states : sequence of JointState
        Possible states of the controller.
    ends : array, shape (n_durations, n_joints)
        End of the stop [rad or m], for each duration of a stop.
    robot, limits :
        Of the same joints.

    Yields
    ------
    stops : list of Trajectory
        The quintic to an end from each state; the shortest durations first.
    """
    q, v, a = (
        np.array(rows)
        for rows in zip(
            *((s.positions, s.velocities, s.accelerations) for s in states), strict=True
        )
    )
    for time, end in _shortest_first(q, v, ends, limits):
        if _is_within(q, v, a, end, time, robot, limits):
            zero, times = np.zeros_like(q), np.array([0.0, time])
            # The cubics differ little from these.
            every = np.stack([[q, v, a], [zero + end, zero, zero]], axis=-2).swapaxes(0, 1)
            yield [Trajectory(limits.joint_names, times, *columns) for columns in every]


def braking_ends(state: JointState) -> FloatArray:
    """The end of the smoothest stop of a moving robot, for each duration of a stop [rad or m].

    For this end, the controller's quintic is the quartic of least jerk. Without an initial
    acceleration, its cubic has a constant deceleration.
    """
    q, v, a = state.positions, state.velocities, state.accelerations
    times = _STOPPING_TIMES[:, None]
    return np.asarray(q + v * times / 2.0 + a * times**2 / 12.0)


def ends_on_path(motion: PublishedMotion, place: float) -> FloatArray:
    """The end of a constant deceleration along a motion, for each duration of a stop."""
    q, _, _ = motion.sample(np.asarray(place + 0.5 * _STOPPING_TIMES))
    return q


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
    if motion.near_point(place) >= motion.duration:
        return hold(motion.trajectory.joint_names, motion.end)
    return motion.rest(place)


def _shortest_first(
    q: FloatArray, v: FloatArray, ends: FloatArray, limits: JointLimits
) -> Iterator[tuple[float, FloatArray]]:
    """Durations whose cubics are within the kinematic limits at both ends, and these ends."""
    slack = 1.0 + LIMIT_TOLERANCE
    most = slack * np.array([limits.acceleration, limits.acceleration, limits.jerk])[:, None]
    if not np.all(np.abs(v) <= slack * limits.velocity):
        return
    for first in range(0, len(_STOPPING_TIMES), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        times = _STOPPING_TIMES[some, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            start, end = _cubics(q, v, ends[some, None], times)
            peaks = np.abs([start, end, (end - start) / times]).max(axis=2)
        may_stop = np.all((peaks <= most) & np.isfinite(peaks), axis=(0, 2))
        yield from zip(_STOPPING_TIMES[some][may_stop].tolist(), ends[some][may_stop], strict=True)


def _is_within(
    q: FloatArray,
    v: FloatArray,
    a: FloatArray,
    end: FloatArray,
    time: float,
    robot: Robot,
    limits: JointLimits,
) -> bool:
    """Whether the controller's motions from all states to an end are within the limits.

    They are quintics, or cubics without accelerations. All are sampled together, in a millisecond:
    between samples, they are at most 0.01 % beyond a limit, and their efforts 0.2 %. The states are
    known far less precisely.
    """
    zero, (first, last) = np.zeros_like(q), _cubics(q, v, end, time)
    columns = np.concatenate(
        [
            [q, time * v, time**2 * begin, zero + end, zero, time**2 * final]
            for begin, final in ((a, zero), (first, last))
        ],
        axis=1,
    )
    samples = quintics(_SAMPLES, columns.reshape(6, -1), 3)
    samples = samples.reshape(4, len(_SAMPLES), -1, len(end))
    path, scales, slack = samples[0], time ** np.arange(4.0)[:, None], 1.0 + LIMIT_TOLERANCE
    peaks = np.abs(samples[1:]).max(axis=(1, 2))
    most = np.array([limits.velocity, limits.acceleration, limits.jerk])
    if not np.all(peaks <= slack * most * scales[1:]):
        return False
    lower, upper = reached_bounds(path, limits, path[0] - nearest_start(path[0], limits))
    if not (np.all(path >= lower - _ROUNDING) and np.all(path <= upper + _ROUNDING)):
        return False
    limited = np.isfinite(limits.effort)
    for step in (len(_SAMPLES) - 1, _EFFORT_STEP) if limited.any() else ():
        # Both ends first: most motions that exceed a limit do so there.
        some = samples[:3, ::step].reshape(3, -1, len(end)) / scales[:3, None]
        tau = robot.inverse_dynamics(*some)
        if not np.all(np.abs(tau[:, limited]) <= slack * limits.effort[limited]):
            return False
    return True


def _cubics(
    q: FloatArray, v: FloatArray, end: FloatArray, time: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Accelerations at both ends of the cubics from some states to rest."""
    mean = (end - q) / time
    return (6.0 * mean - 4.0 * v) / time, (2.0 * v - 6.0 * mean) / time
