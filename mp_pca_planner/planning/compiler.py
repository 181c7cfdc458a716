# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion compiler ([P] Section 2): from a request to a nonlinear program over few weights.

The objective is J = ½∫‖τ‖²dt ([P] eq. (6)), or another sum of running costs (see
:mod:`.objectives`), plus the naturalness ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ). With Gauss–Legendre nodes the
integral becomes a sum of squares, ½‖r(x)‖², whose Jacobian follows from the chain rule,
∂τ/∂w = ∂τ/∂q φ + ∂τ/∂q̇ φ'/T + M φ''/T².

The unknowns x are the weights, then what a request leaves free: the goal configuration, of
which a motion is as linear a function as of its weights; log T; the phases of vias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..primitives.basis import Basis
from ..primitives.boundary import hermite_functions
from ..robot.model import Robot
from .conditions import Condition
from .objectives import QUANTITIES, Effort, Nodes, Objective, Residuals

DEFAULT_NODES = 28
# Positions, velocities, accelerations and jerks.
N_RATES = 4
# Usual changes of a goal configuration [rad or m] and of log T: units of those unknowns.
GOAL_SCALE, LOG_DURATION_SCALE = 0.3, 0.2
# A free duration stays within a factor of 20 of where its search begins.
_MOST_LOG = np.log(20.0)
# How boundary values with respect to phase grow with the duration.
_POWERS = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])
# Six nodes in each piece of a spline keep the integral to 0.02 % even where a motion thrashes
# (benchmarks/planning_speed.py).
_FEWEST_NODES_PER_PIECE = 6


class QuadratureTables:
    """Everything about a basis at the quadrature nodes that no request changes.

    Parameters
    ----------
    basis : Basis
        The family of shapes.
    n_nodes : int
        Gauss–Legendre nodes in all, shared evenly by the smooth pieces of the basis; at least
        six in each piece.

    Attributes
    ----------
    phases : array, shape (n_nodes,)
        Phases of the nodes.
    quadrature : array, shape (n_nodes,)
        Quadrature weights; they add up to 1.
    hermite : array, shape (4, n_nodes, 6)
        Quintic Hermite functions and their first three derivatives by phase.
    mean : array, shape (4, n_nodes, n_joints)
        The same of the mean shape.
    functions : array, shape (n_nodes, 4, n_joints, n_weights)
        The same of the basis functions, each times the usual magnitude of its weight, so
        that the unknowns of the program are of order 1.
    """

    def __init__(self, basis: Basis, n_nodes: int = DEFAULT_NODES) -> None:
        edges = basis.breakpoints
        per_piece = max(int(np.ceil(n_nodes / (len(edges) - 1))), _FEWEST_NODES_PER_PIECE)
        x, w = _gauss_legendre(per_piece)
        widths = np.diff(edges)[:, None]
        phases = (edges[:-1, None] + widths * (x + 1.0) / 2.0).ravel()
        self.basis = basis
        self.phases = phases
        self.quadrature = (widths * w / 2.0).ravel()
        self.hermite = hermite_tables(phases.tobytes())
        tables = basis.tables(phases, N_RATES - 1)
        self.mean = tables[..., 0]
        self.functions = tables[..., 1:].transpose(1, 0, 2, 3) * basis.scales

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return int(self.quadrature.size)


@lru_cache(maxsize=64)
def _gauss_legendre(n_nodes: int) -> tuple[FloatArray, FloatArray]:
    return legendre.leggauss(n_nodes)


@lru_cache(maxsize=64)
def hermite_tables(phases: bytes) -> FloatArray:
    """Quintic Hermite functions and their first three derivatives, shape (4, n_phases, 6)."""
    return np.array([hermite_functions(np.frombuffer(phases), d) for d in range(N_RATES)])


class Unknowns:
    """What a request leaves to the solver, in the order of the program's vector x.

    The unknowns are the weights; changes of the goal positions; log T less that of `duration`;
    the places of conditions of free phase. Each is in units of its usual change.

    Parameters
    ----------
    weight_scales : array, shape (n_weights,)
        Usual magnitudes of the weights.
    boundary : array, shape (6, n_joints)
        Boundary values with respect to phase.
    duration : float
        Duration [s], or where its search begins.
    goal_is_free, duration_is_free : bool
        Whether goal positions and duration are unknowns.
    n_places : int
        Number of conditions of free phase.

    Attributes
    ----------
    scales : array, shape (n_unknowns,)
        Usual changes of the unknowns.
    """

    def __init__(
        self,
        weight_scales: FloatArray,
        boundary: FloatArray,
        duration: float,
        *,
        goal_is_free: bool = False,
        duration_is_free: bool = False,
        n_places: int = 0,
    ) -> None:
        self.boundary, self.duration = boundary, duration
        self.goal_is_free, self.duration_is_free = goal_is_free, duration_is_free
        self.n_weights, n_joints = weight_scales.size, boundary.shape[1]
        self.goal = slice(self.n_weights, self.n_weights + n_joints * goal_is_free)
        self.n_linear = self.goal.stop
        self.first_place = self.n_linear + int(duration_is_free)
        self.scales = np.ones(self.first_place + n_places)
        self.scales[: self.n_weights] = weight_scales
        self.scales[self.goal] = GOAL_SCALE
        self.scales[self.n_linear : self.first_place] = LOG_DURATION_SCALE

    def from_weights(self, weights: FloatArray) -> FloatArray:
        """Unknowns of these weights, all else as the request has it, shape (n_unknowns,)."""
        x = np.zeros(self.scales.size)
        x[: self.n_weights] = weights / self.scales[: self.n_weights]
        return x

    def weights(self, x: FloatArray) -> FloatArray:
        """The weights w, shape (n_weights,)."""
        return np.asarray((x * self.scales)[: self.n_weights])

    def duration_at(self, x: FloatArray) -> float:
        """The duration [s]."""
        if not self.duration_is_free:
            return self.duration
        change = LOG_DURATION_SCALE * x[self.n_linear]
        return float(self.duration * np.exp(_MOST_LOG * np.tanh(change / _MOST_LOG)))

    def log_duration_slope(self, x: FloatArray) -> float:
        """Derivative of log T by its unknown, if it is free."""
        change = LOG_DURATION_SCALE * x[self.n_linear]
        return float(LOG_DURATION_SCALE / np.cosh(change / _MOST_LOG) ** 2)

    def boundary_at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Boundary values by phase, and their derivative by log T, each shape (6, n_joints)."""
        boundary = self.boundary * (self.duration_at(x) / self.duration) ** _POWERS[:, None]
        if self.goal_is_free:
            boundary[3] += GOAL_SCALE * x[self.goal]
        return boundary, _POWERS[:, None] * boundary


class Rows(NamedTuple):
    """Which states a :class:`StateMap` is of: a derivative of a joint's position each.

    Attributes
    ----------
    orders, joints : array of int, shape (n_rows,)
        Order of the derivative (0: the position), and the joint.
    units : array, shape (n_rows,)
        In which the state is told [rad or m, /s, …].
    """

    orders: NDArray[np.intp]
    joints: NDArray[np.intp]
    units: FloatArray


class StateMap:
    """States at some phases as functions of the unknowns.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns.
    hermite : array, shape (4, n_phases, 6)
        Quintic Hermite functions and their first three derivatives by phase.
    mean : array, shape (4, n_phases, n_joints)
        The same of the mean shape.
    functions : array, shape (4, n_phases, n_joints, n_weights)
        The same of the basis functions, times the scales of their weights.
    rows : Rows, optional
        Which states; all, in SI units, order by order, unless given.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        hermite: FloatArray,
        mean: FloatArray,
        functions: FloatArray,
        rows: Rows | None = None,
    ) -> None:
        n_joints = mean.shape[2]
        if rows is None:
            every = np.arange(N_RATES * n_joints)
            rows = Rows(every // n_joints, every % n_joints, np.ones(every.size))
        orders, self._joints, self._units = rows
        self._unknowns, self._hermite, self._orders = unknowns, hermite[orders], orders[:, None]
        self._mean = mean[orders, :, self._joints]
        columns = functions[orders, :, self._joints]
        if unknowns.goal_is_free:
            moved = GOAL_SCALE * np.eye(n_joints)[self._joints]
            moved = self._hermite[:, :, 3, None] * moved[:, None, :]
            columns = np.concatenate([columns, moved], axis=2)
        if unknowns.duration_is_free:
            self._columns = columns
            return
        rates = self._rates(unknowns.duration)
        rows_of_all = np.zeros((*columns.shape[:2], unknowns.scales.size))
        np.multiply(columns, rates[:, :, None], out=rows_of_all[:, :, : unknowns.n_linear])
        self._constant = rows_of_all.reshape(self._mean.size, unknowns.scales.size)
        self._fixed = (self._boundary_part(unknowns.boundary) + self._mean) * rates

    def _rates(self, duration: float) -> FloatArray:
        """What derivatives by phase are to be multiplied by, shape (n_rows, 1)."""
        return np.asarray(duration ** -self._orders.astype(float) / self._units[:, None])

    def _boundary_part(self, boundary: FloatArray) -> FloatArray:
        return np.asarray((self._hermite @ boundary.T[self._joints][:, :, None])[:, :, 0])

    def values(self, x: FloatArray) -> FloatArray:
        """The states, shape (n_rows, n_phases)."""
        if not self._unknowns.duration_is_free:
            return np.asarray(self._fixed + (self._constant @ x).reshape(self._fixed.shape))
        boundary, _ = self._unknowns.boundary_at(x)
        weights = x[: self._unknowns.n_weights]
        shape = self._mean + self._columns[:, :, : weights.size] @ weights
        rates = self._rates(self._unknowns.duration_at(x))
        return np.asarray((self._boundary_part(boundary) + shape) * rates)

    def jacobian(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Their derivatives at x, shape (n_rows * n_phases, n_unknowns)."""
        unknowns = self._unknowns
        if not unknowns.duration_is_free:
            return self._constant
        rates, (_, growth) = self._rates(unknowns.duration_at(x)), unknowns.boundary_at(x)
        columns = np.zeros((*values.shape, x.size))
        columns[:, :, : unknowns.n_linear] = self._columns * rates[:, :, None]
        by_log_duration = self._boundary_part(growth) * rates - self._orders * values
        columns[:, :, unknowns.n_linear] = unknowns.log_duration_slope(x) * by_log_duration
        return columns.reshape(values.size, x.size)


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
    boundary : array, shape (6, n_joints)
        Boundary values with respect to phase.
    duration : float
        Duration [s], or where its search begins.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    objectives : sequence of (float, Objective)
        Running costs and their weights; effort alone unless given.
    goal_is_free, duration_is_free : bool
        Whether goal positions and duration are unknowns.
    conditions : sequence of Condition
        What to meet on the way or at the end.

    Attributes
    ----------
    unknowns : Unknowns
        What x means.
    scales : array, shape (n_unknowns,)
        Usual changes of the unknowns.
    precision : array, shape (n_unknowns, n_unknowns)
        ρΛ⁻¹ of the scaled weights; zeros, as at first, leave naturalness out.
    """

    def __init__(
        self,
        robot: Robot,
        tables: QuadratureTables,
        boundary: FloatArray,
        duration: float,
        expected: FloatArray,
        *,
        objectives: Sequence[tuple[float, Objective]] = ((1.0, Effort()),),
        goal_is_free: bool = False,
        duration_is_free: bool = False,
        conditions: Sequence[Condition] = (),
    ) -> None:
        self._robot = robot
        self._tables = tables
        self._objectives = tuple(objectives)
        self._conditions = tuple(conditions)
        self.unknowns = Unknowns(
            tables.basis.scales,
            boundary,
            duration,
            goal_is_free=goal_is_free,
            duration_is_free=duration_is_free,
            n_places=sum(condition.phase is None for condition in self._conditions),
        )
        self.scales = self.unknowns.scales
        self.expected = self.unknowns.from_weights(expected)
        self.precision = np.zeros((self.scales.size, self.scales.size))
        functions = tables.functions.transpose(1, 0, 2, 3)
        self._states = StateMap(self.unknowns, tables.hermite, tables.mean, functions)
        if not duration_is_free:
            at_any_x = self._states.jacobian(self.expected, np.zeros(0))
            self._stacked = self._stack(at_any_x)

    def _stack(self, state_jacobian: FloatArray) -> FloatArray:
        """Derivatives of (q, v, a) at each node, shape (n_nodes, 3 n_joints, n_unknowns)."""
        n_rows = 3 * self._robot.n_joints
        by_row = state_jacobian[: n_rows * self.n_nodes].reshape(
            n_rows, self.n_nodes, self.scales.size
        )
        return np.ascontiguousarray(by_row.transpose(1, 0, 2))

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self._tables.n_nodes

    def effort_costs(self, candidates: FloatArray) -> FloatArray:
        """J of candidates x, shape (n_candidates, n_unknowns), without derivatives."""
        states = np.stack([self.states(x)[:3] for x in candidates], axis=1)
        _, n_candidates, n_nodes, n_joints = states.shape
        tau = self._robot.inverse_dynamics(*states.reshape(3, -1, n_joints))
        durations = np.array([self.unknowns.duration_at(x) for x in candidates])
        squares = np.sum(tau.reshape(n_candidates, n_nodes, n_joints) ** 2, axis=2)
        return np.asarray(0.5 * durations * (squares @ self._tables.quadrature))

    def linearise(self, x: FloatArray) -> Linearisation:
        """The residual and its Jacobian."""
        by_row = self._states.values(x)
        state_jacobian = self._states.jacobian(x, by_row)
        states = self._in_order(by_row)
        timed = self.unknowns.duration_is_free
        stacked = self._stack(state_jacobian) if timed else self._stacked
        q, v, a, jerk = states
        tau, dtau = self._robot.inverse_dynamics_derivatives(q, v, a)
        by_unknown = dtau @ stacked
        ends = self.unknowns.boundary[0], self.unknowns.boundary[3]
        nodes = Nodes(self._robot, q, v, a, jerk, tau, *ends)
        by_rate = state_jacobian.reshape(N_RATES, self._robot.n_joints, self.n_nodes, x.size)
        by_quantity = dict(
            zip(QUANTITIES, (*by_rate.transpose(0, 2, 1, 3), by_unknown), strict=True)
        )
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
        values = residuals.values
        jacobian = np.zeros((*values.shape, self.scales.size))
        for quantity, partial in residuals.partials.items():
            by_unknown = by_quantity[quantity]
            jacobian += partial * by_unknown if np.ndim(partial) == 0 else partial @ by_unknown
        if slope:  # the time that each node stands for grows with T
            jacobian[:, :, self.unknowns.n_linear] += 0.5 * slope * values
        jacobian *= root[:, :, None]
        return (values * root).ravel(), jacobian.reshape(values.size, self.scales.size)

    def costs(self, candidates: FloatArray) -> FloatArray:
        """The whole objective of candidates x, shape (n_candidates, n_unknowns)."""
        natural = np.array([self.naturalness(x) for x in candidates])
        if all(isinstance(objective, Effort) for _, objective in self._objectives):
            weight = sum(weight for weight, _ in self._objectives)
            return np.asarray(weight * self.effort_costs(candidates) + natural)
        residuals = (self.linearise(x).residual for x in candidates)
        return np.asarray([0.5 * float(r @ r) for r in residuals] + natural)

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

    def equalities(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the conditions are missed by, shape (m,), and the derivative, (m, n_unknowns)."""
        errors, rows = [np.zeros(0)], [np.zeros((0, x.size))]
        place = self.unknowns.first_place
        for condition, (phase, slope) in zip(self._conditions, self._phases(x), strict=True):
            q, by_unknown, by_phase = self._positions_at(phase, x)
            if condition.phase is None:
                by_unknown[:, place] = by_phase * slope
                place += 1
            error, by_position = condition.target.error(q)
            errors.append(error)
            rows.append(by_position @ by_unknown)
        return np.concatenate(errors), np.concatenate(rows)

    def phases(self, x: FloatArray) -> list[float]:
        """The phases of the conditions."""
        return [phase for phase, _ in self._phases(x)]

    def _phases(self, x: FloatArray) -> list[tuple[float, float]]:
        """The phases of the conditions, and their derivatives by their places."""
        places = iter(x[self.unknowns.first_place :])
        return [c.phase_at(next(places) if c.phase is None else 0.0) for c in self._conditions]

    def _positions_at(
        self, phase: float, x: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions at a phase, their derivatives by the unknowns and by the phase."""
        basis, unknowns, at = self._tables.basis, self.unknowns, np.array([phase])
        boundary, growth = unknowns.boundary_at(x)
        weights = unknowns.weights(x)
        q, by_phase = (
            hermite_functions(at, d)[0] @ boundary + basis.shape(weights, at, d)[0]
            for d in range(2)
        )
        hermite = hermite_functions(at)[0]
        rows = np.zeros((q.size, x.size))
        rows[:, : unknowns.n_weights] = basis.functions(at)[0] * basis.scales
        if unknowns.goal_is_free:
            rows[:, unknowns.goal] = GOAL_SCALE * hermite[3] * np.eye(q.size)
        if unknowns.duration_is_free:
            rows[:, unknowns.n_linear] = unknowns.log_duration_slope(x) * (hermite @ growth)
        return q, rows, by_phase
