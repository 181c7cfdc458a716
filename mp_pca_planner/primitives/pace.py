# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time scaling of motions: the aligned phase σ(p) at each share p of the duration.

Where demonstrations are aligned, components carry the path and the time scaling, here called pace,
carries the timing. With x = 2p − 1 it is σ(p) = p + Σ cₖ (1 − x²)³ Pₖ(x), with the Legendre
polynomials Pₖ. It is linear in its coefficients, so paces can be averaged and regressed like any
other data. Rate, acceleration and jerk at the very ends are those of an even time scaling.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre, polynomial

from ..arrays import FloatArray
from .alignment import aligned_phases
from .basis import legendre_derivatives, legendre_values

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
        See :func:`.align`.
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
    bounds = np.minimum(_GROWTH * jerks, max_jerk)
    even, step = _course_jerks(np.zeros((1, PACE_DEGREE)))[0], 1e-6
    slopes = (_course_jerks(step * np.eye(PACE_DEGREE)) - even) / step
    values = legendre_values(_series(), _SHARES)
    targets = aligned_phases(warps, _SHARES) - _SHARES
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


def reversed_paces(paces: FloatArray) -> FloatArray:
    """Paces of the same motions in reversed time, shape (n_demonstrations, n_pace)."""
    return np.asarray(-paces * (-1.0) ** np.arange(paces.shape[1]))


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
    slowest = legendre_values(changes, _SHARES, 1).min(axis=0)
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
    own = 60.0 * (1.0 - 6.0 * rest) * rate**3 + 180.0 * rest * (1.0 - 2.0 * s) * rate * acceleration
    return np.asarray(own + 30.0 * rest**2 * jerk).T
