# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The interpolation of joint_trajectory_controller.

Between two points that both have velocities and accelerations it follows the quintic polynomial
through them, between points with velocities only the cubic one, and else a straight line. All of
these are quintics, given by their value and first two derivatives at both ends.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from ..arrays import FloatArray
from .trajectory import Trajectory

GRID_PERIOD = 1e-3
"""Longest step of the grid on which limits are checked [s]."""


@cache
def _coefficients() -> FloatArray:
    """Coefficients, by rising power of the phase, of the six Hermite functions and derivatives."""
    # The shape is (4, 6, 6). Column i belongs to the quintic that is one in boundary value i of (q,
    # q', q'' at 0, q, q', q'' at 1) and zero in the five others.
    values = [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
    coefficients = np.zeros((4, 6, 6))
    for d in range(4):
        coefficients[d, : 6 - d] = polynomial.polyder(np.array(values), d, axis=1).T
    return coefficients


def _to_bezier_points(derivative: int) -> FloatArray:
    n = 6 - derivative
    powers = [[comb(i, k) / comb(n - 1, k) for k in range(n)] for i in range(n)]
    points = powers @ _coefficients()[derivative, :n]
    return np.concatenate([points, np.repeat(points[-1:], derivative, axis=0)])


BEZIER_POINTS = np.array([_to_bezier_points(d) for d in range(4)])
"""Takes the values at both ends of a quintic, as :func:`hermite_functions` does, to the Bézier
points of it and of its first three derivatives by phase, shape (4, 6, 6). The curve lies between
the lowest and the highest Bézier point. Derivatives have fewer points: the last one is repeated."""


def hermite_functions(phases: FloatArray, derivative: int = 0) -> FloatArray:
    """Evaluate the six quintic Hermite functions.

    Parameters
    ----------
    phases : array, shape (n_steps,)
        Phases in [0, 1].
    derivative : int
        Which derivative with respect to phase, 0 to 3.

    Returns
    -------
    functions : array, shape (n_steps, 6)
        Their values; multiplied by the values at both ends (q, dq/ds, d²q/ds² at phase 0, then at
        phase 1) they give the quintic.
    """
    return np.asarray(np.vander(phases, 6, increasing=True) @ _coefficients()[derivative])


def quintics(phases: FloatArray, ends: FloatArray, highest: int) -> FloatArray:
    """Evaluate quintics and their derivatives.

    Parameters
    ----------
    phases : array, shape (n_steps,)
        Phases in [0, 1].
    ends : array, shape (6, n_joints)
        Values at both ends, see :func:`hermite_functions`.
    highest : int
        The highest derivative with respect to phase, 0 to 3.

    Returns
    -------
    values : array, shape (highest + 1, n_steps, n_joints)
        The quintics and their derivatives by phase.
    """
    powers = np.vander(phases, 6, increasing=True)
    return np.asarray(powers @ (_coefficients()[: highest + 1] @ ends))


def boundary_values(
    start: Iterable[FloatArray],
    goal: Iterable[FloatArray],
    duration: float,
) -> FloatArray:
    """Values of a motion at its ends with respect to phase, for :func:`hermite_functions`.

    Their quintic, the minimum-jerk motion (Flash and Hogan, J. Neurosci. 5(7), 1985), is the
    boundary part of the motion.

    Parameters
    ----------
    start, goal : array, shape (3, n_joints), or three arrays of shape (n_joints,)
        Positions [rad or m], velocities [/s] and accelerations [/s²].
    duration : float
        Duration of the motion [s].

    Returns
    -------
    values : array, shape (6, n_joints)
        q, dq/ds = T q̇ and d²q/ds² = T² q̈ at phase 0, then at phase 1.
    """
    (q, v, a), (q_end, v_end, a_end) = start, goal
    square = duration**2
    return np.array([q, duration * v, square * a, q_end, duration * v_end, square * a_end])


def segment_ends(
    times: FloatArray, positions: FloatArray, velocities: FloatArray, accelerations: FloatArray
) -> FloatArray:
    """Values at both ends of each segment between two points, for :func:`hermite_functions`.

    Parameters
    ----------
    times : array, shape (n_points,)
        Increasing times [s].
    positions, velocities, accelerations : array, shape (n_points, n_joints)
        Of the points; NaN in the velocities or accelerations that a point does not have.

    Returns
    -------
    ends : array, shape (n_points - 1, 6, n_joints)
        q, dq/ds and d²q/ds² at the start of each segment, then at its end, s from 0 to 1.
    """
    steps = np.diff(times)[:, None]
    v = [velocities[:-1] * steps, velocities[1:] * steps]
    a = [accelerations[:-1] * steps**2, accelerations[1:] * steps**2]
    if not (np.isfinite(velocities).all() and np.isfinite(accelerations).all()):
        straight = ~np.isfinite(v).all(axis=0)
        lower = straight | ~np.isfinite(a).all(axis=0)
        step = np.diff(positions, axis=0)
        v = [np.where(straight, step, stated) for stated in v]
        # The second derivatives of the cubic; of a straight line they are zero.
        cubic = [6.0 * step - 4.0 * v[0] - 2.0 * v[1], -6.0 * step + 2.0 * v[0] + 4.0 * v[1]]
        a = [np.where(lower, rate, given) for rate, given in zip(cubic, a, strict=True)]
    ends = np.array([positions[:-1], v[0], a[0], positions[1:], v[1], a[1]])
    return ends.transpose(1, 0, 2)


def interpolate_at(
    instants: FloatArray, times: FloatArray, ends: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions and their derivatives at any times between the first and the last point.

    Parameters
    ----------
    instants : array, shape (n_samples,)
        Times [s].
    times : array, shape (n_points,)
        Those of the points, at least two [s].
    ends : array, shape (n_points - 1, 6, n_joints)
        See :func:`segment_ends`.

    Returns
    -------
    q, v, a : array, shape (n_samples, n_joints)
        Positions, velocities and accelerations [rad or m, /s, /s²].
    """
    segment = np.searchsorted(times[1:-1], instants, side="right")
    begin = times[segment]
    steps = times[segment + 1] - begin
    phases = (instants - begin) / steps
    functions = np.vander(phases, 6, increasing=True) @ _coefficients()[:3]
    q, v, a = (functions[:, :, None] @ ends[segment])[:, :, 0]
    return q, v / steps[:, None], a / steps[:, None] ** 2


def curve_bounds(ends: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds of the curves of segments: they lie between their lowest and highest Bézier points.

    Parameters
    ----------
    ends, steps : array, shape (n_segments, 6, n_joints) and (n_segments,)
        Segments, see :func:`segment_ends`, and their durations [s].

    Returns
    -------
    lowest : array, shape (n_segments, n_joints)
        Bounds of the positions from below.
    highest : array, shape (4, n_segments, n_joints)
        Bounds of the positions from above, and of the magnitudes of their first three derivatives.
    """
    columns = ends.transpose(1, 0, 2).reshape(6, -1)
    points, shape = BEZIER_POINTS @ columns, (4, *ends[:, 0].shape)
    lowest, highest = points.min(axis=1).reshape(shape), points.max(axis=1).reshape(shape)
    rates = np.maximum(highest[1:], -lowest[1:], out=highest[1:])
    rates /= steps[:, None] ** np.arange(1.0, 4.0)[:, None, None]
    return lowest[0], highest


@dataclass(frozen=True, eq=False)
class DenseSamples:
    """The controller's interpolation of a trajectory on a fine grid.

    Attributes
    ----------
    times : array, shape (n_samples,)
        [s].
    q, v, a, jerk : array, shape (n_samples, n_joints)
        Positions and their first three derivatives. A jerk jumps at the points.
    """

    times: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    jerk: FloatArray


def interpolate(
    trajectory: Trajectory,
    period: float = GRID_PERIOD,
    segments: NDArray[np.bool_] | None = None,
) -> DenseSamples:
    """Sample the quintic interpolation of a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        The points.
    period : float
        Longest time between two samples [s]; every point is a sample.
    segments : array of bool, shape (n_points - 1,), optional
        The segments between points to sample; all unless given.
    """
    steps = np.diff(trajectory.times)
    if steps.size == 0:
        zero = np.zeros_like(trajectory.positions)
        return DenseSamples(trajectory.times, *trajectory.states, zero)
    n_parts = parts_of_segments(steps, period)
    fractions = np.linspace(0.0, 1.0, n_parts + 1)
    tables = np.array([hermite_functions(fractions, d) for d in range(4)])
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    ends, began = segment_ends(trajectory.times, q, v, a), trajectory.times[:-1]
    if segments is not None:
        ends, steps, began = ends[segments], steps[segments], began[segments]
    # One product of matrices, however many segments there are.
    values = tables.reshape(-1, 6) @ ends.transpose(1, 0, 2).reshape(6, -1)
    by_segment = values.reshape(4, fractions.size, steps.size, -1).swapaxes(1, 2)
    rates = steps ** -np.arange(4.0)[:, None]
    derivatives = (by_segment * rates[:, :, None, None]).reshape(4, -1, ends.shape[2])
    return DenseSamples((began[:, None] + steps[:, None] * fractions).ravel(), *derivatives)


def parts_of_segments(steps: FloatArray, period: float) -> int:
    """Parts into which every segment is sampled, at least 4; see :func:`interpolate`.

    At its ends, a quintic from rest to rest has no speed and little effort for any duration; at a
    quarter of the duration, its acceleration is near the peak.
    """
    return max(int(np.ceil(steps.max() / period - 1e-6)), 4)
