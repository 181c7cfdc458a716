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
from .basis import Basis, PolynomialBasis, legendre_derivatives, legendre_values

PACE_DEGREE = 4
"""Number of coefficients; more hardly change the errors of left-out motions."""

# Least rate σ′ of a motion.
_MIN_RATE = 0.1
_SHARES = np.linspace(0.0, 1.0, 101)
# The first and the last tenth of the duration.
_ENDS = np.abs(_SHARES - 0.5) > 0.399


def fit_paces(
    warps: FloatArray,
    jerks: FloatArray | None = None,
    *,
    price: float = 1e-7,
    n_prices: int = 12,
    growth: float = 1.3,
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
    jerks : array, shape (n_demonstrations,), optional
        Largest jerk of each demonstration in units of path length per cubed duration.
    price : float
        Cost of a squared jerk of 1, as a squared error.
    n_prices : int
        Number of prices that are tried.
    growth : float
        The bound, in units of the demonstration's largest jerk.
    max_jerk : float
        Largest bound, in units of path length per cubed duration. A minimum-jerk motion reaches 60.

    Returns
    -------
    paces : array, shape (n_demonstrations, PACE_DEGREE)
        The coefficients; all zero for an even warp.
    """
    demonstrated = np.full(len(warps), np.inf) if jerks is None else jerks
    bounds = np.minimum(growth * demonstrated, max_jerk)
    targets = aligned_phases(warps, _SHARES) - _SHARES
    values, even = _functions(_SHARES)[0], _course_jerks(np.zeros((1, PACE_DEGREE)))[0]
    step = 1e-6
    slopes = (_course_jerks(step * np.eye(PACE_DEGREE)) - even) / step
    paces = np.zeros((len(warps), PACE_DEGREE))
    # Even warps keep a pace of zero: such motions need no :class:`PacedBasis`.
    left = np.any(warps != np.linspace(0.0, 1.0, warps.shape[1]), axis=1)
    for cost in price * 3.0 ** np.arange(n_prices):
        gram = values.T @ values + cost * slopes @ slopes.T
        downhill = targets[left] @ values - cost * slopes @ even
        paces[left] = np.linalg.solve(gram, downhill.T).T
        highest = np.abs(_course_jerks(paces)[:, _ENDS]).max(axis=1)
        left &= highest > bounds
    return paces


def reversed_paces(paces: FloatArray) -> FloatArray:
    """Paces of the same motions in reversed time, shape (n_demonstrations, n_pace)."""
    return np.asarray(-paces * (-1.0) ** np.arange(paces.shape[1]))


class PacedBasis(Basis):
    """A basis for motions between two end points with a time scaling.

    A motion along the path q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) from rest to rest at the aligned
    phase s = σ(p) is h(p) + [h(σ(p)) − h(p)] + μ(σ(p)) + Σ wₖ φₖ(σ(p)): linear in the weights. All
    terms except h(p) vanish at both ends with two derivatives, as the compiler requires.

    Parameters
    ----------
    basis : PolynomialBasis
        The basis by aligned phase.
    displacement : array, shape (n_joints,)
        Goal minus start [rad or m].
    pace : array, shape (PACE_DEGREE,)
        The pace, see :func:`fit_paces`; scaled down where the motion would stop or turn back.
    """

    def __init__(self, basis: PolynomialBasis, displacement: FloatArray, pace: FloatArray) -> None:
        # h less the start is a polynomial like the mean shape.
        going = displacement[:, None] * _minimum_jerk_series(basis.mean_coefficients.shape[1])
        self._going = PolynomialBasis(
            basis.mean_coefficients + going, basis.component_coefficients, basis.scales
        )
        self._displacement = displacement
        self.n_joints = basis.n_joints
        self.n_weights = basis.n_weights
        self.scales = basis.scales
        self.breakpoints = np.array([0.0, 1.0])
        slowest = float((_functions(_SHARES)[1] @ pace).min())
        self._series = pace @ _series() * min(1.0, (1.0 - _MIN_RATE) / max(-slowest, 1e-9))
        self._series[:2] += 0.5  # σ = p: an even time scaling

    def aligned_phases(self, phases: FloatArray, derivative: int = 0) -> FloatArray:
        """σ(p), or a derivative, at shares p of the duration, shape (n_steps,)."""
        values = legendre_values(self._series, phases, derivative)
        return _within(values) if derivative == 0 else values

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        courses = self._courses(phases, highest)
        values = self._going.shapes(weights, _within(courses[0, :, 0]), highest)
        return self._less_straight(_by_share(values, courses), courses)

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        courses = self._courses(phases, highest)
        terms = _by_share(self._going.terms(_within(courses[0, :, 0]), highest), courses)
        tables = self._going.combined(terms)
        self._less_straight(tables[..., 0], courses)
        return tables

    def _courses(self, phases: FloatArray, highest: int) -> FloatArray:
        """σ and the minimum-jerk course, and derivatives, shape (highest + 1, n_steps, 2)."""
        if highest > 3:
            raise ValueError(f"derivative must be 0 to 3, got {highest}")
        both = np.array([self._series, _minimum_jerk_series(self._series.size)])
        return legendre_derivatives(both, phases, highest)

    def _less_straight(self, values: FloatArray, courses: FloatArray) -> FloatArray:
        """Positions and derivatives relative to h(p), in place."""
        values -= courses[:, :, 1:] * self._displacement
        return values


def _within(phases: FloatArray) -> FloatArray:
    """Phases without rounding errors beyond 0 and 1."""
    return np.clip(phases, 0.0, 1.0)


@lru_cache(maxsize=1)
def _series() -> FloatArray:
    """Legendre coefficients of the functions (1 − x²)³ Pₖ(x), shape (PACE_DEGREE, degree + 1)."""
    window = legendre.poly2leg(polynomial.polypow([1.0, 0.0, -1.0], 3))
    series = np.zeros((PACE_DEGREE, window.size + PACE_DEGREE - 1))
    for k, one in enumerate(np.eye(PACE_DEGREE)):
        product = legendre.legmul(window, one)
        series[k, : product.size] = product
    return series


def _functions(phases: FloatArray) -> FloatArray:
    """The functions and three derivatives by share, shape (4, n_steps, PACE_DEGREE)."""
    return legendre_derivatives(_series(), phases, 3)


def _course_jerks(paces: FloatArray) -> FloatArray:
    """Third derivatives of the minimum-jerk course at paces, shape (n_paces, n_shares)."""
    linear = np.outer([0.0, 1.0, 0.0, 0.0], np.ones(_SHARES.size))
    linear[0] = _SHARES
    s, rate, acceleration, jerk = linear[:, None] + paces @ _functions(_SHARES).swapaxes(1, 2)
    rest = s * (1.0 - s)
    own = 60.0 * (1.0 - 6.0 * rest) * rate**3 + 180.0 * rest * (1.0 - 2.0 * s) * rate * acceleration
    return np.asarray(own + 30.0 * rest**2 * jerk)


@lru_cache(maxsize=16)
def _minimum_jerk_series(n_coefficients: int) -> FloatArray:
    """Legendre coefficients of 10s³ − 15s⁴ + 6s⁵, the minimum-jerk course from 0 to 1."""
    series = polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    by_x = series(polynomial.Polynomial([0.5, 0.5]))
    found = np.zeros(n_coefficients)
    found[:6] = legendre.poly2leg(by_x.coef)
    return found


def _by_share(values: FloatArray, courses: FloatArray) -> FloatArray:
    """Derivatives by p, up to the third, of functions of σ(p), by the chain rule.

    Parameters
    ----------
    values : array, shape (highest + 1, n_steps, n_functions)
        The functions and their derivatives by σ at σ(p).
    courses : array, shape (highest + 1, n_steps, 2)
        σ and its derivatives in the first column.
    """
    rates, chained = courses[:, :, :1], values.copy()
    if len(values) > 1:
        chained[1] *= rates[1]
    if len(values) > 2:
        chained[2] *= rates[1] ** 2
        chained[2] += values[1] * rates[2]
    if len(values) > 3:
        chained[3] *= rates[1] ** 3
        chained[3] += values[2] * (3.0 * rates[1] * rates[2])
        chained[3] += values[1] * rates[3]
    return chained
