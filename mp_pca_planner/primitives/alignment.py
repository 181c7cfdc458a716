# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time alignment: which instant of each demonstration belongs to which phase of the primitive.

Demonstrations of one task differ in timing, and components that have to explain timing are
lost for the path. A warp γ, increasing from γ(0) = 0 to γ(1) = 1, says at which share of its
duration T a demonstration is at the aligned phase s: its aligned motion is q(T γ(s)). The warps
are kept with the primitive, so that each demonstration is known with its own timing, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .boundary import hermite_functions

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from ..recordings.demonstration import Demonstration

ALIGNMENTS = ("linear", "arc_length", "dtw")
"""Ways to align: equal shares of the time; equal shares of the way; nearest to the mean shape."""

N_WARP_PHASES = 51
"""Values that make up a warp, at evenly spaced aligned phases; a monotone cubic joins them."""

_KNOTS = np.linspace(0.0, 1.0, N_WARP_PHASES)

# Instants at which a motion is looked at to measure its way: many for each knot of the warp.
_N_WAY = 1001
# Share of the mean speed that is added to the speed, so that the warp increases during a rest in
# the middle of a motion, too. From 0.02 to 0.4 hardly any error in benchmarks/naturalness.py moves.
_SPEED_OF_REST = 0.02
# Ways [rad or m] below this are rounding errors.
_NO_WAY = 1e-6

# Dynamic time warping: instants to choose from; instants from knot to knot, of which an even
# pace has 4; price of an uneven pace, as a share of the mean square of the shapes; how often
# the mean shape is made anew; and how often a warp is averaged with its neighbours, which
# rounds off the steps between the instants.
_N_INSTANTS = 201
_STEPS = np.arange(1, 13)
_PRICE = 0.02
_N_ROUNDS = 4
_N_AVERAGINGS = 4


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
        return np.array([arc_length_warp(d.time_normalised(_N_WAY)) for d in demonstrations])
    if method == "dtw":
        return _dtw_warps(np.array([d.time_normalised(_N_INSTANTS) for d in demonstrations]))
    return np.tile(_KNOTS, (len(demonstrations), 1))


def arc_length_warp(positions: FloatArray) -> FloatArray:
    """Find the warp that lets a motion go its way at the pace of a minimum-jerk motion.

    At phase s it has done the share 10s³ − 15s⁴ + 6s⁵ of its way in joint space, so that it
    starts and ends at rest.

    Parameters
    ----------
    positions : array, shape (n_steps, n_joints)
        The motion at evenly spaced times [rad or m].

    Returns
    -------
    warp : array, shape (N_WARP_PHASES,)
        Shares of its duration; even where nothing moves.
    """
    own = np.linspace(0.0, 1.0, len(positions))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    if way[-1] < _NO_WAY:
        return _KNOTS
    share = (way / way[-1] + _SPEED_OF_REST * own) / (1.0 + _SPEED_OF_REST)
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


def aligned_phases(warp: FloatArray, shares: FloatArray) -> FloatArray:
    """Aligned phases at shares of a demonstration's duration: the inverse of `own_phases`.

    Parameters
    ----------
    warp : array, shape (n_warp_phases,)
        The demonstration's warp.
    shares : array, shape (n_steps,)
        Shares of its duration in [0, 1].
    """
    curve = _curve(warp)
    low, high = np.zeros(len(shares)), np.ones(len(shares))
    for _ in range(52):  # the bits of a phase
        middle = (low + high) / 2.0
        is_later = curve(middle) < shares
        low, high = np.where(is_later, middle, low), np.where(is_later, high, middle)
    # The slope of a warp may vanish at its ends, where halving would stop a little short.
    return np.select([shares <= 0.0, shares >= 1.0], [0.0, 1.0], high)


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


def _dtw_warps(motions: FloatArray) -> FloatArray:
    """Warps of motions of shape (n_demonstrations, n_instants, n_joints)."""
    way = motions[:, -1:] - motions[:, :1]
    straight = motions[:, :1] + _minimum_jerk(_KNOTS)[None, :, None] * way
    curves = [_curve(motion) for motion in motions]
    warps = np.tile(_KNOTS, (len(motions), 1))
    for _ in range(_N_ROUNDS):
        aligned = np.array([curve(warp) for curve, warp in zip(curves, warps, strict=True)])
        shapes = aligned - straight
        price = _PRICE * float(np.mean(np.sum(shapes**2, axis=2)))
        targets = straight + shapes.mean(axis=0)
        warps = np.array(
            [_averaged(_cheapest(x, y, price)) for x, y in zip(targets, motions, strict=True)]
        )
    return warps


def _cheapest(target: FloatArray, motion: FloatArray, price: float) -> FloatArray:
    """Least sum of squared distances and prices, by dynamic programming from knot to knot."""
    distances = np.sum((target[:, None] - motion[None]) ** 2, axis=2)
    n_knots, n_instants = distances.shape
    prices = price * np.log(_STEPS * (n_knots - 1) / (n_instants - 1)) ** 2
    sources = np.arange(n_instants)[:, None] - _STEPS
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
        instant -= _STEPS[choices[knot, instant]]
    return np.asarray(chosen / (n_instants - 1))


def _averaged(warp: FloatArray) -> FloatArray:
    for _ in range(_N_AVERAGINGS):
        warp[1:-1] = (warp[:-2] + 2.0 * warp[1:-1] + warp[2:]) / 4.0
    return warp
