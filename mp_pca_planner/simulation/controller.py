# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory controller with the semantics of ``joint_trajectory_controller`` (Jazzy).

It reproduces ros2_controllers 4.42 with position commands, measured positions and velocities, and
messages by topic. Times are integer nanoseconds, as in ROS.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from .message import TrajectoryMessage, TrajectoryPoint
from .rejection import ControllerOptions, rejection
from .splines import BoolArray, Splines, States


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
        How often the tolerance was exceeded and the measured position held.
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
        self.activate()

    def activate(self) -> None:
        """Start, as on activation: the commanded positions are held."""
        n = len(self._names)
        self._command = np.concatenate([self._command[:n], np.zeros(2 * n)])
        self._new: TrajectoryMessage | None = None
        self._time = 0
        self._is_holding = self.is_active = True
        values = self._command.reshape(1, 3, n)
        self._splines = Splines(States([0], values, np.ones((1, 3), dtype=bool)))

    def deactivate(self) -> None:
        """Drop the trajectory; the commanded positions stay."""
        self.activate()
        self.is_active = False

    def receive(self, message: TrajectoryMessage, now: int) -> str | None:
        """Take a message, which replaces the trajectory in the next cycle.

        Parameters
        ----------
        message : TrajectoryMessage
            The message.
        now : int
            The present time [ns].

        Returns
        -------
        reason : str or None
            Why it is rejected; None if it is accepted.
        """
        reason = rejection(message, self._names, now, self._options)
        if reason is None and not self.is_active:
            reason = "the controller is not active"
        if reason is None:
            self._new, self._is_holding = message, False
        return reason

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
        if message is not None:
            self._adopt(message, measured)
        if not self._is_holding and self._is_violated(measured[0], period, message is not None):
            self._hold(measured[0])
            return self._command
        # The command is to be reached by the next cycle.
        self._command = self._splines.sample(self._time + period)
        return self._command

    def _adopt(self, message: TrajectoryMessage, measured: tuple[FloatArray, FloatArray]) -> None:
        """Interpolate the points, and from the measured state to the first of them."""
        start = message.stamp_ns or self._time
        times = [start + point.time_from_start_ns for point in message.points]
        values, given = self._in_order(message)
        if self._time < times[0]:
            before = np.stack([*measured, np.zeros_like(measured[0])])
            k = self._continuous
            before[0, k] = values[0, 0, k] - self._shorter(values[0, 0, k] - before[0, k])
            times.insert(0, self._time)
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

    def _hold(self, q: FloatArray) -> None:
        self._new = TrajectoryMessage(self._names, (TrajectoryPoint(0, tuple(q.tolist())),))
        self._is_holding = True
        self.n_holds += 1
