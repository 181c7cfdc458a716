# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A continuous motion, q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) with its duration, and its cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, check_number, float_array
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..motion.interpolation import boundary_values, quintics
from ..primitives.basis import Basis
from ..robot.model import Robot
from .objectives import Nodes, Objective
from .program.tables import Tables


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
        return boundary_values(self.start.values, self.goal.values, self.duration)

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

        Raises
        ------
        GoalError
            If the times are not numbers.
        """
        times = float_array(times, "times [s]", GoalError, (None,), is_copied=False)
        phases = np.clip(times / self.duration, 0.0, 1.0)
        states = self._at(phases)
        for phase, end in ((0.0, self.start), (1.0, self.goal)):
            states[:, phases == phase] = np.array(end.values)[:, None]
        return states

    def sample(self, period: float) -> tuple[FloatArray, FloatArray]:
        """Evenly spaced times from 0 to `duration`, at most `period` apart [s], and the states.

        Returns
        -------
        times : array, shape (n_steps,)
            [s].
        states : array, shape (3, n_steps, n_joints)
            See :meth:`evaluate`.

        Raises
        ------
        GoalError
            If the period is no number, or makes more than a million samples.
        """
        check_number(period, "the period [s]", GoalError, 1e-6 * self.duration)
        n_steps = max(math.ceil(self.duration / period - 1e-9), 1)
        phases = np.linspace(0.0, 1.0, n_steps + 1)
        states = self._at(phases)
        for i, end in ((0, self.start), (-1, self.goal)):
            states[:, i] = end.values
        return self.duration * phases, states

    def _at(self, phases: FloatArray) -> FloatArray:
        states = quintics(phases, self.boundary, 2)
        states += self.basis.shapes(self.weights, phases, 2)
        states[1] /= self.duration
        states[2] /= self.duration**2
        return states


def rank_of(cost: float) -> float:
    """The cost in a ranking: a cost that is not a number counts as infinite."""
    return float("inf") if np.isnan(cost) else cost


def cost_of(
    robot: Robot,
    motion: Motion,
    tables: Tables,
    objectives: Sequence[tuple[float, Objective]],
) -> float:
    """Weighted sum of the objectives of a motion on the tables of its basis."""
    q, v, a, jerk = node_states(motion, tables)[:, 1:-1]
    tau = robot.inverse_dynamics(q, v, a)
    nodes = Nodes(robot, q, v, a, jerk, tau, motion.start.positions, motion.goal.positions)
    squares = sum(
        weight * np.sum(objective.residuals(nodes).values ** 2, axis=1)
        for weight, objective in objectives
    )
    return float(0.5 * motion.duration * tables.quadrature @ squares)


def node_states(motion: Motion, tables: Tables) -> FloatArray:
    """Positions to jerks at the start, the nodes and the goal, shape (4, n_nodes + 2, n_joints)."""
    shapes = tables.values @ np.concatenate([[1.0], motion.weights])
    by_phase = tables.hermite @ motion.boundary + shapes
    return np.asarray(by_phase / motion.duration ** np.arange(4.0)[:, None, None])
