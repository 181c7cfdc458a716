# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory controller with the semantics of ``joint_trajectory_controller`` (Jazzy).

It reproduces ros2_controllers 4.42 with its default parameters, with position commands, measured
positions and velocities, and messages by topic or as goals of its action. A new trajectory replaces
the running one at once: ``allow_trajectory_replacement``, which blends the two, is in later
releases of ROS only. Times are integer nanoseconds, as in ROS.

The points of a message determine the degree of the polynomials through them. The code has nothing
from :mod:`mp_pca_planner.motion.interpolation`, so that the simulation reveals errors there.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ..arrays import FloatArray, repeated_names
from ..exceptions import quote_names, unknown_name
from ..motion.trajectory import Trajectory
from ..recordings.joint_states import NS_PER_S

BoolArray = NDArray[np.bool_]

_STANDSTILL = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class TrajectoryPoint:
    """One point of a message; every sequence holds one number per joint, or is empty.

    Attributes
    ----------
    time_from_start_ns : int
        Time since the start of the trajectory [ns].
    positions, velocities, accelerations, effort : sequence of float
        Joint positions [rad or m], their derivatives [/s, /s²], torques [N·m] or forces [N].
    """

    time_from_start_ns: int
    positions: Sequence[float] = ()
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    effort: Sequence[float] = ()


@dataclass(frozen=True)
class TrajectoryMessage:
    """A message as it is received, without any check.

    Attributes
    ----------
    joint_names : tuple of str
        Joints in the order of the numbers of every point.
    points : tuple of TrajectoryPoint
        The points.
    stamp_ns : int
        Time at which the trajectory starts [ns]; 0 means on arrival.
    """

    joint_names: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]
    stamp_ns: int = 0


def to_message(
    trajectory: Trajectory, stamp: float | None = None, *, last_point_only: bool = False
) -> TrajectoryMessage:
    """Message of a trajectory, with positions, velocities and accelerations on every point.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    stamp : float, optional
        Time at which it starts [s]; on arrival unless given.
    last_point_only : bool
        Whether only the last point is sent, to which the controller interpolates by itself.
    """
    rows = zip(
        (trajectory.times * NS_PER_S).round().astype(int).tolist(),
        trajectory.positions.tolist(),
        trajectory.velocities.tolist(),
        trajectory.accelerations.tolist(),
        strict=True,
    )
    points = tuple(TrajectoryPoint(*row) for row in rows)
    return TrajectoryMessage(
        trajectory.joint_names,
        points[-1:] if last_point_only else points,
        0 if stamp is None else round(stamp * NS_PER_S),
    )


def _to_coefficients(n_derivatives: int) -> FloatArray:
    """Takes values and derivatives at phases 0 and 1 to coefficients by rising power."""
    degree = 2 * n_derivatives - 1
    rows = [
        polynomial.polyval(phase, polynomial.polyder(np.eye(degree + 1), d))
        for phase in (0.0, 1.0)
        for d in range(n_derivatives)
    ]
    return np.asarray(np.linalg.inv(rows))


_CUBIC, _QUINTIC = _to_coefficients(2), _to_coefficients(3)


def splines(
    times_ns: list[int], values: FloatArray, given: BoolArray
) -> Callable[[int], FloatArray]:
    """Interpolate states, and hold the last one.

    Parameters
    ----------
    times_ns : list of int
        Increasing times [ns], n_points of them.
    values : array, shape (n_points, 3, n_joints)
        Positions [rad or m], velocities [/s] and accelerations [/s²]; 0 where none are given.
    given : array of bool, shape (n_points, 3)
        Which of them are given.

    Returns
    -------
    sample : callable
        Returns positions, velocities and accelerations at a time [ns] in a row, shape
        (3 n_joints,).
    """
    last: FloatArray = values[-1].ravel()
    steps = np.diff(np.array(times_ns))
    lengths = steps.tolist()
    seconds: FloatArray = steps * 1e-9
    coefficients = list(_polynomials(seconds, values, given))

    def sample(time_ns: int) -> FloatArray:
        if time_ns >= times_ns[-1]:
            return last
        k = bisect_right(times_ns, time_ns) - 1
        u = (time_ns - times_ns[k]) / lengths[k]
        u2 = u * u
        powers = np.array((1.0, u, u2, u2 * u, u2 * u2, u2 * u2 * u))
        return np.asarray(powers @ coefficients[k])

    return sample


def _polynomials(lengths: FloatArray, values: FloatArray, given: BoolArray) -> FloatArray:
    """Coefficients by rising power of the phase, shape (n_segments, 6, 3 n_joints)."""
    # The last axis holds those of the positions, velocities and accelerations.
    n_segments, n_joints = len(lengths), values.shape[2]
    _, has_v, has_a = (given[:-1] & given[1:]).T
    scale = np.stack([np.ones_like(lengths), lengths, lengths**2], axis=1)[:, :, None]
    begin, end = values[:-1] * scale, values[1:] * scale
    # Accelerations without velocities: the controller does not interpolate, and commands 0.
    result = np.zeros((n_segments, 6, 3, n_joints))
    q = result[:, :, 0]
    linear = ~has_v & ~has_a
    q[linear, 0], q[linear, 1] = begin[linear, 0], (end - begin)[linear, 0]
    for kind, matrix in ((has_v & ~has_a, _CUBIC), (has_v & has_a, _QUINTIC)):
        n = len(matrix)
        ends = np.concatenate([begin[kind, : n // 2], end[kind, : n // 2]], axis=1)
        q[kind, :n] = matrix @ ends
    factors = np.arange(1.0, 6.0)[:, None]
    for d in (1, 2):
        result[:, :5, d] = result[:, 1:, d - 1] * factors / lengths[:, None, None]
    return np.asarray(result.reshape(n_segments, 6, 3 * n_joints))


SUCCEEDED, ABORTED, CANCELED = "succeeded", "aborted", "canceled"

RESULT_CODES = {SUCCEEDED: 0, ABORTED: -1, CANCELED: 0}
"""The code of the action's result by the outcome of a goal: SUCCESSFUL or INVALID_GOAL."""


def rejection(message: TrajectoryMessage, joint_names: Sequence[str], now_ns: int) -> str | None:
    """Why a message is rejected, as a sentence; None if it is accepted.

    Numbers that are not finite are accepted, as by the original.

    Parameters
    ----------
    message : TrajectoryMessage
        The message.
    joint_names : sequence of str
        Joints of the controller.
    now_ns : int
        The present time [ns].
    """
    names, points = message.joint_names, message.points
    if len(names) != len(joint_names):
        return f"the trajectory has {len(names)} joints, the controller {len(joint_names)}"
    for name in names:
        if name not in joint_names:
            return unknown_name("joint of the controller", name, joint_names)
    # The original accepts these, but keeps the numbers of an older message for the other joints.
    if repeated := repeated_names(names):
        return f"{quote_names(repeated)} given more than once"
    if not points:
        return "the trajectory has no points"
    for name, v in zip(names, points[-1].velocities, strict=False):
        if abs(v) > _STANDSTILL:
            return f"the last point moves joint '{name}' at {v:g} rad/s or m/s, expected 0"
    late = now_ns - message.stamp_ns - points[-1].time_from_start_ns
    if message.stamp_ns and late > 0:
        return f"the trajectory ended {late / NS_PER_S:g} s before it arrived"
    times = [point.time_from_start_ns for point in points]
    for k, (before, after) in enumerate(pairwise(times)):
        if after <= before:
            return (
                f"the times of points {k} and {k + 1} are {before} and {after} ns, not increasing"
            )
    for k, point in enumerate(points):
        for field in ("positions", "velocities", "accelerations"):
            length = len(getattr(point, field))
            if length != len(names) and (length or field == "positions"):
                return f"point {k} has {length} {field} for {len(names)} joints"
        if len(point.effort) > 0:
            return f"point {k} has efforts, but the controller has no effort interface"
    return None


class TrajectoryController:
    """Commands positions from the messages that it receives, cycle by cycle.

    Parameters
    ----------
    joint_names : sequence of str
        Joints of the controller, n_joints of them.
    positions : array, shape (n_joints,)
        Positions to hold [rad or m].
    continuous : array of bool, shape (n_joints,), optional
        Joints that turn without end; none unless given.

    Attributes
    ----------
    speed_scaling : float
        Speed of the trajectory's clock, 1 for that of the world.
    clock_ns : int
        Time for which commands have advanced along trajectories [ns].
    is_active : bool
        Whether commands follow messages.
    results : list of (object, str, str)
        What identifies each goal of the action that ended, its outcome, a key of `RESULT_CODES`,
        and the text of the action's result; the newest last.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        positions: FloatArray,
        continuous: FloatArray | None = None,
    ) -> None:
        self._names = tuple(joint_names)
        self._continuous = np.flatnonzero(() if continuous is None else continuous)
        self._command = np.concatenate([positions, np.zeros(2 * len(self._names))])
        self.speed_scaling = 1.0
        self.clock_ns = 0
        self.results: list[tuple[Hashable, str, str]] = []
        self._goal: Hashable | None = None
        self._measured = positions
        self.activate()

    def activate(self) -> None:
        """Start, as on activation: the commanded positions are held."""
        self._end_goal(ABORTED, "the controller was deactivated")
        n = len(self._names)
        self._command = np.concatenate([self._command[:n], np.zeros(2 * n)])
        self._new: TrajectoryMessage | None = None
        self._time = self._start = 0
        self.is_active = True
        self._end = 0  # time of the last point
        self._sample = splines([0], self._command.reshape(1, 3, n), np.ones((1, 3), dtype=bool))

    def deactivate(self) -> None:
        """Drop the trajectory; the commanded positions stay."""
        self.activate()
        self.is_active = False

    def receive(
        self, message: TrajectoryMessage, now: int, goal: Hashable | None = None
    ) -> str | None:
        """Take a message, which replaces the trajectory in the next cycle.

        Parameters
        ----------
        message : TrajectoryMessage
            The message.
        now : int
            The present time [ns].
        goal : hashable, optional
            Identifies the goal of the action that it is; it aborts the one before. A message by
            topic leaves the running goal as it is.

        Returns
        -------
        reason : str or None
            Why it is rejected; None if it is accepted.
        """
        reason = self.rejection(message, now)
        if reason is None:
            self._new = message
        if goal is not None and reason is None:
            self._end_goal(ABORTED, "another goal has replaced this one")
            self._goal = goal
        elif goal is not None:
            self.results.append((goal, ABORTED, str(reason)))
        return reason

    def rejection(self, message: TrajectoryMessage, now: int) -> str | None:
        """Why a message is rejected at a time [ns]; None if it is accepted."""
        reason = rejection(message, self._names, now)
        return reason if self.is_active or reason else "the controller is not active"

    def cancel(self, goal: Hashable) -> bool:
        """Cancel a goal of the action, and hold the measured position if it is the running one."""
        is_running = self._goal is not None and goal == self._goal
        if is_running:
            self._end_goal(CANCELED, "")
            held = TrajectoryPoint(0, tuple(self._measured.tolist()))
            self._new = TrajectoryMessage(self._names, (held,))
        return is_running

    def stated(self) -> tuple[FloatArray, int]:
        """What it states of itself in this cycle.

        Returns
        -------
        reference : array, shape (3, n_joints)
            State of the trajectory: positions, velocities and accelerations by its own clock, whose
            speed is `speed_scaling`. The command leads it by one cycle.
        since_ns : int
            Time since the start of the trajectory by that clock [ns].
        """
        return self._sample(self._time).reshape(3, -1), self._time - self._start

    def update(self, now: int, period: int, measured: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Run one cycle.

        Parameters
        ----------
        now, period : int
            The present time, and that since the last cycle [ns].
        measured : tuple of two arrays, shape (n_joints,)
            Measured positions [rad or m] and velocities [/s].

        Returns
        -------
        command : array, shape (3 n_joints,)
            Positions to reach by the next cycle, then the velocities and accelerations of the
            trajectory there, by its own clock.
        """
        if not self.is_active:
            self.clock_ns += period
            return self._command
        message, self._new = self._new, None
        step = int(period * self.speed_scaling) if message is None else period
        self._time = now if message is not None else self._time + step
        self.clock_ns += step
        self._measured = measured[0]
        if message is not None:
            self._adopt(message, now, measured)
        if self._goal is not None and self._time + period >= self._end:
            self._end_goal(SUCCEEDED, "the end was reached")
            fields = self._sample(self._end).reshape(3, -1).tolist()
            self._new = TrajectoryMessage(self._names, (TrajectoryPoint(0, *fields),))
        # The command is to be reached by the next cycle.
        self._command = self._sample(self._time + period)
        return self._command

    def _adopt(
        self, message: TrajectoryMessage, now: int, measured: tuple[FloatArray, FloatArray]
    ) -> None:
        """Interpolate the points, and from the state before to the first of them."""
        self._start = start = message.stamp_ns or self._time
        times = [start + point.time_from_start_ns for point in message.points]
        values, given = self._in_order(message)
        if self._time < times[0]:
            before = np.stack([*measured, np.zeros_like(measured[0])])
            # Continuous joints turn by at most half a turn.
            k = self._continuous
            turn = values[0, 0, k] - before[0, k]
            before[0, k] = values[0, 0, k] - (np.remainder(turn + np.pi, 2 * np.pi) - np.pi)
            times.insert(0, now)
            values = np.concatenate([before[None], values])
            # The state before has accelerations if the first point has them.
            first = given[:1] | (np.arange(3) == 1)
            given = np.concatenate([first, given])
        self._end, self._sample = times[-1], splines(times, values, given)

    def _in_order(self, message: TrajectoryMessage) -> tuple[FloatArray, BoolArray]:
        """The values of the points by joints of the controller, and which are given."""
        n = len(message.points)
        values, given = np.zeros((n, 3, len(self._names))), np.zeros((n, 3), dtype=bool)
        for k, point in enumerate(message.points):
            for d, row in enumerate((point.positions, point.velocities, point.accelerations)):
                if len(row) > 0:
                    values[k, d], given[k, d] = row, True
        index = [message.joint_names.index(name) for name in self._names]
        return values[:, :, index], given

    def _end_goal(self, outcome: str, message: str) -> None:
        goal, self._goal = self._goal, None
        if goal is not None:
            self.results.append((goal, outcome, message))
