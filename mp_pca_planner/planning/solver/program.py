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
