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
from ..motion.trajectory import Trajectory
from ..motion.validation import check_limits, nearest_start
from ..planning.search.stop_and_go import brakes
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .motions import TRANSPORT, USUAL_TRANSPORT, PublishedMotion
from .parameters import Settings
from .tracking import TooLateError, Tracker, Where, continued

LATENCY = 0.02
"""Time to find a stop, from whose end on it begins [s]."""

# The shortest stop [s]; the durations of stops along a path, 0.05 to 88 s, and those of stops at a
# point in the shortest one that may do: the first that the limits allow is used.
_SHORTEST = 0.05
_STOPPING_TIMES: FloatArray = _SHORTEST * 1.2 ** np.arange(42.0)
_LONGER = 1.3 ** np.arange(28.0)
# Phases of a stop at a point that are compared with limits, and the share of a limit above which
# that alone decides.
_PHASES: FloatArray = np.linspace(0.0, 1.0, 21)
_CLEARLY = 1.01

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
    if isinstance(where, GoalError):
        return _silent_stop(where, tracker, robot, limits)
    following, command, now = where.following, where.command, where.now
    names = where.measured.state.joint_names
    is_on_path = following is not None and following.motion.is_path_known and following.is_running
    if is_on_path and not leaves_path:
        try:
            return _stop_along(where, robot, limits, settings, time_left)
        except TooLateError:
            pass
    if command is not None and not command.at_rest:
        # Under way, a message ages: a stamped one advances with the clock meanwhile.
        is_timed = where.may_stamp and command.rate > 0.5
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
        return said, PublishedMotion.on_receipt(Trajectory.at_rest(names, held), now)
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
    joined = continued(stop, place, following, now, stamp=where.may_stamp)
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
    for states in (possible, possible[:1]):
        if (stop := stop_at_point(states, end_after, robot, limits)) is not None:
            said = f"the robot is sent to a single point, at rest within {stop.duration:.3g} s"
            return said, PublishedMotion.to_last_point(stop, now)
    # A controller does the same when its goal is cancelled.
    stop = Trajectory.at_rest(possible[held].joint_names, possible[held].positions)
    said = "no stop within the limits was found: the robot is sent to hold its position"
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
    zero = np.zeros_like(v)
    # Peaks of the quintic to the end of an even deceleration.
    speed = np.abs(v)
    peaks = np.max(1.5 * speed / limits.acceleration), np.sqrt(np.max(6.0 * speed / limits.jerk))
    for time in max(_SHORTEST, *map(float, peaks)) * _LONGER:
        # From slightly outside the limits, a stop may only lead inwards.
        end = nearest_start(end_after(time), limits)
        # A controller without accelerations leads there by a cubic.
        ways = [
            PublishedMotion(Trajectory(names, [0.0, time], q, [one.velocities, zero], a), 0.0)
            for one in possible
            for q in ([one.positions, end],)
            for a in ([one.accelerations, zero], _cubic(one, end, time))
        ]
        if all(_keeps(way, robot, limits) for way in ways):
            return ways[0].trajectory
    return None


def _keeps(way: PublishedMotion, robot: Robot, limits: JointLimits) -> bool:
    """Whether a motion of two points keeps the limits."""
    times = way.duration * _PHASES
    q, v, a = way.sample(times)
    # A few samples show what most motions break: the check takes longer, and the node waits.
    bounds = (v, limits.velocity), (a, limits.acceleration)
    if any(np.any(np.abs(x) > _CLEARLY * most) for x, most in bounds):
        return False
    if np.any(q > np.maximum(q[0], limits.upper)) or np.any(q < np.minimum(q[0], limits.lower)):
        return False
    if np.any(np.abs(robot.inverse_dynamics(q, v, a)) > _CLEARLY * limits.effort):
        return False
    # Between close points, most of it is far from its limits, and need not be sampled.
    dense = Trajectory(way.trajectory.joint_names, times, q, v, a)
    return not check_limits(dense, robot, limits).violations


def _cubic(state: JointState, end: FloatArray, time: float) -> list[FloatArray]:
    """Accelerations at both ends of the cubic from a state to rest."""
    mean, v = (end - state.positions) / time, state.velocities
    return [(6.0 * mean - 4.0 * v) / time, (2.0 * v - 6.0 * mean) / time]


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
        return Trajectory.at_rest(motion.trajectory.joint_names, motion.end)
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
