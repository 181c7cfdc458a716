# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What joint_trajectory_controller does with a message, written from its documentation.

ros2_controllers (Jazzy), joint_trajectory_controller: "Trajectory Representation" (quintic spline
where positions, velocities and accelerations are given, the last point is held), "Trajectory
Replacement" (a new message takes the place of the old one at once), and the parameters
``allow_partial_joints_goal`` and ``allow_nonzero_velocity_at_trajectory_end``, both false by
default. Nothing of this package is used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RefusedMessageError(AssertionError):
    """The controller would not execute the message."""


class Controller:
    """Commands positions, velocities and accelerations in cycles of 1 ms.

    `replaced` are the indices of the first commands of each accepted message.
    """

    def __init__(self, joint_names: Sequence[str], positions: Array, now: float) -> None:
        self.period = 1e-3
        self.now = now
        self.replaced: list[int] = []
        self._joint_names = list(joint_names)
        zero = np.zeros(len(joint_names))
        rest = np.array([[positions, zero, zero]])
        self._commands = [rest]
        self._n_commands = 1
        self._start, self._knots, self._states = now, np.array([0.0]), rest

    @property
    def state(self) -> Array:
        """Position, velocity and acceleration commanded last, shape (3, n_joints)."""
        return self._commands[-1][-1]

    def commands(self) -> Array:
        """All that was commanded, shape (n_cycles, 3, n_joints)."""
        return np.concatenate(self._commands)

    def receive(self, message: Any, now: float) -> None:
        """Replace the running trajectory in the first cycle from now on."""
        times, states = self._accepted(message)
        self.run_until(now)
        tick = self.now + self.period
        if times[0] > 0.0:
            # The way from the present state to the first point.
            before = self._sample(np.array([tick]))
            times, states = np.append(0.0, times), np.concatenate([before, states])
        self._start, self._knots, self._states = tick, times, states
        self.replaced.append(self._n_commands)
        self.run_until(tick)

    def run_until(self, time: float) -> None:
        """Command up to a time."""
        n = int(np.floor((time - self.now) / self.period + 1e-6))
        if n >= 1:
            self._commands.append(self._sample(self.now + self.period * np.arange(1, n + 1)))
            self._n_commands += n
            self.now += n * self.period

    def _sample(self, ticks: Array) -> Array:
        """States at these times, shape (n_ticks, 3, n_joints)."""
        since = ticks - self._start
        last = len(self._knots) - 1
        k = np.searchsorted(self._knots, since, side="right") - 1
        held = np.stack([self._states[-1, 0], *np.zeros((2, len(self._joint_names)))])
        result = np.repeat(held[None], len(ticks), axis=0)
        inside = (k >= 0) & (k < last)
        k, t = k[inside], (since[inside] - self._knots[k[inside]])
        if len(k):
            result[inside] = _quintic(
                self._states[k], self._states[k + 1], np.diff(self._knots)[k], t
            )
        return result

    def _accepted(self, message: Any) -> tuple[Array, Array]:
        points = message.points
        if not points:
            raise RefusedMessageError("empty trajectory")
        if sorted(message.joint_names) != sorted(self._joint_names):
            raise RefusedMessageError("not exactly the joints of the controller")
        if message.header.stamp.sec or message.header.stamp.nanosec:
            raise RefusedMessageError("this controller's clock is not known to the sender")
        times = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in points])
        if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
            raise RefusedMessageError("times that don't increase")
        if any(len(p.effort) for p in points):
            raise RefusedMessageError("efforts without an effort interface")
        states = np.array([[p.positions, p.velocities, p.accelerations] for p in points])
        if states.shape != (len(points), 3, len(self._joint_names)):
            raise RefusedMessageError("not a number for each joint")
        if not np.isfinite(states).all():
            raise RefusedMessageError("numbers that are not finite")
        if np.any(states[-1, 1] != 0.0):
            raise RefusedMessageError("a velocity at the end")
        order = [message.joint_names.index(name) for name in self._joint_names]
        return times, states[:, :, order]


def _quintic(begin: Array, end: Array, duration: Array, t: Array) -> Array:
    """Fifth-order polynomials through states, by the six linear equations of their coefficients.

    begin, end: shape (n, 3, n_joints); duration, t: shape (n,).
    """
    # In shares of the duration, which keeps the equations well-conditioned.
    powers = np.stack([np.ones_like(duration), duration, duration**2], axis=1)[:, :, None]
    coefficients = _FROM_ENDS @ np.concatenate([begin * powers, end * powers], axis=1)
    return np.matmul(_rows(t / duration), coefficients) / powers


# The k-th derivative of x^p is factor[k, p] x^(p - k).
_FACTORS = np.array([[1, 1, 1, 1, 1, 1], [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]])
_EXPONENTS = np.maximum(np.arange(6) - np.arange(3)[:, None], 0)


def _rows(x: Array) -> Array:
    """Derivatives 0, 1, 2 of 1, x, … x⁵, shape (n, 3, 6)."""
    powers = np.cumprod(np.stack([np.ones_like(x), *[x] * 5], axis=1), axis=1)
    return _FACTORS * powers[:, _EXPONENTS]


_FROM_ENDS = np.linalg.inv(np.concatenate(_rows(np.array([0.0, 1.0]))))
