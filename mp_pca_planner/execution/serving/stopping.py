# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that bring a robot to rest within its limits.

A robot that follows its motion is slowed down along the path, which was checked. If its place on
the motion is unknown, a single point is sent. The controller leads there from its own state, in a
time that is long enough for every state it may have.

Among the stops within the limits, one without collisions is used. If none is known, the robot stops
with the least penetration: braking is safer than not braking.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from itertools import chain, islice

import numpy as np

from ...arrays import FloatArray, set_frozen
from ...exceptions import GoalError
from ...motion.collision import Collision
from ...motion.goal import JointState
from ...motion.interpolation import quintics
from ...motion.trajectory import Trajectory
from ...motion.validation import LIMIT_TOLERANCE, check_limits, nearest_start, reached_bounds
from ...planning.search.stop_and_go import brakes
from ...robot.limits import JointLimits
from ...robot.model import Robot
from ..options import Serving, Tracking
from ..tracking.following import Following, MotionFollower, UnconfirmedError
from ..tracking.measured import Clock
from ..tracking.published_motion import USUAL_TRANSPORT, PublishedMotion, hold
from ..tracking.start_state import TooLateError, choose_start, join
from .assembly import Model
from .surroundings import Surroundings

# Durations of stops [s]: 0.05 to 88 s; the shortest that the limits allow is used.
_STOPPING_TIMES: FloatArray = 0.05 * 1.2 ** np.arange(42.0)
_AT_ONCE = 7  # so many at a time: NumPy lets no other thread have the interpreter for small arrays
# Phases at which a motion to a single point is checked; its efforts at every fifth of them.
_SAMPLES: FloatArray = np.linspace(0.0, 1.0, 201)
_EFFORT_STEP = 5
_ROUNDING = 1e-9  # of positions [rad or m]


FoundStop = tuple[str, PublishedMotion, str]
"""What the robot does, as the begin of a sentence; the motion to publish; and text on the collision
that no stop avoids, empty if none is known."""


class StopPlanner:
    """Finds stops: along the path of a robot that follows its motion, else at a point.

    Parameters
    ----------
    follower :
        Tracks the robot.
    surroundings :
        Finds collisions of stops.
    clock :
        The clock of planning times [s].
    """

    def __init__(
        self,
        follower: MotionFollower,
        surroundings: Surroundings,
        clock: Clock,
    ) -> None:
        self._follower, self._surroundings, self._clock = follower, surroundings, clock

    def find(self, model: Model, late: float = 0.0) -> FoundStop:
        """Find a stop; again if a busy computer interrupted that, while the robot moved on.

        Parameters
        ----------
        model : Model
            The robot.
        late : float
            Time since a stop was sent that the controller has not taken [s]. Its message may be on
            its way for longer than the stop lasts, and is rejected then. The next one begins later.

        Raises
        ------
        GoalError
            If neither a measured nor a commanded state is known.
        """
        latency = max(Serving.stop_latency, 2.0 * late)
        for _ in range(Serving.max_attempts):
            began = self._clock()
            said, motion, collision = self._find(model, latency)
            took = self._clock() - began
            if took <= latency or not self._may_move(model):
                break
            latency = max(latency, min(2.0 * took, Serving.longest_stop_latency))
        return said, motion, collision

    def _may_move(self, model: Model) -> bool:
        """Whether the robot moves; without joint_states, whether its motion may be under way."""
        measured, seen = self._follower.measured, self._follower.commanded
        try:
            newest = measured.newest(model.settings.state_timeout, fetch=False)
        except GoalError:
            now = self._follower.motion_time
            return seen is not None and now < seen.motion.began + seen.motion.duration
        return bool(measured.velocities(newest).any())

    def _find(self, model: Model, latency: float) -> FoundStop:
        """A stop that begins this time from now at the earliest [s]."""
        follower = self._follower
        try:
            measured = follower.measured.newest(model.settings.state_timeout)
            following = follower.follow(model.settings, measured)
        except GoalError as error:
            return self._stop_silent(model, error)
        now = follower.motion_time
        if following is not None and following.is_running:
            with suppress(UnconfirmedError, TooLateError):
                return self._stop_on_path(model, latency, measured, following)
        with suppress(TooLateError):
            return self._stop_command(measured, model)
        v = follower.measured.velocities(measured)
        if following is None:
            return self._stop_unknown(measured, v, model)
        on_path = following.motion.state(following.progress.place)
        if following.is_over:
            return _holding(measured, on_path.positions, now, following.is_path_known)
        state = JointState(measured.joint_names, measured.positions, v)
        by_clock = following.motion.state(now - following.motion.began)
        ends = braking_ends(state) if v.any() else ends_at(state.positions - follower.servo.load)
        places = [state, on_path, by_clock, *follower.alternatives]

        def tried() -> Iterator[FloatArray]:
            yield ends
            yield ends_on_path(following.motion, following.progress.place)

        return self._stop_at_point(places, tried(), model)

    def _stop_command(self, measured: JointState, model: Model) -> FoundStop:
        """Stop from the command that the controller states, whatever motion that belongs to.

        Raises
        ------
        TooLateError
            If it is not known, or no stop from it is within the limits.
        """
        follower, settings = self._follower, model.settings
        command, now = follower.stated_command(measured, settings), follower.motion_time
        if command is None:
            raise TooLateError("the command is not known")
        if command.at_rest:
            return _holding(measured, command.state.positions, now)
        # Under way, a message ages: a stamped one advances with the clock meanwhile.
        is_timed = settings.stamp_trajectories and follower.measured.clock.is_usable
        is_timed = is_timed and command.rate > 0.5
        state = command.at(now if is_timed else now + USUAL_TRANSPORT)
        stops = brakes(model.robot, model.limits, state, settings.sample_period)
        clearest, collision = self._clearest(
            ([stop] for stop, check in stops if not check.violations), model
        )
        if clearest is None:
            raise TooLateError("no stop from the command is within the limits")
        stop = clearest[0]
        is_on_time = is_timed and abs(command.rate - 1.0) <= Tracking.full_rate
        motion = PublishedMotion.on_receipt(stop, now)
        if is_timed:
            motion = PublishedMotion(stop, now, stop, now, is_timed, is_on_time)
        said = f"the robot comes to rest off its path within {stop.duration:.3g} s"
        return said, motion, collision

    def _stop_unknown(self, measured: JointState, v: FloatArray, model: Model) -> FoundStop:
        """Stop a robot that follows no motion of this node: its state is estimated."""
        now, q = self._follower.motion_time, measured.positions
        if not v.any():
            return _holding(measured, q, now)
        # Since the measurement, the robot has moved at this velocity or a lower one.
        moved_by = v * max(now - self._follower.measured.newest_time, 0.0)
        here, *moved = [
            JointState(measured.joint_names, q + share * moved_by, v) for share in (0.0, 0.5, 1.0)
        ]
        # The controller itself starts from the reported velocities.
        reported = [measured] if measured.velocities.any() else []
        model = replace(model, limits=self._reduced(model.limits))
        ends = iter([braking_ends(moved[0])])
        return self._stop_at_point([here, *reported, *moved], ends, model)

    def _stop_on_path(
        self, model: Model, latency: float, measured: JointState, following: Following
    ) -> FoundStop:
        settings, follower = model.settings, self._follower
        seen = measured, following
        start = choose_start(follower, settings, latency, at_once=True, seen=seen)
        if start.following is None or not start.is_in_motion:
            raise TooLateError("the robot has just come to rest")
        motion, request = start.following.motion, (model.robot, model.limits)
        along = stop_on_path(motion, start.place, *request, settings.sample_period)
        # Where that collides, each joint stops as fast as it can.
        others = brakes(*request, start.state, settings.sample_period)
        off_path = (brake for brake, check in others if not check.violations)
        clearest, collision = self._clearest(([one] for one in chain([along], off_path)), model)
        assert clearest is not None
        stop = join(follower, clearest[0], start, settings)
        where = "on its path" if clearest[0] is along else "off its path"
        said = f"the robot comes to rest {where} within {stop.sent.duration:.3g} s"
        return said, stop, collision

    def _stop_silent(self, model: Model, error: GoalError) -> FoundStop:
        """Stop a robot that sends no joint_states, so it may be anywhere on its motion."""
        seen = self._follower.commanded
        if seen is None:
            raise error
        motion = seen.motion
        latest = max(self._follower.motion_time - motion.began, seen.place)
        # After its end, the robot is at one place.
        places = np.unique(np.minimum(np.linspace(seen.place, latest, 6), motion.duration))
        states = [motion.state(place) for place in places]
        moving = [state for state in states if np.any([state.velocities, state.accelerations])]
        resting = [JointState(state.joint_names, state.positions) for state in states]
        ends = iter([ends_on_path(motion, latest)])
        said, stop, collision = self._stop_at_point([*moving, *resting], ends, model)
        return f"{said}; it is not known whether the robot stops: {error}", stop, collision

    def _stop_at_point(
        self, states: list[JointState], ends: Iterator[FloatArray], model: Model
    ) -> FoundStop:
        """Stop at one of some ends, each of them by duration; they are tried in turn."""
        # From slightly outside the limits, a stop may only lead inwards.
        inward = (nearest_start(by_time, model.limits) for by_time in ends)
        request, first = (model.robot, model.limits), next(inward)
        every = chain([first], inward)
        found = (stop for one in every for stop in stops_at_points(states, one, *request))
        stop, collision = self._clearest(found, model)
        if stop is None:
            from_first = stops_at_points(states[:1], first, *request)
            stop, collision = self._clearest(from_first, model)
        if stop is not None:
            point = stop[0]
            said = f"the robot is sent to a single point, at rest within {point.duration:.3g} s"
        else:
            # A controller does the same when its goal is cancelled.
            point = hold(states[0].joint_names, states[0].positions)
            said = "no stop within the limits was found: the robot is sent to hold its position"
        sent = PublishedMotion.to_last_point(point, self._follower.motion_time)
        return said, sent, collision

    def _clearest(
        self, stops: Iterable[Sequence[Trajectory]], model: Model
    ) -> tuple[Sequence[Trajectory] | None, str]:
        """The first stop without a collision, else the one with the least penetration.

        Parameters
        ----------
        stops : iterable of sequence of Trajectory
            Motions to each stop.
        model : Model
            The robot.

        Returns
        -------
        stop : sequence of Trajectory or None
            The motions to the stop; None if there is no stop.
        collision : str
            Text on its collision; empty if none is known.
        """
        last = self._clock() + Serving.clearance_time
        best: Sequence[Trajectory] | None = None
        met: Collision | None = None
        for stop in islice(stops, Serving.max_stops):
            found = self._surroundings.collision_of(stop, model)
            if found is None:
                return stop, ""
            if met is None or found.penetration < met.penetration:
                best, met = stop, found
            if self._clock() > last:
                break
        return best, f"no stop without a collision was found: {met}" if met else ""

    def _reduced(self, limits: JointLimits) -> JointLimits:
        """Limits with a margin for errors of an estimated state."""
        reduced = copy(limits)
        acceleration = Serving.acceleration_share * limits.acceleration
        set_frozen(reduced, acceleration=acceleration, jerk=Serving.jerk_share * limits.jerk)
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


def ends_at(positions: FloatArray) -> FloatArray:
    """The same end, for each duration of a stop."""
    return np.broadcast_to(positions, (len(_STOPPING_TIMES), len(positions)))


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
    # The largest first: each operation on all samples lets another thread have the interpreter.
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


def _holding(
    measured: JointState, positions: FloatArray, now: float, is_certain: bool = True
) -> FoundStop:
    """The stop of a robot at rest, and whether it is certain that it rests there."""
    held = hold(measured.joint_names, positions)
    send = PublishedMotion.on_receipt if is_certain else PublishedMotion.to_last_point
    return "the robot is at rest and holds its position", send(held, now), ""
