# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What a constraint of a program is.

A constraint is a list of values between bounds, at some phases of a segment. It starts with the
rows that a motion near the expected one needs, often none. After a check of the motion that was
found, it is refined: by tighter bounds or by more rows. To add a constraint on configurations,
write a class as in :mod:`..path_constraints`; for any other, a class as :class:`Constraint`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.collision import Collision
from ...motion.validation import Violation
from .segment import Course


class Linear(Protocol):
    """Values of a constraint at one x, with their derivatives by the unknowns of its segment."""

    @property
    def values(self) -> FloatArray:
        """The values, shape (n,)."""

    def rows(self, chosen: NDArray[np.intp], bounds: FloatArray | None) -> FloatArray:
        """Derivatives of the chosen values, shape (n_chosen, n_unknowns).

        With bounds of them, derivatives such that steps within these bounds to first order are
        within them altogether, where the constraint can provide them.
        """

    def after(self, step: FloatArray) -> FloatArray:
        """Prediction of the values after a step, correct to first order."""


@dataclass(frozen=True, eq=False)
class Dense:
    """Values with their Jacobian.

    Attributes
    ----------
    values : array, shape (n,)
        The values.
    jacobian : array, shape (n, n_unknowns)
        Their derivatives.
    """

    values: FloatArray
    jacobian: FloatArray

    def rows(self, chosen: NDArray[np.intp], bounds: FloatArray | None) -> FloatArray:
        """The chosen rows of the Jacobian."""
        return np.asarray(self.jacobian[chosen])

    def after(self, step: FloatArray) -> FloatArray:
        """The linear prediction."""
        return np.asarray(self.values + self.jacobian @ step)


@dataclass(frozen=True, eq=False)
class Findings:
    """What the check of a motion found in one segment; times count from its start.

    Attributes
    ----------
    duration : float
        Duration of the segment [s].
    positions : array, shape (n_points, n_joints)
        Positions at the points of the trajectory.
    phases : array, shape (n_points,)
        Their phases.
    violations, touched : sequence of Violation
        Limits that are violated; those and limits that are nearly reached.
    collisions : sequence of Collision
        Collisions; not known if limits are violated.
    """

    duration: float
    positions: FloatArray
    phases: FloatArray
    violations: Sequence[Violation] = ()
    touched: Sequence[Violation] = ()
    collisions: Sequence[Collision] = ()


class Constraint(Protocol):
    """One piece of the constraints of a segment, lower ≤ values ≤ upper.

    Attributes
    ----------
    lower, upper : array, shape (n,)
        The bounds; neighbours along a motion are neighbours here. Empty while nothing is
        constrained.
    """

    lower: FloatArray
    upper: FloatArray

    def at(self, course: Course) -> Linear:
        """The values of a motion."""

    def refined(self, found: Findings) -> Constraint:
        """The constraint with what a check found in a motion within the present one.

        The constraint itself, if the check found nothing for it.
        """

    def everywhere(self) -> Constraint:
        """The constraint with all of its rows."""
