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
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_limits, nearest_start
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .assembly import Model
from .following import UnconfirmedError
from .measured import Clock
from .options import ServingOptions
from .published_motion import Joined, PublishedMotion, hold
from .start_state import StartStates, TooLateError

# Durations of stops [s]: 0.05 to 88 s; the shortest that the limits allow is used.
_STOPPING_TIMES: FloatArray = 0.05 * 1.2 ** np.arange(42.0)


class StopPlanner:
    """Finds stops: along the path of a robot that follows its motion, else at a point.

    Parameters
    ----------
    states :
        Source of the robot's state.
    clock :
        The clock of planning times [s].
    options :
        Parameters.
    """

    def __init__(
        self, states: StartStates, clock: Clock, options: ServingOptions | None = None
    ) -> None:
        self._states, self._clock = states, clock
        self._options = options or ServingOptions()

    def find(self, model: Model) -> tuple[str, Joined]:
        """Find a stop; again if a busy computer interrupted that, while the robot moved on.

        Returns
        -------
        message : str
            Description of the stop, one sentence.
        joined : Joined
            The motion to publish.

        Raises
        ------
        GoalError
            If neither a measured nor a commanded state is known.
        """
        for _ in range(self._options.max_attempts):
            began = self._clock()
            found = self._find(model)
            if self._clock() - began <= self._options.stop_latency:
                break
        return found

    def _find(self, model: Model) -> tuple[str, Joined]:
        states = self._states
        try:
            measured = states.measured.newest(model.settings.state_timeout)
            following = states.follow(model.settings)
        except GoalError as error:
            return self._stop_silent(model, error)
        now = states.motion_time
        if following is not None and following.is_running:
            with suppress(UnconfirmedError, TooLateError):
                return self._stop_on_path(model)
        v = states.measured.velocities(measured)
        if following is None:
            return self._stop_unknown(measured, v, model)
        on_path = following.motion.state(following.progress.place)
        if following.is_over:
            return _holding(measured, on_path.positions, now, following.is_path_known)
        state = JointState(measured.joint_names, measured.positions, v)
        by_clock = following.motion.state(now - following.motion.began)
        ends = braking_ends(state) if v.any() else ends_at(state.positions - states.load_offset)
        places = [state, on_path, by_clock, *states.alternatives]
        return self._stop_at_point(places, ends, model)

    def _stop_unknown(
        self, measured: JointState, v: FloatArray, model: Model
    ) -> tuple[str, Joined]:
        """Stop a robot that follows no motion of this node: its state is estimated."""
        now, q = self._states.motion_time, measured.positions
        if not v.any():
            return _holding(measured, q, now)
        # Since the measurement, the robot has moved at this velocity or a lower one.
        moved_by = v * max(now - self._states.measured.newest_time, 0.0)
        here, *moved = [
            JointState(measured.joint_names, q + share * moved_by, v) for share in (0.0, 0.5, 1.0)
        ]
        # The controller itself starts from the reported velocities.
        reported = [measured] if measured.velocities.any() else []
        model = replace(model, limits=self._reduced(model.limits))
        return self._stop_at_point([here, *reported, *moved], braking_ends(moved[0]), model)

    def _stop_on_path(self, model: Model) -> tuple[str, Joined]:
        settings, states = model.settings, self._states
        start = states.choose(settings, self._options.stop_latency, at_once=True)
        if start.following is None or not start.is_in_motion:
            raise TooLateError("the robot has just come to rest")
        motion, period = start.following.motion, settings.sample_period
        stop = stop_on_path(motion, start.place, model.robot, model.limits, period)
        joined = states.join(stop, start, settings)
        duration = joined.trajectory.duration
        return f"the robot comes to rest on its path within {duration:.3g} s", joined

    def _stop_silent(self, model: Model, error: GoalError) -> tuple[str, Joined]:
        """Stop a robot that sends no joint_states, so it may be anywhere on its motion."""
        motion, seen = self._states.commanded, self._states.last_place
        if motion is None:
            raise error
        latest = max(self._states.motion_time - motion.began, seen)
        places = np.linspace(seen, latest, 6)
        moving = [motion.state(place) for place in places]
        resting = [JointState(state.joint_names, state.positions) for state in moving]
        ends = ends_on_path(motion, float(places[-1]))
        said, joined = self._stop_at_point([*moving, *resting], ends, model)
        return f"{said}; it is not known whether the robot stops: {error}", joined

    def _stop_at_point(
        self, states: list[JointState], ends: Sequence[FloatArray], model: Model
    ) -> tuple[str, Joined]:
        # From slightly outside the limits, a stop may only lead inwards.
        ends = [nearest_start(end, model.limits) for end in ends]
        request = ends, model.robot, model.limits
        stop = stop_at_point(states, *request) or stop_at_point(states[:1], *request)
        if stop is not None:
            said = f"the robot is sent to a single point, at rest within {stop.duration:.3g} s"
        else:
            # A controller does the same when its goal is cancelled.
            stop = hold(states[0].joint_names, states[0].positions)
            said = "no stop within the limits was found: the robot is sent to hold its position"
        return said, Joined.to_last_point(stop, self._states.motion_time)

    def _reduced(self, limits: JointLimits) -> JointLimits:
        """Limits with a margin for errors of an estimated state."""
        columns = {
            "min_position": limits.lower,
            "max_position": limits.upper,
            "max_velocity": limits.velocity,
            "max_acceleration": self._options.acceleration_share * limits.acceleration,
            "max_jerk": self._options.jerk_share * limits.jerk,
            "max_effort": limits.effort,
        }
        names = limits.joint_names
        by_joint = {
            name: {key: values[j] for key, values in columns.items()}
            for j, name in enumerate(names)
        }
        return JointLimits(names, by_joint)


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
    """The end of the smoothest stop of a moving robot, for each duration of a stop.

    For this end, the controller's quintic is the quartic of least jerk. Without an initial
    acceleration, its cubic has a constant deceleration.
    """
    q, v, a = state.positions, state.velocities, state.accelerations
    return [q + v * time / 2.0 + a * time**2 / 12.0 for time in _STOPPING_TIMES]


def ends_at(positions: FloatArray) -> list[FloatArray]:
    """The same end, for each duration of a stop."""
    return [positions] * len(_STOPPING_TIMES)


def ends_on_path(motion: PublishedMotion, place: float) -> list[FloatArray]:
    """The end of a constant deceleration along a motion, for each duration of a stop."""
    q, _, _ = motion.sample(np.asarray(place + 0.5 * _STOPPING_TIMES))
    return list(q)


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
    last = Trajectory(old.joint_names, [0.0], *(x[-1:] for x in old.states))
    return motion.followed_by(last, old.duration, place)


def _interpolated(state: JointState, end: FloatArray, time: float) -> list[Trajectory]:
    """The controller's motion to a single point: a quintic, or a cubic without accelerations."""
    q, v, a = state.positions, state.velocities, state.accelerations
    zero = np.zeros_like(q)
    mean = (end - q) / time
    cubic = [(6.0 * mean - 4.0 * v) / time, (2.0 * v - 6.0 * mean) / time]
    return [
        Trajectory(state.joint_names, [0.0, time], [q, end], [v, zero], accelerations)
        for accelerations in ([a, zero], cubic)
    ]


def _holding(
    measured: JointState, positions: FloatArray, now: float, is_certain: bool = True
) -> tuple[str, Joined]:
    """The stop of a robot at rest, and whether it is certain that it rests there."""
    held = hold(measured.joint_names, positions)
    joined = Joined.on_receipt(held, now) if is_certain else Joined.to_last_point(held, now)
    return "the robot is at rest and holds its position", joined
