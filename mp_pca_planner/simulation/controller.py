# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory controller with the semantics of ``joint_trajectory_controller`` (Jazzy).

It reproduces ros2_controllers 4.42 with position commands, measured positions and velocities, and
messages by topic or as goals of its action. A new trajectory replaces the running one at once:
``allow_trajectory_replacement``, which blends the two, is in later releases of ROS only. Times are
integer nanoseconds, as in ROS.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import SimulationError, quote_names, unknown_name
from ..recordings.joint_states import NS_PER_S
from .messages import BoolArray, Splines, States, TrajectoryMessage, TrajectoryPoint

_STANDSTILL = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class ControllerOptions:
    """Parameters of the controller; names and defaults are those of the original.

    Attributes
    ----------
    allow_nonzero_velocity_at_trajectory_end : bool
        Whether the last point may have a velocity.
    allow_partial_joints_goal : bool
        Whether joints may be missing; they hold their commanded positions.
    interpolate_from_desired_state : bool
        Whether the controller leads to the first point from its last command, not from the measured
        state.
    state_tolerance, goal_tolerance : float
        Largest deviation of a joint while moving, and at the end of the goal of an action
        [rad or m]; 0 allows any. Where the first is exceeded, the measured position is held.
    goal_time : float
        Time after the end by which a joint has to be there [s]; 0 waits for it.

    Raises
    ------
    SimulationError
        If a number is negative or not finite.
    """

    allow_nonzero_velocity_at_trajectory_end: bool = False
    allow_partial_joints_goal: bool = False
    interpolate_from_desired_state: bool = False
    state_tolerance: float = 0.0
    goal_tolerance: float = 0.0
    goal_time: float = 0.0

    def __post_init__(self) -> None:
        for name in ("state_tolerance", "goal_tolerance", "goal_time"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise SimulationError(f"{name} is {value}, expected a finite number from 0 on")


SUCCESSFUL, INVALID_GOAL = 0, -1
PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = -4, -5

SUCCEEDED, ABORTED, CANCELED = "succeeded", "aborted", "canceled"


@dataclass(frozen=True)
class GoalResult:
    """How a goal of the action ended.

    Attributes
    ----------
    goal : object
        Identifies the goal.
    outcome : {'succeeded', 'aborted', 'canceled'}
        The outcome.
    code : int
        The code of the action's result.
    message : str
        The text of the action's result.
    """

    goal: Hashable
    outcome: str
    code: int
    message: str


@dataclass(frozen=True, eq=False)
class ControllerState:
    """What the controller states of itself in every cycle.

    Attributes
    ----------
    time_ns : int
        Time of the cycle [ns].
    reference : array, shape (3, n_joints)
        State of the trajectory in this cycle: positions, velocities and accelerations by its own
        clock. The command leads it by one cycle.
    since_ns : int
        Time since the start of the trajectory by its own clock [ns].
    speed_scaling : float
        Speed of that clock.
    """

    time_ns: int
    reference: FloatArray
    since_ns: int
    speed_scaling: float


def rejection(
    message: TrajectoryMessage, joint_names: Sequence[str], now_ns: int, options: ControllerOptions
) -> str | None:
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
    options : ControllerOptions
        Parameters of the controller.
    """
    return (
        _wrong_joints(message.joint_names, joint_names, options.allow_partial_joints_goal)
        or ("the trajectory has no points" if not message.points else None)
        or (None if options.allow_nonzero_velocity_at_trajectory_end else _moving_end(message))
        or _ended(message, now_ns)
        or _wrong_times(message)
        or _wrong_numbers(message)
    )


def _wrong_joints(given: Sequence[str], expected: Sequence[str], allow_partial: bool) -> str | None:
    if not given or (len(given) != len(expected) and not allow_partial):
        return f"the trajectory has {len(given)} joints, the controller {len(expected)}"
    for name in given:
        if name not in expected:
            return unknown_name("joint of the controller", name, expected)
    repeated = sorted({name for name in given if list(given).count(name) > 1})
    # The original accepts these, but keeps the numbers of an older message for the other joints.
    return f"{quote_names(repeated)} given more than once" if repeated else None


def _moving_end(message: TrajectoryMessage) -> str | None:
    for name, v in zip(message.joint_names, message.points[-1].velocities, strict=False):
        if abs(v) > _STANDSTILL:
            return f"the last point moves joint '{name}' at {v:g} rad/s or m/s, expected 0"
    return None


def _ended(message: TrajectoryMessage, now_ns: int) -> str | None:
    late = now_ns - message.stamp_ns - message.points[-1].time_from_start_ns
    if message.stamp_ns == 0 or late <= 0:
        return None
    return f"the trajectory ended {late / NS_PER_S:g} s before it arrived"


def _wrong_times(message: TrajectoryMessage) -> str | None:
    times = [point.time_from_start_ns for point in message.points]
    for k, (before, after) in enumerate(pairwise(times)):
        if after <= before:
            return (
                f"the times of points {k} and {k + 1} are {before} and {after} ns, not increasing"
            )
    return None


def _wrong_numbers(message: TrajectoryMessage) -> str | None:
    n = len(message.joint_names)
    for k, point in enumerate(message.points):
        if len(point.positions) != n:
            return f"point {k} has {len(point.positions)} positions for {n} joints"
        for field in ("velocities", "accelerations"):
            length = len(getattr(point, field))
            if length not in (0, n):
                return f"point {k} has {length} {field} for {n} joints"
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
    options : ControllerOptions
        Its parameters.
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
    n_holds : int
        How often a tolerance was exceeded and the measured position held.
    results : list of GoalResult
        How goals of the action ended, the newest last.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        positions: FloatArray,
        options: ControllerOptions | None = None,
        continuous: FloatArray | None = None,
    ) -> None:
        self._names = tuple(joint_names)
        self._options = options or ControllerOptions()
        self._continuous = np.flatnonzero(() if continuous is None else continuous)
        self._command = np.concatenate([positions, np.zeros(2 * len(self._names))])
        self.speed_scaling = 1.0
        self.clock_ns = 0
        self.n_holds = 0
        self.results: list[GoalResult] = []
        self._goal: Hashable | None = None
        self._measured = positions
        self._commanded_ns = 0
        self.activate()

    def activate(self) -> None:
        """Start, as on activation: the commanded positions are held."""
        self._end_goal(ABORTED, INVALID_GOAL, "the controller was deactivated")
        n = len(self._names)
        self._command = np.concatenate([self._command[:n], np.zeros(2 * n)])
        self._new: TrajectoryMessage | None = None
        self._time = self._start = self._commanded_ns = 0
        self._is_holding = self.is_active = True
        values = self._command.reshape(1, 3, n)
        self._splines = Splines(States([0], values, np.ones((1, 3), dtype=bool)))

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
            self._new, self._is_holding = message, False
        if goal is not None and reason is None:
            self._end_goal(ABORTED, INVALID_GOAL, "another goal has replaced this one")
            self._goal = goal
        elif goal is not None:
            self.results.append(GoalResult(goal, ABORTED, INVALID_GOAL, str(reason)))
        return reason

    def rejection(self, message: TrajectoryMessage, now: int) -> str | None:
        """Why a message is rejected at a time [ns]; None if it is accepted."""
        reason = rejection(message, self._names, now, self._options)
        return reason if self.is_active or reason else "the controller is not active"

    def cancel(self, goal: Hashable) -> bool:
        """Cancel a goal of the action, and hold the measured position if it is the running one."""
        is_running = self._goal is not None and goal == self._goal
        if is_running:
            self._end_goal(CANCELED, SUCCESSFUL, "")
            self._hold(self._measured)
        return is_running

    def state(self, now: int) -> ControllerState:
        """What it states of itself in a cycle, whose time is given [ns]."""
        reference = self._splines.sample(self._time).reshape(3, -1)
        return ControllerState(now, reference, self._time - self._start, self.speed_scaling)

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
        if not self._is_holding and self._is_violated(measured[0], period, message is not None):
            self._end_goal(ABORTED, PATH_TOLERANCE_VIOLATED, "the path tolerance was violated")
            self._hold(measured[0])
            return self._command
        if self._goal is not None and self._time + period >= self._splines.end:
            self._judge_end(measured[0])
        # The command is to be reached by the next cycle.
        self._command = self._splines.sample(self._time + period)
        self._commanded_ns = now
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
            began = now
            if self._options.interpolate_from_desired_state:
                # The original dates its last command to the cycle in which it was given.
                before, began = self._command.reshape(3, -1).copy(), self._commanded_ns or now
            k = self._continuous
            before[0, k] = values[0, 0, k] - self._shorter(values[0, 0, k] - before[0, k])
            times.insert(0, began)
            values = np.concatenate([before[None], values])
            # The state before has accelerations if the first point has them.
            first = given[:1] | (np.arange(3) == 1)
            given = np.concatenate([first, given])
        self._splines = Splines(States(times, values, given))

    @staticmethod
    def _shorter(angle: FloatArray) -> FloatArray:
        """The same rotation of a continuous joint, by at most half a turn."""
        return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)

    def _in_order(self, message: TrajectoryMessage) -> tuple[FloatArray, BoolArray]:
        """The points by joints of the controller; joints that are missing hold their positions."""
        n, points = len(self._names), message.points
        index = [self._names.index(name) for name in message.joint_names]
        values = np.zeros((len(points), 3, n))
        values[:, 0] = self._command[:n]
        given = np.empty((len(points), 3), dtype=bool)
        for d, field in enumerate(("positions", "velocities", "accelerations")):
            rows = [getattr(point, field) for point in points]
            given[:, d] = has = np.array([len(row) > 0 for row in rows])
            if has.any():
                block = values[has]
                block[:, d, index] = [row for row in rows if len(row) > 0]
                values[has] = block
        return values, given

    def _is_violated(self, q: FloatArray, period: int, is_first: bool) -> bool:
        tolerance = self._options.state_tolerance
        if tolerance == 0.0 or not (self._time + period < self._splines.end or is_first):
            return False
        error = self._splines.sample(self._time)[: len(self._names)] - q
        error[self._continuous] = self._shorter(error[self._continuous])
        return bool(np.abs(error).max() > tolerance)

    def _judge_end(self, q: FloatArray) -> None:
        """End the running goal after the end of its trajectory, if its outcome is known."""
        options, error = self._options, self._splines.sample(self._time)[: len(self._names)] - q
        error[self._continuous] = self._shorter(error[self._continuous])
        late = (self._time - self._splines.end) / NS_PER_S
        if options.goal_tolerance == 0.0 or np.abs(error).max() <= options.goal_tolerance:
            self._end_goal(SUCCEEDED, SUCCESSFUL, "the end was reached")
            last, self._is_holding = self._splines.sample(self._splines.end), True
            fields = (tuple(row) for row in last.reshape(3, -1).tolist())
            self._new = TrajectoryMessage(self._names, (TrajectoryPoint(0, *fields),))
        elif 0.0 < options.goal_time < late:
            reason = f"the goal tolerance was violated {late:g} s after the end"
            self._end_goal(ABORTED, GOAL_TOLERANCE_VIOLATED, reason)
            self._hold(q)

    def _end_goal(self, outcome: str, code: int, message: str) -> None:
        goal, self._goal = self._goal, None
        if goal is not None:
            self.results.append(GoalResult(goal, outcome, code, message))

    def _hold(self, q: FloatArray) -> None:
        self._new = TrajectoryMessage(self._names, (TrajectoryPoint(0, tuple(q.tolist())),))
        self._is_holding = True
        self.n_holds += 1
