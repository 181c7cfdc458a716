# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion compiler ([P] Section 2): one segment as functions of its unknowns.

The objective is J = ½∫‖τ‖²dt ([P] eq. (6)), or another sum of running costs, plus other terms.
With Gauss–Legendre nodes the integral becomes a sum of squares, ½‖r(x)‖², whose Jacobian follows
from the chain rule, ∂τ/∂w = ∂τ/∂q φ + ∂τ/∂q̇ φ'/T + M φ''/T².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray
from ...robot.model import Robot
from ..objectives import QUANTITIES, Effort, Nodes, Objective
from .tables import Tables
from .unknowns import N_RATES, Unknowns, all_states


@dataclass(frozen=True, eq=False)
class Course:
    """The motion of a segment at one x: what its terms and constraints are functions of.

    Attributes
    ----------
    x : array, shape (n_unknowns,)
        The unknowns.
    duration : float
        The duration T [s].
    stretch : float
        Derivative of log T by its unknown; 0 if the duration is fixed.
    states : array, shape (4, n_nodes, n_joints)
        Positions to jerks at the nodes.
    nodes : Nodes
        States and efforts at the nodes.
    slopes : mapping of str to array, shape (n_nodes, n_joints, n_unknowns)
        Derivatives of each of `QUANTITIES` by the unknowns.
    """

    x: FloatArray
    duration: float
    stretch: float
    states: FloatArray
    nodes: Nodes
    slopes: dict[str, FloatArray]


class Quadratic(NamedTuple):
    """A term of the objective at one x: its value, gradient and the known part of its Hessian."""

    cost: float
    gradient: FloatArray
    hessian: FloatArray


class SegmentProgram:
    """The running costs of a segment as functions of its unknowns.

    Parameters
    ----------
    robot : Robot
        The model, with the joints of the basis.
    tables : Tables
        The basis at the nodes.
    unknowns : Unknowns
        The meaning of x.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    objectives : sequence of (float, Objective)
        Running costs and their weights; effort alone unless given.

    Attributes
    ----------
    expected : array, shape (n_unknowns,)
        The unknowns of the expected weights.
    """

    def __init__(
        self,
        robot: Robot,
        tables: Tables,
        unknowns: Unknowns,
        expected: FloatArray,
        objectives: Sequence[tuple[float, Objective]] = ((1.0, Effort()),),
    ) -> None:
        self._robot, self._objectives = robot, tuple(objectives)
        self.tables, self.unknowns = tables, unknowns
        self._states = all_states(unknowns, tables.hermite[:, 1:-1], tables.values[:, 1:-1])
        self.expected = unknowns.from_weights(expected)
        self._known: dict[bytes, tuple[Course, Quadratic]] = {}
        # Derivatives of positions to jerks, shape (4, n_nodes, n_joints, n_unknowns), and of all
        # but jerks at each node, shape (n_nodes, 3 n_joints, n_unknowns).
        self._slopes: tuple[FloatArray, FloatArray] | None = None

    def at(self, x: FloatArray) -> tuple[Course, Quadratic]:
        """The motion and its running costs; those of the last x and the expected one are kept."""
        key, expected = x.tobytes(), self.expected.tobytes()
        if key not in self._known:
            if expected in self._known:
                self._known = {expected: self._known[expected]}
            course = self._course(x)
            self._known[key] = course, self._costs(course)
        return self._known[key]

    def _course(self, x: FloatArray) -> Course:
        unknowns, timed = self.unknowns, self.unknowns.duration_is_free
        duration, by_row = unknowns.duration_at(x), self._states.values(x)
        if self._slopes is None or timed:
            n_nodes, n_joints = self.tables.n_nodes, unknowns.n_joints
            rows = self._states.jacobian(x, by_row).reshape(N_RATES, n_joints, n_nodes, x.size)
            by_rate = rows.transpose(0, 2, 1, 3)
            stacked = by_rate[:3].transpose(1, 0, 2, 3).reshape(n_nodes, 3 * n_joints, x.size)
            self._slopes = by_rate, stacked
        by_rate, stacked = self._slopes
        states = self._in_order(by_row)
        tau, dtau = self._robot.inverse_dynamics_derivatives(*states[:3])
        ends = unknowns.boundary[0], unknowns.boundary[3]
        nodes = Nodes(self._robot, states[0], states[1], states[2], states[3], tau, *ends)
        slopes = dict(zip(QUANTITIES, (*by_rate, dtau @ stacked), strict=True))
        stretch = unknowns.log_duration_slope(x) if timed else 0.0
        return Course(x, duration, stretch, states, nodes, slopes)

    def _costs(self, at: Course) -> Quadratic:
        """The sum of the running costs: sums of squares over the nodes."""
        residuals, rows = [], []
        root = np.sqrt(self.tables.quadrature * at.duration)[:, None]
        for weight, objective in self._objectives:
            values, partials = objective.residuals(at.nodes)
            jacobian = np.zeros((*values.shape, at.x.size))
            for name, partial in partials.items():
                slope = at.slopes[name]
                jacobian += partial * slope if np.ndim(partial) == 0 else partial @ slope
            if at.stretch:  # the time that each node stands for grows with T
                jacobian[:, :, self.unknowns.n_linear] += 0.5 * at.stretch * values
            scale = np.sqrt(weight) * root
            jacobian *= scale[:, :, None]
            residuals.append((values * scale).ravel())
            rows.append(jacobian.reshape(values.size, at.x.size))
        residual, jacobian = np.concatenate(residuals), np.concatenate(rows)
        cost = 0.5 * float(residual @ residual)
        return Quadratic(cost, residual @ jacobian, jacobian.T @ jacobian)

    def effort(self, x: FloatArray) -> float:
        """½∫‖τ‖²dt at x, whether it is an objective or not [N²·m²·s]."""
        if x.tobytes() in self._known:
            tau = self.at(x)[0].nodes.efforts
        else:
            tau = self._robot.inverse_dynamics(*self.states(x)[:3])
        squares = np.square(tau).sum(axis=1)
        return float(0.5 * self.unknowns.duration_at(x) * self.tables.quadrature @ squares)

    def costs(self, candidates: FloatArray) -> FloatArray:
        """The running costs of candidates x, shape (n_candidates, n_unknowns)."""
        q, v, a, jerk = np.concatenate([self.states(x) for x in candidates], axis=1)
        tau = self._robot.inverse_dynamics(q, v, a)
        ends = self.unknowns.boundary[0], self.unknowns.boundary[3]
        nodes = Nodes(self._robot, q, v, a, jerk, tau, *ends)
        squares = sum(
            weight * np.sum(objective.residuals(nodes).values ** 2, axis=1)
            for weight, objective in self._objectives
        )
        durations = np.array([self.unknowns.duration_at(x) for x in candidates])
        by_candidate = np.reshape(squares, (len(candidates), self.tables.n_nodes))
        return np.asarray(0.5 * durations * (by_candidate @ self.tables.quadrature))

    def states(self, x: FloatArray) -> FloatArray:
        """Positions to jerks at the nodes, shape (4, n_nodes, n_joints)."""
        return self._in_order(self._states.values(x))

    def _in_order(self, by_row: FloatArray) -> FloatArray:
        """The states from rows of them, shape (4, n_nodes, n_joints)."""
        by_joint = by_row.reshape(N_RATES, self.unknowns.n_joints, self.tables.n_nodes)
        return by_joint.transpose(0, 2, 1)
