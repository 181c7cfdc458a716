# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Terms of the objective beside the running costs of :mod:`..objectives`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ...arrays import FloatArray
from .segment import Course, Quadratic


class Term(Protocol):
    """One piece of the objective of a segment."""

    def at(self, course: Course) -> Quadratic:
        """Its value for a motion, with derivatives by the unknowns."""


@dataclass(frozen=True, eq=False)
class Naturalness:
    """½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ), the cost of deviations from the demonstrations.

    Attributes
    ----------
    expected : array, shape (n_unknowns,)
        The unknowns of the expected motion.
    precision : array, shape (n_unknowns, n_unknowns)
        ρΛ⁻¹ of the scaled unknowns.
    """

    expected: FloatArray
    precision: FloatArray

    def at(self, course: Course) -> Quadratic:
        """The term with its derivatives."""
        deviation = course.x - self.expected
        pull = self.precision @ deviation
        return Quadratic(0.5 * float(pull @ deviation), pull, self.precision)
