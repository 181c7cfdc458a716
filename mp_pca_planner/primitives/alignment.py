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
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .boundary import hermite_functions

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from ..recordings.demonstration import Demonstration

ALIGNMENTS = ("linear", "arc_length", "dtw")
"""Alignment by equal shares of the time, of the path, or by the distance to the mean shape."""

N_WARP_PHASES = 51
"""Number of values of a warp, at evenly spaced aligned phases; a monotone cubic interpolates
them."""

_KNOTS = np.linspace(0.0, 1.0, N_WARP_PHASES)

# Samples of a motion to measure its path: many for each knot of the warp.
_N_SAMPLES = 1001
# Shorter paths [rad or m] are rounding errors.
_MIN_PATH = 1e-6


@dataclass(frozen=True)
class WarpingOptions:
    """Options of dynamic time warping.

    Attributes
    ----------
    n_instants : int
        Instants of a motion to choose from.
    max_step : int
        Most instants from knot to knot; an even timing has 4.
    price : float
        Cost of an uneven timing as a share of the mean square of the shapes.
    n_rounds : int
        Updates of the mean shape.
    n_averagings : int
        Averagings of a warp with its neighbours, which smooth the steps between instants.
    """

    n_instants: int = 201
    max_step: int = 12
    price: float = 0.02
    n_rounds: int = 4
    n_averagings: int = 4


_WARPING = WarpingOptions()


def align(demonstrations: Sequence[Demonstration], method: str) -> FloatArray:
    """Find the warp of every demonstration.

    Parameters
    ----------
    demonstrations :
        Motions of the same joints.
    method : {'linear', 'arc_length', 'dtw'}
        'linear': the phase is the share of the duration. 'arc_length': see
        :func:`arc_length_warp`. 'dtw': dynamic time warping, which brings each motion near to
        the sum of the minimum-jerk motion between its end points and the mean shape.

    Returns
    -------
    warps : array, shape (n_demonstrations, N_WARP_PHASES)
        Shares of the durations, strictly increasing from 0 to 1.
    """
    if method == "arc_length":
        return np.array([arc_length_warp(d.time_normalised(_N_SAMPLES)) for d in demonstrations])
    if method == "dtw":
        samples = [d.time_normalised(_WARPING.n_instants) for d in demonstrations]
        return _dtw_warps(np.array(samples), _WARPING)
    return np.tile(_KNOTS, (len(demonstrations), 1))


def arc_length_warp(positions: FloatArray, speed_of_rest: float = 0.02) -> FloatArray:
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

    Returns
    -------
    warp : array, shape (N_WARP_PHASES,)
        Shares of its duration; an even warp if nothing moves.
    """
    own = np.linspace(0.0, 1.0, len(positions))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    if path[-1] < _MIN_PATH:
        return _KNOTS
    share = (path / path[-1] + speed_of_rest * own) / (1.0 + speed_of_rest)
    warp = np.interp(_minimum_jerk(_KNOTS), share, own)
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
    piece = np.array([np.searchsorted(row[1:-1], shares, side="right") for row in rows])
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
    # Late, so that the node starts fast.
    from scipy.interpolate import CubicHermiteSpline

    spline = CubicHermiteSpline(
        demonstration.times, demonstration.positions, demonstration.velocities, axis=0
    )
    return np.asarray(spline(demonstration.duration * own_phases(warp, phases)), dtype=np.float64)


def _curve(values: FloatArray) -> PchipInterpolator:
    """Monotone cubics through values at even steps from 0 to 1."""
    # Late, so that the node starts fast.
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(np.linspace(0.0, 1.0, len(values)), values)


def _minimum_jerk(phases: FloatArray) -> FloatArray:
    return np.asarray(hermite_functions(phases)[:, 3])


def _dtw_warps(motions: FloatArray, options: WarpingOptions) -> FloatArray:
    """Warps of motions of shape (n_demonstrations, n_instants, n_joints)."""
    displacement = motions[:, -1:] - motions[:, :1]
    straight = motions[:, :1] + _minimum_jerk(_KNOTS)[None, :, None] * displacement
    curves = [_curve(motion) for motion in motions]
    warps = np.tile(_KNOTS, (len(motions), 1))
    for _ in range(options.n_rounds):
        aligned = np.array([curve(warp) for curve, warp in zip(curves, warps, strict=True)])
        shapes = aligned - straight
        price = options.price * float(np.mean(np.sum(shapes**2, axis=2)))
        targets = straight + shapes.mean(axis=0)
        pairs = zip(targets, motions, strict=True)
        warps = np.array([_cheapest(x, y, price, options.max_step) for x, y in pairs])
        for _ in range(options.n_averagings):
            warps[:, 1:-1] = (warps[:, :-2] + 2.0 * warps[:, 1:-1] + warps[:, 2:]) / 4.0
    return warps


def _cheapest(target: FloatArray, motion: FloatArray, price: float, max_step: int) -> FloatArray:
    """Least sum of squared distances and prices, by dynamic programming from knot to knot."""
    distances = np.sum((target[:, None] - motion[None]) ** 2, axis=2)
    n_knots, n_instants = distances.shape
    steps = np.arange(1, max_step + 1)
    prices = price * np.log(steps * (n_knots - 1) / (n_instants - 1)) ** 2
    sources = np.arange(n_instants)[:, None] - steps
    costs = np.where(np.arange(n_instants) == 0, distances[0], np.inf)
    choices = np.zeros((n_knots, n_instants), dtype=np.intp)
    for knot in range(1, n_knots):
        candidates = np.where(sources >= 0, costs[sources], np.inf) + prices
        choices[knot] = candidates.argmin(axis=1)
        costs = candidates.min(axis=1) + distances[knot]
    chosen = np.empty(n_knots)
    instant = n_instants - 1
    for knot in range(n_knots - 1, -1, -1):
        chosen[knot] = instant
        instant -= steps[choices[knot, instant]]
    return np.asarray(chosen / (n_instants - 1))
