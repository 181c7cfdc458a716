# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A continuous motion: q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) with its duration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..primitives.basis import Basis
from ..primitives.boundary import boundary_values, quintics


@dataclass(frozen=True, eq=False)
class Motion:
    """A continuous motion between two states.

    Attributes
    ----------
    start, goal : JointState
        States at the ends, of the same n_joints joints.
    duration : float
        Duration T [s].
    basis : Basis
        The basis of shapes.
    weights : array, shape (n_weights,)
        Weights of its functions.
    """

    start: JointState
    goal: JointState
    duration: float
    basis: Basis
    weights: FloatArray

    @property
    def boundary(self) -> FloatArray:
        """Boundary values with respect to phase, shape (6, n_joints)."""
        ends = [(x.positions, x.velocities, x.accelerations) for x in (self.start, self.goal)]
        return boundary_values(ends[0], ends[1], self.duration)

    def evaluate(self, times: FloatArray) -> FloatArray:
        """Positions, velocities and accelerations.

        Parameters
        ----------
        times : array, shape (n_steps,)
            Times from 0 to `duration` [s].

        Returns
        -------
        states : array, shape (3, n_steps, n_joints)
            [rad or m], [/s], [/s²]. At the ends they equal those of `start` and `goal` exactly,
            because a controller rejects a final velocity of 1e-17.
        """
        phases = np.clip(times / self.duration, 0.0, 1.0)
        states = self._at(phases)
        for phase, state in ((0.0, self.start), (1.0, self.goal)):
            states[:, phases == phase] = np.array(state.values)[:, None]
        return states

    def sample(self, period: float) -> tuple[FloatArray, FloatArray]:
        """Evenly spaced times from 0 to `duration`, at most `period` apart [s], and the states.

        Returns
        -------
        times : array, shape (n_steps,)
            [s].
        states : array, shape (3, n_steps, n_joints)
            See :meth:`evaluate`.
        """
        n_steps = max(math.ceil(self.duration / period - 1e-9), 1)
        phases = np.linspace(0.0, 1.0, n_steps + 1)
        states = self._at(phases)
        states[:, 0], states[:, -1] = self.start.values, self.goal.values
        return self.duration * phases, states

    def _at(self, phases: FloatArray) -> FloatArray:
        states = quintics(phases, self.boundary, 2)
        states += self.basis.shapes(self.weights, phases, 2)
        states[1] /= self.duration
        states[2] /= self.duration**2
        return states
