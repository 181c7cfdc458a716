# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Costs of given motions, without derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...robot.model import Robot
from ..motion import Motion
from ..objectives import Effort, Nodes, Objective
from .tables import Tables


def rank_of(cost: float) -> float:
    """The cost in a ranking: a cost that is not a number counts as infinite."""
    return float("inf") if np.isnan(cost) else cost


def effort_of(robot: Robot, motion: Motion) -> float:
    """½∫‖τ‖²dt of a motion [N²·m²·s].

    Parameters
    ----------
    robot : Robot
        The model.
    motion : Motion
        The motion.
    """
    return cost_of(robot, motion, Tables(motion.basis), [(1.0, Effort())])


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
