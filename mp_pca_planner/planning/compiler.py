# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion compiler ([P] Section 2): from a request to a nonlinear program over few weights.

The objective is J = ½∫‖τ‖²dt ([P] eq. (6)), or another sum of running costs (see
:mod:`.objectives`), plus the naturalness ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ). With Gauss–Legendre nodes the
integral becomes a sum of squares, ½‖r(x)‖², whose Jacobian follows from the chain rule,
∂τ/∂w = ∂τ/∂q φ + ∂τ/∂q̇ φ'/T + M φ''/T².

The unknowns x are the weights, then the quantities that a request leaves free: the goal
configuration, on which a motion depends linearly as on its weights; log T; the phases of vias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..primitives.basis import Basis
from ..robot.model import Robot
from .conditions import Condition, ConditionEquations
from .objectives import QUANTITIES, Effort, Nodes, Objective, Residuals
from .unknowns import N_RATES, QuadratureTables, Unknowns


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The sum of squares at one point.

    Attributes
    ----------
    residual : array, shape (n_residuals,)
        r with the objective ½‖r‖² + naturalness.
    jacobian : array, shape (n_residuals, n_unknowns)
        Derivative of r by the unknowns.
    states : array, shape (4, n_nodes, n_joints)
        Positions, velocities, accelerations and jerks at the nodes.
    efforts : array, shape (n_nodes, n_joints)
        Efforts τ at the nodes.
    effort_jacobian : array, shape (n_nodes, n_joints, n_unknowns)
        Their derivative by the unknowns.
    """

    residual: FloatArray
    jacobian: FloatArray
    states: FloatArray
    efforts: FloatArray
    effort_jacobian: FloatArray


class MotionProgram:
    """The program of one request: unknowns x → objective and conditions.

    Parameters
    ----------
    robot : Robot
        The model, with the joints of the basis.
    tables : QuadratureTables
        The basis at the nodes.
    unknowns : Unknowns
        The meaning of x.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    objectives : sequence of (float, Objective)
        Running costs and their weights; effort alone unless given.
    conditions : sequence of Condition
        Targets between the ends or at the end.

    Attributes
    ----------
    scales : array, shape (n_unknowns,)
        Typical changes of the unknowns.
    precision : array, shape (n_unknowns, n_unknowns)
        ρΛ⁻¹ of the scaled weights; zeros, the initial value, mean no naturalness.
    equations : ConditionEquations
        The conditions as equations of the unknowns.
    """

    def __init__(
        self,
        robot: Robot,
        tables: QuadratureTables,
        unknowns: Unknowns,
        expected: FloatArray,
        *,
        objectives: Sequence[tuple[float, Objective]] = ((1.0, Effort()),),
        conditions: Sequence[Condition] = (),
    ) -> None:
        self._robot = robot
        self._tables = tables
        self._objectives = tuple(objectives)
        self.unknowns = unknowns
        self.scales = self.unknowns.scales
        self.expected = self.unknowns.from_weights(expected)
        self.precision = np.zeros((self.scales.size, self.scales.size))
        self.equations = ConditionEquations(unknowns, tables, conditions)
        self._known: dict[bytes, Linearisation] = {}
        self._states = tables.states(unknowns)
        if not unknowns.duration_is_free:
            self._slopes_at_any_x = self._slopes(self.expected, np.zeros(0))

    def _slopes(self, x: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the states at x, where they have the given values.

        Returns
        -------
        by_rate : array, shape (4, n_nodes, n_joints, n_unknowns)
            Of positions to jerks.
        stacked : array, shape (n_nodes, 3 n_joints, n_unknowns)
            Of positions, velocities and accelerations at each node.
        """
        shape = N_RATES, self._robot.n_joints, self.n_nodes, x.size
        by_rate = self._states.jacobian(x, values).reshape(shape).transpose(0, 2, 1, 3)
        stacked = by_rate[:3].transpose(1, 0, 2, 3).reshape(self.n_nodes, 3 * shape[1], x.size)
        return by_rate, stacked

    @property
    def basis(self) -> Basis:
        """The basis of the weights."""
        return self._tables.basis

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self._tables.n_nodes

    def effort_cost(self, x: FloatArray) -> float:
        """J at x, whether it is an objective or not."""
        known = self._known.get(x.tobytes())
        tau = self._robot.inverse_dynamics(*self.states(x)[:3]) if known is None else known.efforts
        squares = np.square(tau).sum(axis=1)
        return float(0.5 * self.unknowns.duration_at(x) * self._tables.quadrature @ squares)

    def costs(self, candidates: FloatArray) -> FloatArray:
        """The whole objective of candidates x, shape (n_candidates, n_unknowns)."""
        q, v, a, jerk = np.concatenate([self.states(x) for x in candidates], axis=1)
        tau = self._robot.inverse_dynamics(q, v, a)
        ends = self.unknowns.boundary[0], self.unknowns.boundary[3]
        nodes = Nodes(self._robot, q, v, a, jerk, tau, *ends)
        squares = sum(
            weight * np.sum(objective.residuals(nodes).values ** 2, axis=1)
            for weight, objective in self._objectives
        )
        durations = np.array([self.unknowns.duration_at(x) for x in candidates])
        by_candidate = np.reshape(squares, (len(candidates), self.n_nodes))
        natural = np.array([self.naturalness(x) for x in candidates])
        return np.asarray(0.5 * durations * (by_candidate @ self._tables.quadrature) + natural)

    @property
    def at_expected(self) -> Linearisation:
        """The residual and its Jacobian at the expected weights."""
        return self.linearise(self.expected)

    def linearise(self, x: FloatArray) -> Linearisation:
        """The residual and its Jacobian; those of the last x and of the expected one are kept."""
        key, expected = x.tobytes(), self.expected.tobytes()
        if key not in self._known:
            self._known = {k: at for k, at in self._known.items() if k == expected}
            self._known[key] = self._linearised(x)
        return self._known[key]

    def _linearised(self, x: FloatArray) -> Linearisation:
        by_row, timed = self._states.values(x), self.unknowns.duration_is_free
        by_rate, stacked = self._slopes(x, by_row) if timed else self._slopes_at_any_x
        q, v, a, jerk = states = self._in_order(by_row)
        tau, dtau = self._robot.inverse_dynamics_derivatives(q, v, a)
        by_unknown = dtau @ stacked
        ends = self.unknowns.boundary[0], self.unknowns.boundary[3]
        nodes = Nodes(self._robot, q, v, a, jerk, tau, *ends)
        by_quantity = dict(zip(QUANTITIES, (*by_rate, by_unknown), strict=True))
        root = np.sqrt(self._tables.quadrature * self.unknowns.duration_at(x))[:, None]
        slope = self.unknowns.log_duration_slope(x) if timed else 0.0
        parts = [
            self._residuals(objective.residuals(nodes), np.sqrt(weight) * root, by_quantity, slope)
            for weight, objective in self._objectives
        ]
        residual, jacobian = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Linearisation(residual, jacobian, states, tau, by_unknown)

    def _residuals(
        self,
        residuals: Residuals,
        root: FloatArray,
        by_quantity: dict[str, FloatArray],
        slope: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals with their quadrature weights, and their Jacobian by the chain rule."""
        values, n_unknowns = residuals.values, self.scales.size
        parts = [
            partial * by_quantity[name] if np.ndim(partial) == 0 else partial @ by_quantity[name]
            for name, partial in residuals.partials.items()
        ]
        jacobian = sum(parts[1:], parts[0]) if parts else np.zeros((*values.shape, n_unknowns))
        if slope:  # the time that each node stands for grows with T
            jacobian[:, :, self.unknowns.n_linear] += 0.5 * slope * values
        jacobian *= root[:, :, None]
        return (values * root).ravel(), jacobian.reshape(values.size, n_unknowns)

    def naturalness(self, x: FloatArray) -> float:
        """The naturalness term ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ)."""
        deviation = x - self.expected
        return float(0.5 * deviation @ self.precision @ deviation)

    def states(self, x: FloatArray) -> FloatArray:
        """Positions to jerks at the nodes, shape (4, n_nodes, n_joints)."""
        return self._in_order(self._states.values(x))

    def _in_order(self, by_row: FloatArray) -> FloatArray:
        """The states from rows of them, shape (4, n_nodes, n_joints)."""
        by_joint = by_row.reshape(N_RATES, self._robot.n_joints, self.n_nodes)
        return by_joint.transpose(0, 2, 1)
