# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time alignment of demonstrations.

Demonstrations of one task differ in timing. Without alignment, components explain timing
differences instead of the path. A warp γ increases from γ(0) = 0 to γ(1) = 1: at the aligned phase
s a demonstration is at the share γ(s) of its duration T, and its aligned motion is q(T γ(s)). A
primitive stores the warps, so each demonstration can be reproduced with its own timing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..motion.interpolation import hermite_functions

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from ..recordings.demonstration import Demonstration

ALIGNMENTS = ("linear", "arc_length")
"""Alignment by equal shares of the time, or of the path."""

KNOTS = np.linspace(0.0, 1.0, 51)
"""Aligned phases of the values of a warp; a monotone cubic interpolates them."""

# Shares of its path that a minimum-jerk motion has covered at the knots.
_MINIMUM_JERK = hermite_functions(KNOTS)[:, 3]


def align(
    demonstrations: Sequence[Demonstration], method: str, n_samples: int = 1001
) -> FloatArray:
    """Find the warp of every demonstration.

    Parameters
    ----------
    demonstrations :
        Motions of the same joints.
    method : {'linear', 'arc_length'}
        'linear': the phase is the share of the duration. Velocities and accelerations at the ends
        stay as they were measured, with their noise. 'arc_length': see :func:`arc_length_warp`;
        motions start and end at rest.
    n_samples :
        Samples of a motion to measure its path: many for each knot of the warp.

    Returns
    -------
    warps : array, shape (n_demonstrations, n_knots)
        Shares of the durations at the knots, strictly increasing from 0 to 1.
    """
    if method == "arc_length":
        return np.array([arc_length_warp(d.time_normalised(n_samples)) for d in demonstrations])
    return np.tile(KNOTS, (len(demonstrations), 1))


def arc_length_warp(
    positions: FloatArray, speed_of_rest: float = 0.02, min_path: float = 1e-6
) -> FloatArray:
    """The warp by which a motion follows its path with the timing of a minimum-jerk motion.

    At phase s it has covered the share 10s³ − 15s⁴ + 6s⁵ of its path in joint space, so that it
    starts and ends at rest.

    Parameters
    ----------
    positions : array, shape (n_steps, n_joints)
        The motion at evenly spaced times [rad or m].
    speed_of_rest : float
        Share of the mean speed that is added to the speed, so that the warp increases during a
        rest within a motion. Values from 0.02 to 0.4 hardly change benchmarks/naturalness.py.
    min_path : float
        Shorter paths are rounding errors [rad or m].

    Returns
    -------
    warp : array, shape (n_knots,)
        Shares of its duration; an even warp if nothing moves.
    """
    own = np.linspace(0.0, 1.0, len(positions))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    if path[-1] < min_path:
        return KNOTS
    share = (path / path[-1] + speed_of_rest * own) / (1.0 + speed_of_rest)
    warp = np.interp(_MINIMUM_JERK, share, own)
    warp[[0, -1]] = 0.0, 1.0
    return np.asarray(warp)


def own_phases(warp: FloatArray, phases: FloatArray) -> FloatArray:
    """Shares γ(s) of a demonstration's duration at aligned phases, shape (n_steps,).

    Parameters
    ----------
    warp : array, shape (n_warp_phases,)
        The demonstration's warp.
    phases : array, shape (n_steps,)
        Aligned phases in [0, 1].
    """
    return np.asarray(np.clip(_curve(warp)(phases), 0.0, 1.0))


def aligned_phases(warps: FloatArray, shares: FloatArray) -> FloatArray:
    """Aligned phases at shares of demonstrations' durations: the inverse of `own_phases`.

    Parameters
    ----------
    warps : array, shape (..., n_warp_phases)
        The warp of a demonstration, or of several ones.
    shares : array, shape (n_steps,)
        Shares of the durations in [0, 1].

    Returns
    -------
    phases : array, shape (..., n_steps)
        Aligned phases in [0, 1].
    """
    rows = warps.reshape(-1, warps.shape[-1])
    curve = _curve(rows.T)
    piece = np.count_nonzero(rows[:, None, 1:-1] <= shares[:, None], axis=2)
    cubics = curve.c[:, piece, np.arange(len(rows))[:, None]]
    low, high = np.zeros(piece.shape), np.full(piece.shape, curve.x[1])
    for _ in range(52):  # the bits of a phase
        middle = (low + high) / 2.0
        values = ((cubics[0] * middle + cubics[1]) * middle + cubics[2]) * middle + cubics[3]
        is_later = values < shares
        low, high = np.where(is_later, middle, low), np.where(is_later, high, middle)
    # The slope of a warp may vanish at its ends, where bisection would stop too early.
    phases = np.select([shares <= 0.0, shares >= 1.0], [0.0, 1.0], curve.x[piece] + high)
    return np.asarray(phases.reshape(*warps.shape[:-1], len(shares)))


def aligned_positions(
    demonstration: Demonstration, warp: FloatArray, phases: FloatArray
) -> FloatArray:
    """Positions q(T γ(s)) of a demonstration [rad or m], shape (n_steps, n_joints).

    Parameters
    ----------
    demonstration :
        The motion.
    warp : array, shape (n_warp_phases,)
        Its warp.
    phases : array, shape (n_steps,)
        Aligned phases in [0, 1].
    """
    times = demonstration.duration * own_phases(warp, phases)
    return np.asarray(demonstration.curve()(times))


def _curve(values: FloatArray) -> PchipInterpolator:
    """Monotone cubics through values at even steps from 0 to 1."""
    # Late, so that the node starts fast.
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(np.linspace(0.0, 1.0, len(values)), values)
