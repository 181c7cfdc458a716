# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Timing of motions: alignment of demonstrations, and time scaling.

Demonstrations of one task differ in timing. Without alignment, components explain timing
differences instead of the path. A warp γ increases from γ(0) = 0 to γ(1) = 1: at the aligned phase
s a demonstration is at the share γ(s) of its duration T, and its aligned motion is q(T γ(s)). A
primitive stores the warps, so each demonstration can be reproduced with its own timing.

Components of aligned demonstrations carry the path, and the time scaling, here called pace, carries
the timing. It is the aligned phase σ(p) at each share p of the duration: with x = 2p − 1,
σ(p) = p + Σ cₖ (1 − x²)³ Pₖ(x), with the Legendre polynomials Pₖ. It is linear in its coefficients,
so paces can be averaged and regressed like any other data. Rate, acceleration and jerk at the very
ends are those of an even time scaling.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre, polynomial

from ..arrays import FloatArray
from ..motion.interpolation import hermite_functions
from .basis import legendre_derivatives

ALIGNMENTS = ("linear", "arc_length")
"""Alignment by equal shares of the time, or of the path, see :func:`arc_length_warp`."""

KNOTS = np.linspace(0.0, 1.0, 51)
"""Aligned phases of the values of a warp; a monotone cubic interpolates them."""

# Shares of its path that a minimum-jerk motion has covered at the knots.
_MINIMUM_JERK = hermite_functions(KNOTS)[:, 3]

PACE_DEGREE = 4
"""Number of coefficients; more hardly change the errors of left-out motions."""

# Least rate σ′ of a motion.
_MIN_RATE = 0.1
_SHARES = np.linspace(0.0, 1.0, 101)
# The first and the last tenth of the duration.
_ENDS = np.abs(_SHARES - 0.5) > 0.399
# The bound on jerk at the ends, in units of the demonstration's largest jerk.
_GROWTH = 1.2
_N_PRICES = 12


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
        rest within a motion. Values from 0.02 to 0.4 hardly change predictions.
    min_path : float
        Shorter paths are rounding errors [rad or m].

    Returns
    -------
    warp : array, shape (n_knots,)
        Shares of its duration; an even warp if nothing moves.
    """
    times = np.linspace(0.0, 1.0, len(positions))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    if path[-1] < min_path:
        return KNOTS
    share = (path / path[-1] + speed_of_rest * times) / (1.0 + speed_of_rest)
    warp = np.interp(_MINIMUM_JERK, share, times)
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
    # Late, so that the node starts fast.
    from scipy.interpolate import PchipInterpolator

    curve = PchipInterpolator(np.linspace(0.0, 1.0, len(warp)), warp)
    return np.asarray(np.clip(curve(phases), 0.0, 1.0))


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
    from scipy.interpolate import PchipInterpolator

    rows = warps.reshape(-1, warps.shape[-1])
    curve = PchipInterpolator(np.linspace(0.0, 1.0, rows.shape[1]), rows.T)
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


def fit_paces(
    warps: FloatArray,
    jerks: FloatArray | float = np.inf,
    *,
    price: float = 1e-7,
    max_jerk: float = 300.0,
) -> FloatArray:
    """Paces nearest to warps, with bounded jerk at the ends.

    The sum of the squared error of σ and of the priced squared jerk of the course is minimal. The
    course is the share of the path that is covered. Its jerk is linearised. A motion whose course
    exceeds the bound is fitted again at three times the price.

    Parameters
    ----------
    warps : array, shape (n_demonstrations, n_warp_phases)
        See :func:`arc_length_warp`.
    jerks : array, shape (n_demonstrations,), or float
        Largest jerk of each demonstration in units of path length per cubed duration.
    price : float
        Cost of a squared jerk of 1, as a squared error.
    max_jerk : float
        Largest bound, in units of path length per cubed duration. A minimum-jerk motion reaches 60.

    Returns
    -------
    paces : array, shape (n_demonstrations, PACE_DEGREE)
        The coefficients; all zero for an even warp.
    """
    targets = aligned_phases(warps, _SHARES) - _SHARES
    bounds = np.minimum(_GROWTH * jerks, max_jerk)
    even, step = _course_jerks(np.zeros((1, PACE_DEGREE)))[0], 1e-6
    slopes = (_course_jerks(step * np.eye(PACE_DEGREE)) - even) / step
    (values,) = legendre_derivatives(_series(), _SHARES, 0)
    paces = np.zeros((len(warps), PACE_DEGREE))
    # Even warps keep a pace of zero: such motions need no :class:`.PacedBasis`.
    left = np.any(warps != np.linspace(0.0, 1.0, warps.shape[1]), axis=1)
    for cost in price * 3.0 ** np.arange(_N_PRICES):
        gram = values.T @ values + cost * slopes @ slopes.T
        downhill = targets[left] @ values - cost * slopes @ even
        paces[left] = np.linalg.solve(gram, downhill.T).T
        highest = np.abs(_course_jerks(paces)[:, _ENDS]).max(axis=1)
        left &= highest > bounds
    return paces


def time_scaling(paces: FloatArray) -> FloatArray:
    """Legendre coefficients of σ in x = 2p − 1.

    Parameters
    ----------
    paces : array, shape (..., PACE_DEGREE)
        The coefficients cₖ; scaled down where a motion would stop or turn back.

    Returns
    -------
    series : array, shape (..., degree + 1)
        Lowest degree first.
    """
    changes = paces @ _series()
    _, rates = legendre_derivatives(changes, _SHARES, 1)
    slowest = rates.min(axis=0)
    changes *= np.minimum(1.0, (1.0 - _MIN_RATE) / np.maximum(-slowest, 1e-9))[..., None]
    changes[..., :2] += 0.5  # σ = p: an even time scaling
    return np.asarray(changes)


@lru_cache(maxsize=1)
def _series() -> FloatArray:
    """Legendre coefficients of the functions (1 − x²)³ Pₖ(x), shape (PACE_DEGREE, degree + 1)."""
    window = legendre.poly2leg(polynomial.polypow([1.0, 0.0, -1.0], 3))
    series = [legendre.legmul(window, np.eye(PACE_DEGREE)[k]) for k in range(PACE_DEGREE)]
    return np.array([np.pad(x, (0, window.size + PACE_DEGREE - 1 - x.size)) for x in series])


def _course_jerks(paces: FloatArray) -> FloatArray:
    """Third derivatives of the minimum-jerk course at paces, shape (n_paces, n_shares)."""
    s, rate, acceleration, jerk = legendre_derivatives(time_scaling(paces), _SHARES, 3)
    rest = s * (1.0 - s)
    by_rate = (
        60.0 * (1.0 - 6.0 * rest) * rate**3 + 180.0 * rest * (1.0 - 2.0 * s) * rate * acceleration
    )
    return np.asarray(by_rate + 30.0 * rest**2 * jerk).T
