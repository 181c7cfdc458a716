# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Starts of the solver: weights, and its state at the solution of a similar motion.

With a small naturalness, optima are tens of standard deviations of the weights away from the
expected ones, but near those of similar requests. They are precomputed for the ends of the
demonstrations, as a memory of motion (Lembono et al., "Memory of motion for warm-starting
trajectory optimization", IEEE Robotics and Automation Letters 5(2), 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from .solver import SolverMemory

N_NEAREST = 3
"""Number of starts from similar motions."""
MOST_STARTS = 2 + N_NEAREST
"""Number of starts of components: expected weights, mean shape, and those of similar motions."""


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
    """Solutions of motions between given ends, as warm starts for similar motions.

    Attributes
    ----------
    ends : array, shape (n_motions, 2 * n_joints)
        Start and goal positions [rad or m].
    weights : array, shape (n_motions, n_weights)
        Weights for each of them.
    memories : sequence of SolverMemory
        States of the solver there; none, or of each.
    """

    ends: FloatArray
    weights: FloatArray
    memories: Sequence[SolverMemory] = ()

    def nearest(self, ends: FloatArray) -> list[StartPoint]:
        """Starts from the motions with the nearest ends, at most `N_NEAREST`, the nearest first.

        Parameters
        ----------
        ends : array, shape (2 * n_joints,)
            Start and goal positions [rad or m].
        """
        distance = np.sum((self.ends - ends) ** 2, axis=1)
        nearest = np.argsort(distance, kind="stable")[:N_NEAREST].tolist()
        if not self.memories:
            return [StartPoint(self.weights[i]) for i in nearest]
        return [StartPoint(self.weights[i], self.memories[i]) for i in nearest]
