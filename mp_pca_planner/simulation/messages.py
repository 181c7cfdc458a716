# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of trajectories, and the polynomials through their points.

The points determine the degree of the polynomials. The code shares nothing with
:mod:`mp_pca_planner.motion.interpolation`, so that the simulation reveals errors there.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..recordings.joint_states import NS_PER_S

BoolArray = NDArray[np.bool_]


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


@dataclass(frozen=True, eq=False)
class States:
    """States at some times.

    Attributes
    ----------
    times_ns : list of int
        Increasing times [ns], n_points of them.
    values : array, shape (n_points, 3, n_joints)
        Positions [rad or m], velocities [/s] and accelerations [/s²]; 0 where none are given.
    given : array of bool, shape (n_points, 3)
        Which of them are given.
    """

    times_ns: Sequence[int]
    values: FloatArray
    given: BoolArray


class Splines:
    """A function of time that interpolates states and holds the last one.

    Parameters
    ----------
    states : States
        The states to interpolate.
    """

    def __init__(self, states: States) -> None:
        self._times = list(states.times_ns)
        self.end = self._times[-1]
        self._last: FloatArray = states.values[-1].ravel()
        lengths = np.diff(np.array(self._times))
        self._lengths = lengths.tolist()
        seconds: FloatArray = lengths * 1e-9
        self._coefficients = list(_polynomials(seconds, states.values, states.given))

    def sample(self, time_ns: int) -> FloatArray:
        """Positions, velocities and accelerations in a row, shape (3 n_joints,)."""
        if time_ns >= self.end:
            return self._last
        k = bisect_right(self._times, time_ns) - 1
        u = (time_ns - self._times[k]) / self._lengths[k]
        u2 = u * u
        powers = np.array((1.0, u, u2, u2 * u, u2 * u2, u2 * u2 * u))
        return np.asarray(powers @ self._coefficients[k])


def _polynomials(lengths: FloatArray, values: FloatArray, given: BoolArray) -> FloatArray:
    """Coefficients by rising power of the phase, shape (n_segments, 6, 3 n_joints).

    The last axis holds those of the positions, velocities and accelerations.
    """
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
