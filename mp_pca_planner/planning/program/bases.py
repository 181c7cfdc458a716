# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A basis of motions, and starts of the solver in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray
from ..solver.sqp import SolverMemory
from .tables import Tables

N_NEAREST = 3
"""Number of starts from similar motions."""


class StartPoint(NamedTuple):
    """A start of the solver.

    Attributes
    ----------
    unknowns : array, shape (n_unknowns,)
        Weights of a basis, or the unknowns of a program.
    memory : SolverMemory or None
        State of the solver there, for a similar program.
    """

    unknowns: FloatArray
    memory: SolverMemory | None = None


@dataclass(frozen=True, eq=False)
class WarmStarts:
    """Weights of motions between given ends, as starts for similar motions.

    With a small naturalness, optima are tens of standard deviations of the weights away from the
    expected ones, but near those of similar requests. They are precomputed for the ends of the
    demonstrations, as a memory of motion (Lembono et al., "Memory of motion for warm-starting
    trajectory optimization", IEEE Robotics and Automation Letters 5(2), 2020).

    Attributes
    ----------
    ends : array, shape (n_motions, 2 * n_joints)
        Start and goal positions [rad or m].
    weights : array, shape (n_motions, n_weights)
        Weights for each of them.
    memories : sequence of (SolverMemory or None)
        States of the solver there.
    """

    ends: FloatArray
    weights: FloatArray
    memories: Sequence[SolverMemory | None]

    def nearest(self, ends: FloatArray) -> list[StartPoint]:
        """Starts from the motions with the nearest ends, at most `N_NEAREST`, the nearest first."""
        distance = np.sum((self.ends - ends) ** 2, axis=1)
        nearest = np.argsort(distance, kind="stable")[:N_NEAREST].tolist()
        return [StartPoint(self.weights[i], self.memories[i]) for i in nearest]


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
    starts : tuple of StartPoint
        Weights to start from; the expected ones come first.
    is_detour : bool
        Whether the expected weights are those of a motion along a collision-free path.
    """

    tables: Tables
    expected: FloatArray
    precision: FloatArray | None
    n_components: int
    starts: tuple[StartPoint, ...]
    is_detour: bool = False


def fixed_basis(tables: Tables) -> MotionBasis:
    """The basis of a motion without weights."""
    return MotionBasis(tables, tables.basis.scales, None, 0, ())
