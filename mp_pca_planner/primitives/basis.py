# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motion bases: shapes μ(s) + Σ wₖ φₖ(s) that vanish, to the second derivative, at both ends.

Every motion is a shape plus its boundary part h(s), the quintic between two states. Therefore it
starts and ends as requested for any shape.

Polynomials carry the principal components; B-splines are the baseline of [P]. The motion compiler
handles both through one interface.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev, legendre, polynomial

from ..arrays import FloatArray

# A polynomial that vanishes with two derivatives at both ends has the factor s³(1−s)³.
N_END_CONDITIONS = 6

MAX_DEGREE = 30
"""Largest degree of the polynomials of a primitive."""


class Basis(Protocol):
    """A mean shape and weighted functions of phase.

    Attributes
    ----------
    n_joints, n_weights : int
        Numbers of joints and of functions.
    breakpoints : array, shape (n_breakpoints,)
        Phases, from 0 to 1, between which every function is smooth.
    scales : array, shape (n_weights,)
        Usual magnitude of each weight.
    """

    n_joints: int
    n_weights: int
    breakpoints: FloatArray
    scales: FloatArray

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """Values of μ, then the φₖ, and their derivatives up to the highest one.

        The shape is (highest + 1, n_steps, n_joints, 1 + n_weights).
        """

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""

    def functions(self, phases: FloatArray, derivative: int = 0) -> FloatArray:
        """Values of φₖ or a derivative by phase, shape (n_steps, n_joints, n_weights)."""
        return np.ascontiguousarray(self.tables(phases, derivative)[-1, :, :, 1:])

    def shape(self, weights: FloatArray, phases: FloatArray, derivative: int = 0) -> FloatArray:
        """Values of μ + Σ wₖ φₖ or a derivative by phase, shape (n_steps, n_joints)."""
        return np.asarray(self.shapes(weights, phases, derivative)[-1])


class PolynomialBasis(Basis):
    """Mean and components as Legendre series in x = 2s − 1.

    Parameters
    ----------
    mean : array, shape (n_joints, degree + 1)
        Coefficients of μ.
    components : array, shape (n_weights, n_joints, degree + 1)
        Coefficients of the φₖ.
    scales : array, shape (n_weights,)
        Standard deviations of the weights.
    """

    def __init__(self, mean: FloatArray, components: FloatArray, scales: FloatArray) -> None:
        self.mean_coefficients = mean
        self.component_coefficients = components
        self.n_joints, self.n_weights = len(mean), len(components)
        self.scales = scales
        self.breakpoints = np.array([0.0, 1.0])

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        return self.combined(self.terms(phases, highest))

    def terms(self, phases: FloatArray, highest: int) -> FloatArray:
        """Legendre polynomials and derivatives, shape (highest + 1, n_steps, degree + 1)."""
        return legendre_derivatives(np.eye(self.mean_coefficients.shape[1]), phases, highest)

    def combined(self, terms: FloatArray) -> FloatArray:
        """Sums of the terms, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        both = np.concatenate([self.mean_coefficients[None], self.component_coefficients])
        series = both.transpose(2, 1, 0)
        sums = terms @ series.reshape(len(series), -1)
        return np.asarray(sums.reshape(*terms.shape[:2], *series.shape[1:]))

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        mean = self.mean_coefficients
        weighted = weights @ self.component_coefficients.reshape(self.n_weights, mean.size)
        series = mean + weighted.reshape(mean.shape)
        return legendre_derivatives(series, phases, highest)


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
    scaling : array, shape (degree + 1,)
        Legendre coefficients of σ, see :func:`.time_scaling`.
    """

    def __init__(
        self, basis: PolynomialBasis, displacement: FloatArray, scaling: FloatArray
    ) -> None:
        # h minus the start is a polynomial like the mean shape.
        going = displacement[:, None] * _minimum_jerk_series(basis.mean_coefficients.shape[1])
        self._going = PolynomialBasis(
            basis.mean_coefficients + going, basis.component_coefficients, basis.scales
        )
        self._displacement = displacement
        self.n_joints, self.n_weights = basis.n_joints, basis.n_weights
        self.scales, self.breakpoints = basis.scales, basis.breakpoints
        self._courses_series = np.array([scaling, _minimum_jerk_series(scaling.size)])

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        courses, aligned = self._courses(phases, highest)
        tables = self._going.combined(_by_share(self._going.terms(aligned, highest), courses))
        tables[..., 0] -= courses[:, :, 1:] * self._displacement
        return tables

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        courses, aligned = self._courses(phases, highest)
        values = _by_share(self._going.shapes(weights, aligned, highest), courses)
        values -= courses[:, :, 1:] * self._displacement
        return values

    def _courses(self, phases: FloatArray, highest: int) -> tuple[FloatArray, FloatArray]:
        """σ and the minimum-jerk course with derivatives, and σ within 0 and 1.

        The shapes are (highest + 1, n_steps, 2) and (n_steps,).
        """
        if highest > 3:
            raise ValueError(f"derivative must be 0 to 3, got {highest}")
        courses = legendre_derivatives(self._courses_series, phases, highest)
        return courses, np.clip(courses[0, :, 0], 0.0, 1.0)


class BSplineBasis(Basis):
    """Clamped B-splines, the same for every joint: the baseline of [P], Section 4.

    The ends of a motion fix the three first and three last functions of a clamped spline: the
    boundary part takes their place. The `n_control_points` between them are free.

    Parameters
    ----------
    n_joints : int
        Number of joints.
    n_control_points : int
        Free control points per joint.
    degree : int
        Degree of the splines, at least 3 (continuous accelerations).
    """

    def __init__(self, n_joints: int, n_control_points: int = 6, degree: int = 5) -> None:
        # Late, so that the node starts fast.
        from scipy.interpolate import BSpline

        self.n_joints = n_joints
        n_functions = n_control_points + N_END_CONDITIONS
        self.breakpoints = np.linspace(0.0, 1.0, n_functions - degree + 1)
        knots = np.concatenate([np.zeros(degree), self.breakpoints, np.ones(degree)])
        self._splines = BSpline(knots, np.eye(n_functions)[:, 3:-3], degree)
        self.n_weights = n_joints * n_control_points
        self.scales = np.ones(self.n_weights)

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        values = np.array([self._splines(phases, d) for d in range(highest + 1)])
        functions = np.kron(np.eye(self.n_joints), values[:, :, None])
        return np.pad(functions, [(0, 0)] * 3 + [(1, 0)])

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        values = np.array([self._splines(phases, d) for d in range(highest + 1)])
        return np.asarray(values @ np.reshape(weights, (self.n_joints, -1)).T)


class SumBasis(Basis):
    """The functions of two bases together; the second corrects the first.

    Parameters
    ----------
    first, second : Basis
        Of the same joints; the mean shape is the sum of theirs.
    usual_correction : float
        Usual magnitude of the weights of the second [rad or m].
    """

    def __init__(self, first: Basis, second: Basis, usual_correction: float) -> None:
        self._first, self._second = first, second
        self.n_joints = first.n_joints
        self.n_weights = first.n_weights + second.n_weights
        self.breakpoints = np.union1d(first.breakpoints, second.breakpoints)
        correction = np.full(second.n_weights, usual_correction)
        self.scales = np.concatenate([first.scales, correction])

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1 + n_weights)."""
        first, second = (b.tables(phases, highest) for b in (self._first, self._second))
        mean = first[..., :1] + second[..., :1]
        return np.concatenate([mean, first[..., 1:], second[..., 1:]], axis=3)

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        leading, other = np.split(weights, [self._first.n_weights])
        first = self._first.shapes(leading, phases, highest)
        return np.asarray(first + self._second.shapes(other, phases, highest))


def legendre_values(
    coefficients: FloatArray, phases: FloatArray, derivative: int = 0
) -> FloatArray:
    """Evaluate Legendre series in x = 2s − 1.

    Parameters
    ----------
    coefficients : array, shape (..., degree + 1)
        Coefficients, lowest degree first.
    phases : array, shape (n_steps,)
        Phases s, from 0 to 1.
    derivative : int
        Which derivative with respect to phase.

    Returns
    -------
    values : array, shape (n_steps, ...)
        The series, or their derivatives, at the phases.
    """
    return np.asarray(legendre_derivatives(coefficients, phases, derivative)[derivative])


def legendre_derivatives(coefficients: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
    """Evaluate Legendre series in x = 2s − 1 with their derivatives, all at once.

    Parameters
    ----------
    coefficients : array, shape (..., degree + 1)
        Coefficients, lowest degree first.
    phases : array, shape (n_steps,)
        Phases s, from 0 to 1.
    highest : int
        The highest derivative with respect to phase.

    Returns
    -------
    values : array, shape (highest + 1, n_steps, ...)
        The series and their derivatives at the phases.
    """
    degree = coefficients.shape[-1] - 1
    table = _table(np.asarray(phases, dtype=np.float64).tobytes(), degree)
    series = coefficients.reshape(-1, degree + 1) @ _differentiations(degree, highest)
    values = table @ series.transpose(0, 2, 1)
    return np.asarray(values.reshape(highest + 1, len(table), *coefficients.shape[:-1]))


@lru_cache(maxsize=16)
def _differentiations(degree: int, highest: int) -> FloatArray:
    """Matrices that take rows of coefficients to those of the derivatives by phase.

    The coefficients are Legendre's, those of the derivatives Chebyshev's, see :func:`_table`.
    """
    nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    # Chebyshev polynomials are orthogonal on these nodes.
    to_chebyshev = np.linalg.solve(
        chebyshev.chebvander(nodes, degree), legendre.legvander(nodes, degree)
    ).T
    matrices = np.zeros((highest + 1, degree + 1, degree + 1))
    for d in range(highest + 1):
        # dx/ds = 2
        derived = chebyshev.chebder(to_chebyshev, d, scl=2.0, axis=1)
        matrices[d, :, : derived.shape[1]] = derived
    return matrices


@lru_cache(maxsize=64)
def _table(phases: bytes, degree: int) -> FloatArray:
    """Chebyshev polynomials at phases, cached because the same phases recur.

    They double by T[m + j] = 2 T[m] T[j] − T[m − j], in fewer steps than Legendre's recurrence.
    """
    x = 2.0 * np.frombuffer(phases) - 1.0
    table, known = np.ones((degree + 1, x.size)), min(degree, 1)
    table[1:2] = x
    while known < degree:
        n = min(known, degree - known)
        new = table[known + 1 : known + n + 1]
        np.multiply(2.0 * table[known], table[1 : n + 1], out=new)
        new -= table[known - n : known][::-1]
        known += n
    return table.T


@lru_cache(maxsize=16)
def end_vanishing_coefficients(degree: int) -> FloatArray:
    """Legendre coefficients of an orthonormal basis of the admissible polynomials.

    The functions are cⱼ s³(1−s)³ Pⱼ⁽⁶˒⁶⁾(2s−1): with the weight s⁶(1−s)⁶ that the square of
    the common factor makes, Jacobi polynomials of parameters (6, 6) are orthogonal on [0, 1].

    Parameters
    ----------
    degree : int
        Highest degree, at least 6.

    Returns
    -------
    coefficients : array, shape (degree - 5, degree + 1)
        One function per row.
    """
    # Late, so that the node starts fast.
    from scipy.special import eval_jacobi

    x, quadrature = legendre.leggauss(degree + 1)
    s = (x + 1.0) / 2.0
    values = np.array(
        [(s * (1.0 - s)) ** 3 * eval_jacobi(j, 6.0, 6.0, x) for j in range(degree - 5)]
    )
    values /= np.sqrt(values**2 @ (quadrature / 2.0))[:, None]
    norms = (2.0 * np.arange(degree + 1) + 1.0) / 2.0
    return np.asarray((values * quadrature) @ legendre.legvander(x, degree) * norms)


@lru_cache(maxsize=16)
def _minimum_jerk_series(n_coefficients: int) -> FloatArray:
    """Legendre coefficients of 10s³ − 15s⁴ + 6s⁵, the minimum-jerk course from 0 to 1."""
    series = polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    by_x = series(polynomial.Polynomial([0.5, 0.5]))
    padded = np.zeros(n_coefficients)
    padded[:6] = legendre.poly2leg(by_x.coef)
    return padded


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
