# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the solver starts: weights, and what was learned around them before.

Where likeness to the demonstrations counts for little, optima lie tens of usual weights away from
what is expected, but near those of similar requests. So they are found for the demonstrations'
own ends beforehand, which is known as a memory of motion (Lembono et al., "Memory of motion for
warm-starting trajectory optimization", IEEE Robotics and Automation Letters 5(2), 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from .solver import SolverMemory

N_NEAREST = 3
"""Starts that are taken from similar motions."""
MOST_STARTS = 2 + N_NEAREST
"""Starts of components: the expected weights, the mean shape, and those of similar motions."""


class Start(NamedTuple):
    """Where to start.

    Attributes
    ----------
    unknowns : array, shape (n_unknowns,)
        Weights of a family, or the unknowns of a program.
    memory : SolverMemory or None
        What the solver has learned there of a similar program.
    """

    unknowns: FloatArray
    memory: SolverMemory | None = None


@dataclass(frozen=True, eq=False)
class Practice:
    """Starts that suit the ends of some motions.

    Attributes
    ----------
    ends : array, shape (n_motions, 2 * n_joints)
        Start and goal positions [rad or m].
    weights : array, shape (n_motions, n_weights)
        Weights for each of them.
    memories : sequence of SolverMemory
        What the solver has learned there; none, or of each.
    """

    ends: FloatArray
    weights: FloatArray
    memories: Sequence[SolverMemory] = ()

    def nearest(self, ends: FloatArray) -> list[Start]:
        """Those of the motions with the nearest ends, at most `N_NEAREST`, the nearest first.

        Parameters
        ----------
        ends : array, shape (2 * n_joints,)
            Start and goal positions [rad or m].
        """
        distance = np.sum((self.ends - ends) ** 2, axis=1)
        nearest = np.argsort(distance, kind="stable")[:N_NEAREST].tolist()
        if not self.memories:
            return [Start(self.weights[i]) for i in nearest]
        return [Start(self.weights[i], self.memories[i]) for i in nearest]
