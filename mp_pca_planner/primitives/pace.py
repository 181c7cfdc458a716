# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time scaling of motions: the aligned phase σ(p) at each share p of the duration.

Where demonstrations are aligned, components carry the path and the time scaling, here called pace,
carries the timing. It increases from σ(0) = 0 to σ(1) = 1. The logarithm of its rate is a
polynomial, log σ'(p) = g(p) + constant: every g is valid, so paces can be averaged and regressed
like any other data. A pace is a warp of few numbers, see :mod:`.alignment`.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from numpy.polynomial import legendre, polynomial

from ..arrays import FloatArray
from .alignment import aligned_phases
from .basis import Basis, PolynomialBasis, legendre_derivatives, legendre_values

PACE_DEGREE = 4
"""Degree of g; higher degrees hardly change the errors of left-out motions."""

# Degree of the polynomial that represents σ, which makes its derivatives exact.
_DEGREE = 26
# Largest sum of the coefficients' magnitudes; the rates of human motions vary by less than e³.
_MAX_UNEVENNESS = 3.0


def fit_paces(
    warps: FloatArray,
    *,
    n_steps: int = 12,
    price: float = 1e-5,
    end_price: float = 3e-4,
    max_step: float = 1.0,
) -> FloatArray:
    """Paces nearest to warps, by Gauss–Newton steps.

    Parameters
    ----------
    warps : array, shape (n_demonstrations, n_warp_phases)
        See :func:`.align`.
    n_steps : int
        Gauss–Newton steps.
    price : float
        Cost of a coefficient of 1, as a squared error.
    end_price : float
        Cost of a value of 1 of g at an end, likewise: accelerations and jerks there grow with the
        square and the cube of the rate.
    max_step : float
        Largest change of a coefficient in a step.

    Returns
    -------
    paces : array, shape (n_demonstrations, PACE_DEGREE)
        Legendre coefficients of g, from the first degree on; all zero for an even warp.
    """
    # Late, so that the node starts fast.
    from scipy.integrate import cumulative_trapezoid

    shares = np.linspace(0.0, 1.0, 101)
    integral = partial(cumulative_trapezoid, x=shares, axis=1, initial=0)
    is_even = np.all(warps == np.linspace(0.0, 1.0, warps.shape[1]), axis=1)
    # In parts that fit into the cache of the processor.
    parts = np.array_split(warps, len(warps) // 100 + 1)
    targets = np.concatenate([aligned_phases(part, shares) for part in parts])
    functions = legendre.legvander(2.0 * shares - 1.0, PACE_DEGREE)[:, 1:]
    paces = np.zeros((len(warps), PACE_DEGREE))
    ends = functions[[0, -1]]
    ridge = len(shares) * (price * np.eye(PACE_DEGREE) + end_price * ends.T @ ends)
    for _ in range(n_steps):
        rates = np.exp(paces @ functions.T)
        covered = integral(rates[:, :, None])
        slopes = integral(rates[:, :, None] * functions)
        phases = covered / covered[:, -1:]
        jacobian = (slopes - phases * slopes[:, -1:]) / covered[:, -1:]
        transposed = jacobian.transpose(0, 2, 1)
        downhill = transposed @ (targets[:, :, None] - phases) - ridge @ paces[:, :, None]
        step = np.linalg.solve(transposed @ jacobian + ridge, downhill)[:, :, 0]
        paces = paces + np.clip(step, -max_step, max_step)
    # Exactly zero: such motions need no :class:`PacedBasis`.
    paces[is_even] = 0.0
    return paces


def reversed_paces(paces: FloatArray) -> FloatArray:
    """Paces of the same motions in reversed time, shape (n_demonstrations, n_pace)."""
    return np.asarray(paces * (-1.0) ** np.arange(1, paces.shape[1] + 1))


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
        The pace, see :func:`fit_paces`; one that is more uneven than human motions is scaled down.
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
        uneven = float(np.abs(pace).sum())
        functions, integration = _rate_tables()
        g = functions @ (pace * (_MAX_UNEVENNESS / max(uneven, _MAX_UNEVENNESS)))
        series = integration @ np.exp(g)
        self._series = series / series.sum()

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
def _rate_tables() -> tuple[FloatArray, FloatArray]:
    """Functions of g at nodes, and the matrix from rates there to the Legendre series of σ."""
    nodes, quadrature = legendre.leggauss(_DEGREE)
    norms = np.arange(_DEGREE)[:, None] + 0.5
    to_series = (legendre.legvander(nodes, _DEGREE - 1) * quadrature[:, None]).T * norms
    integration = legendre.legint(np.eye(_DEGREE), lbnd=-1.0) @ to_series
    return np.asarray(legendre.legvander(nodes, PACE_DEGREE)[:, 1:]), np.asarray(integration)


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
