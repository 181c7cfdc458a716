# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A basis of motions, and starts of the solver in it."""

from __future__ import annotations

from dataclasses import dataclass

from ...arrays import FloatArray
from .tables import Tables

N_NEAREST = 3
"""Number of starts from demonstrations with similar ends."""


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """A basis of motions and the distribution of its weights.

    Attributes
    ----------
    tables : Tables
        The basis at the quadrature nodes and on the grid of the limits.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    precision : array, shape (n_weights, n_weights), or None
        Λ⁻¹; None without a prediction.
    n_components : int
        Number of principal components, the first of the weights; others are of B-splines.
    starts : tuple of array
        Weights to start from; the expected ones come first.
    is_detour : bool
        Whether the expected weights are those of a motion along a collision-free path.
    """

    tables: Tables
    expected: FloatArray
    precision: FloatArray | None
    n_components: int
    starts: tuple[FloatArray, ...]
    is_detour: bool = False


def fixed_basis(tables: Tables) -> MotionBasis:
    """The basis of a motion without weights."""
    return MotionBasis(tables, tables.basis.scales, None, 0, ())
