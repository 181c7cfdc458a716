# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear programs: the contract between compiler and solver.

A program is: minimise f(x) subject to l ≤ c(x) ≤ u and e(x) = 0. Its unknowns x (weights, a
goal configuration, a log duration, …) are to be scaled so that usual steps are of order 1,
its inequalities to shares of their bounds, its equalities to SI units. Inequalities of one limit
along a motion are neighbours: of several adjacent violations, only the largest is needed as a
constraint.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray

FEASIBLE = 1e-6
"""Sum of constraint violations that counts as rounding, in shares of the limits and SI units."""

ROUNDING = 1e-9
"""Violation of an inequality that counts as rounding."""


class Point(Protocol):
    """Everything about a program at one x of n unknowns."""

    @property
    def cost(self) -> float:
        """Objective f."""

    @property
    def gradient(self) -> FloatArray:
        """∇f, shape (n,)."""

    @property
    def hessian(self) -> FloatArray:
        """The part of ∇²f that is known, shape (n, n), symmetric.

        RᵀR of sums of squares, exact Hessians of quadratic terms. The solver estimates the rest,
        the curvature of the constraints included, from the gradients.
        """

    @property
    def inequalities(self) -> FloatArray:
        """c, shape (n_inequalities,); there may be thousands."""

    def inequality_rows(
        self, chosen: NDArray[np.intp], values: FloatArray | None = None
    ) -> FloatArray:
        """∂c/∂x of the chosen ones, shape (n_chosen, n).

        With other values of them, shape (n_chosen,), derivatives such that steps within these
        values to first order are within them altogether, where the program can provide them.
        """

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Prediction of all of them, correct to first order, shape (n_inequalities,)."""

    @property
    def equalities(self) -> FloatArray:
        """e, shape (n_equalities,), fewer than unknowns."""

    @property
    def equality_rows(self) -> FloatArray:
        """∂e/∂x, shape (n_equalities, n)."""


class Program(Protocol):
    """A nonlinear program."""

    @property
    def lower(self) -> FloatArray:
        """Lower bounds l of the inequalities, shape (n_inequalities,); may be −∞."""

    @property
    def upper(self) -> FloatArray:
        """Upper bounds u of the inequalities, shape (n_inequalities,); may be ∞."""

    def evaluate(self, x: FloatArray) -> Point:
        """Value and derivatives at x, shape (n,)."""

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """Only e at x."""


def infeasibility(program: Program, at: Point) -> float:
    """Sum of the violations of all constraints."""
    outside = outside_bounds(program, at.inequalities)
    return sum_of_peaks(outside) + float(np.abs(at.equalities).sum())


def outside_bounds(program: Program, values: FloatArray) -> FloatArray:
    """Distances of inequalities beyond their nearer bounds, negative within them."""
    outside: FloatArray = values - program.upper
    return np.maximum(outside, program.lower - values, out=outside)


def sum_of_peaks(outside: FloatArray) -> float:
    """Sum of the largest violations of each arc of neighbours, of distances beyond bounds."""
    where = np.flatnonzero(outside > 0.0)
    if not where.size:
        return 0.0
    starts = np.append(0, np.flatnonzero(where[1:] - where[:-1] > 1) + 1)
    return float(np.maximum.reduceat(outside[where], starts).sum())


def violated_sides(program: Program, values: FloatArray, outside: FloatArray) -> NDArray[np.intp]:
    """Sides of inequalities at peaks of violation, and of their neighbours.

    The neighbours are included because a constrained peak often moves by one point. Side 2i is the
    lower bound of inequality i, 2i + 1 the upper one.
    """
    broken = np.flatnonzero(outside > ROUNDING)
    if not broken.size:
        return broken
    by, last = outside[broken], outside.size - 1
    rises = (by > outside[broken - 1]) | (broken == 0)
    peaks = broken[rises & (by >= outside[np.minimum(broken + 1, last)])]
    near = np.concatenate([peaks, peaks - 1, peaks + 1])
    near = near[(near >= 0) & (near <= last)]
    return np.asarray(2 * near + (values[near] - program.upper[near] == outside[near]))
