# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion compiler ([P] Section 2): one segment as functions of its unknowns.

The unknowns x are the weights, then the quantities that a request leaves free: boundary values, on
which a motion depends linearly as on its weights, and log T. States of the motion are functions of
them, and so is its objective: J = ½∫‖τ‖²dt ([P] eq. (6)), or another sum of running costs, plus
other terms. With Gauss–Legendre nodes the integral becomes a sum of squares, ½‖r(x)‖², whose
Jacobian follows from the chain rule, ∂τ/∂w = ∂τ/∂q φ + ∂τ/∂q̇ φ'/T + M φ''/T².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...primitives.basis import Basis
from ...robot.model import Robot
from ..motion import N_RATES, Tables, hermite_tables
from ..objectives import QUANTITIES, Nodes, Objective, effort

if TYPE_CHECKING:
    from .constraints import PoseTarget

# Scales of the unknowns: typical changes of boundary values by phase [rad or m], and of log T.
END_SCALES = np.array([0.3, 1.0, 5.0, 0.3, 1.0, 5.0])
LOG_DURATION_SCALE = 0.2
GOAL_POSITION = 3
"""Row of the goal positions among the boundary values."""
# A free duration stays within a factor of 20 of its initial value.
_MAX_LOG = np.log(20.0)
# Powers of the duration in boundary values with respect to phase.
_POWERS = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])


class Unknowns:
    """The unknowns of a segment, in the order of its vector x.

    The unknowns are the weights; changes of the free rows of the boundary values; log T minus that
    of `duration`. Each is in units of its typical change.

    Parameters
    ----------
    weight_scales : array, shape (n_weights,)
        Usual magnitudes of the weights.
    boundary : array, shape (6, n_joints)
        Boundary values with respect to phase.
    duration : float
        Duration [s], or its initial value if it is free.
    free_orders : pair of (sequence of int)
        Orders of the derivatives that are unknowns at the start and at the goal, 0 is the position.
    duration_is_free : bool
        Whether the duration is an unknown.

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
        free_orders: tuple[Sequence[int], Sequence[int]] = ((), ()),
        duration_is_free: bool = False,
    ) -> None:
        self.boundary, self.duration = boundary, duration
        self.free_rows = [*free_orders[0], *map(GOAL_POSITION.__add__, free_orders[1])]
        self.duration_is_free = duration_is_free
        self.n_weights, self.n_joints = weight_scales.size, boundary.shape[1]
        self.n_linear = self.n_weights + self.n_joints * len(self.free_rows)
        self.ends = slice(self.n_weights, self.n_linear)
        self.scales = np.ones(self.n_linear + int(duration_is_free))
        self.scales[: self.n_weights] = weight_scales
        self.scales[self.ends] = np.repeat(END_SCALES[self.free_rows], self.n_joints)
        self.scales[self.n_linear :] = LOG_DURATION_SCALE
        self.powers = np.repeat(_POWERS[self.free_rows], self.n_joints)

    def from_weights(self, weights: FloatArray) -> FloatArray:
        """Unknowns with these weights, and otherwise the values of the request.

        Parameters
        ----------
        weights : array, shape (..., n_weights)
            Weights of one motion or of several.

        Returns
        -------
        x : array, shape (..., n_unknowns)
            The unknowns.
        """
        x = np.zeros((*weights.shape[:-1], self.scales.size))
        x[..., : self.n_weights] = weights / self.scales[: self.n_weights]
        return x

    def weights(self, x: FloatArray) -> FloatArray:
        """The weights w, shape (n_weights,)."""
        return np.asarray((x * self.scales)[: self.n_weights])

    def duration_at(self, x: FloatArray) -> float:
        """The duration [s]."""
        if not self.duration_is_free:
            return self.duration
        change = LOG_DURATION_SCALE * x[self.n_linear]
        return float(self.duration * np.exp(_MAX_LOG * np.tanh(change / _MAX_LOG)))

    def log_duration_slope(self, x: FloatArray) -> float:
        """Derivative of log T by its unknown, if it is free."""
        change = LOG_DURATION_SCALE * x[self.n_linear]
        return float(LOG_DURATION_SCALE / np.cosh(change / _MAX_LOG) ** 2)

    def boundary_at(self, x: FloatArray) -> FloatArray:
        """Boundary values by phase, shape (6, n_joints)."""
        boundary = self.boundary.copy()
        changes = self.scales[self.ends] * x[self.ends]
        boundary[self.free_rows] += changes.reshape(-1, boundary.shape[1])
        boundary *= (self.duration_at(x) / self.duration) ** _POWERS[:, None]
        return boundary

    def accepts(self, duration: float) -> bool:
        """Whether a duration is in the range of a free duration, or equals the fixed one."""
        if not self.duration_is_free:
            return True
        return bool(duration > 0.0 and abs(np.log(duration / self.duration)) < _MAX_LOG)

    def log_duration_unknown(self, duration: float) -> float:
        """The unknown of a duration: the inverse of `duration_at`."""
        change = np.log(duration / self.duration) / _MAX_LOG
        return float(_MAX_LOG * np.arctanh(change) / LOG_DURATION_SCALE)


Timing = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""The part of a free duration in :class:`Slopes`.

The factors of the columns, shape (n_linear,). Then, of each state, shape (n_states,): its factor,
its derivative by the unknown of the duration, and its relative decrease with that unknown on a
given path.
"""


class Slopes(NamedTuple):
    """Derivatives of n_states states by the unknowns at one x, as factors.

    Attributes
    ----------
    columns : array, shape (n_states, n_linear)
        Derivatives by the unknowns on which the motion depends linearly; of states by phase, if the
        duration is free.
    n_unknowns : int
        Number of unknowns.
    timing : Timing or None
        The part of the duration, if that is free.
    """

    columns: FloatArray
    n_unknowns: int
    timing: Timing | None = None

    def after(self, values: FloatArray, step: FloatArray) -> FloatArray:
        """States after a step, by their values before: to first order but for powers of T."""
        n_linear = self.columns.shape[1]
        if self.timing is None:
            return np.asarray(values + self.columns @ step[:n_linear])
        growth, rates, by_duration, decay = self.timing
        along = self.columns @ (growth * step[:n_linear])
        fallen = step[n_linear] * decay
        changes = along * rates + step[n_linear] * by_duration
        return np.asarray((values + changes + fallen * values) * np.exp(-fallen))

    def rows(
        self, chosen: NDArray[np.intp] | slice = slice(None), room: FloatArray | float = 0.0
    ) -> FloatArray:
        """Derivatives of the chosen states, shape (n_chosen, n_unknowns).

        With bounds minus the states as the room, derivatives of dᵏq/dsᵏ − bound · Tᵏ, in units of
        Tᵏ. It is negative where the state is within its bound, linear in the weights and concave in
        log T, so that a step within this bound to first order is within it altogether.
        """
        columns = self.columns[chosen]
        n_linear = columns.shape[1]
        rows = np.zeros((len(columns), self.n_unknowns))
        rows[:, :n_linear] = columns
        if self.timing is not None:
            growth, rates, by_duration, decay = self.timing
            rows[:, :n_linear] *= growth
            rows *= rates[chosen, None]
            rows[:, n_linear] = by_duration[chosen] - decay[chosen] * room
        return rows


class StateMap:
    """States at some phases as functions of the unknowns.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns.
    hermite : array, shape (n_rows, n_phases, 6)
        Quintic Hermite functions, or their derivatives by phase.
    shapes : array, shape (n_rows, n_phases, 1 + n_weights)
        The mean shape and the basis functions, or their derivatives.
    orders, joints : array of int, shape (n_rows,)
        The derivative of which joint's position each row is, and its order (0: the position).
    units : array, shape (n_rows,)
        Units of the states [rad or m, /s, …].
    """

    def __init__(
        self,
        unknowns: Unknowns,
        hermite: FloatArray,
        shapes: FloatArray,
        orders: NDArray[np.intp],
        joints: NDArray[np.intp],
        units: FloatArray,
    ) -> None:
        self._joints, self._units = joints, units
        self._unknowns, self._hermite, self._orders = unknowns, hermite, orders[:, None]
        self._mean = shapes[:, :, 0]
        columns = shapes[:, :, 1:] * unknowns.scales[: unknowns.n_weights]
        for row in unknowns.free_rows:
            own = np.eye(unknowns.boundary.shape[1])[self._joints][:, None, :]
            moved = END_SCALES[row] * self._hermite[:, :, row, None] * own
            columns = np.concatenate([columns, moved], axis=2)
        self._columns = columns.reshape(self._mean.size, columns.shape[2])
        if not unknowns.duration_is_free:
            rates = self._rates(unknowns.duration)
            self._fixed = (self._boundary_part(unknowns.boundary) + self._mean) * rates
            columns = self._columns * np.repeat(rates, self._mean.shape[1], axis=0)
            self._constant = Slopes(columns, unknowns.scales.size)

    def _rates(self, duration: float) -> FloatArray:
        """Factors of the derivatives by phase, shape (n_rows, 1)."""
        return np.asarray(duration ** -self._orders.astype(float) / self._units[:, None])

    def _boundary_part(self, boundary: FloatArray) -> FloatArray:
        return np.asarray((self._hermite @ boundary.T[self._joints][:, :, None])[:, :, 0])

    def at(self, x: FloatArray) -> tuple[FloatArray, Slopes]:
        """The states, shape (n_rows, n_phases), and their derivatives."""
        unknowns, mean = self._unknowns, self._mean
        if not unknowns.duration_is_free:
            values = self._fixed + (self._constant.columns @ x).reshape(mean.shape)
            return np.asarray(values), self._constant
        boundary, weights = unknowns.boundary_at(x), x[: unknowns.n_weights]
        duration, slope = unknowns.duration_at(x), unknowns.log_duration_slope(x)
        rates = self._rates(duration)
        shape = mean + (self._columns[:, : weights.size] @ weights).reshape(mean.shape)
        values = np.asarray((self._boundary_part(boundary) + shape) * rates)
        grown = self._boundary_part(_POWERS[:, None] * boundary)
        by_duration = slope * (grown * rates - self._orders * values).ravel()
        decay = np.asarray(slope * np.repeat(self._orders, mean.shape[1]))
        of_states = np.repeat(rates[:, 0], mean.shape[1])
        growth = np.ones(unknowns.n_linear)
        growth[unknowns.ends] = (duration / unknowns.duration) ** unknowns.powers
        timing = growth, of_states, by_duration, decay
        return values, Slopes(self._columns, unknowns.scales.size, timing)


def positions_at(unknowns: Unknowns, basis: Basis, phases: FloatArray) -> StateMap:
    """Positions of all joints at some phases, joint by joint."""
    return all_states(unknowns, hermite_tables(phases.tobytes())[:1], basis.tables(phases, 0))


def all_states(unknowns: Unknowns, hermite: FloatArray, tables: FloatArray) -> StateMap:
    """States of all joints from Hermite functions and tables of a basis, order by order."""
    n_orders, n_phases, n_joints, n_functions = tables.shape
    orders, joints = np.divmod(np.arange(n_orders * n_joints), n_joints)
    shapes = tables.transpose(0, 2, 1, 3).reshape(-1, n_phases, n_functions)
    return StateMap(unknowns, hermite[orders], shapes, orders, joints, np.ones(joints.size))


@dataclass(frozen=True, eq=False)
class Course:
    """The motion of a segment at one x: what its terms and constraints are functions of.

    Attributes
    ----------
    x : array, shape (n_unknowns,)
        The unknowns.
    states : array, shape (4, n_nodes, n_joints)
        Positions to jerks at the nodes.
    nodes : Nodes
        States and efforts at the nodes.
    slopes : mapping of str to array, shape (n_nodes, n_joints, n_unknowns)
        Derivatives of each of `QUANTITIES` by the unknowns.
    cost : float
        The running costs.
    gradient : array, shape (n_unknowns,)
        Their gradient.
    hessian : array, shape (n_unknowns, n_unknowns)
        The known part of their Hessian.
    """

    x: FloatArray
    states: FloatArray
    nodes: Nodes
    slopes: dict[str, FloatArray]
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
    precision : array, shape (n_unknowns, n_unknowns)
        ρΛ⁻¹ of the scaled unknowns, 0 unless it is set.
    target : PoseTarget or None
        The pose at the end, if the goal positions are unknowns; none unless it is set.
    """

    def __init__(
        self,
        robot: Robot,
        tables: Tables,
        unknowns: Unknowns,
        expected: FloatArray,
        objectives: Sequence[tuple[float, Objective]] = ((1.0, effort),),
    ) -> None:
        self._robot, self._objectives = robot, tuple(objectives)
        self.tables, self.unknowns = tables, unknowns
        self._states = all_states(unknowns, tables.hermite[:, 1:-1], tables.values[:, 1:-1])
        self.expected = unknowns.from_weights(expected)
        self.precision = np.zeros((self.expected.size, self.expected.size))
        self.target: PoseTarget | None = None
        self._known: dict[bytes, Course] = {}
        # Derivatives of positions to jerks, shape (4, n_nodes, n_joints, n_unknowns), and of all
        # but jerks at each node, shape (n_nodes, 3 n_joints, n_unknowns).
        self._slopes: tuple[FloatArray, FloatArray] | None = None

    def at(self, x: FloatArray) -> Course:
        """The motion and its running costs; those of the last x and the expected one are kept."""
        key, expected = x.tobytes(), self.expected.tobytes()
        if key in self._known:
            return self._known[key]
        unknowns, tables, (by_row, by_unknown) = self.unknowns, self.tables, self._states.at(x)
        n_nodes, n_joints, duration = tables.n_nodes, unknowns.n_joints, unknowns.duration_at(x)
        if self._slopes is None or unknowns.duration_is_free:
            rows = by_unknown.rows()
            by_rate = rows.reshape(N_RATES, n_joints, n_nodes, x.size).transpose(0, 2, 1, 3)
            stacked = by_rate[:3].transpose(1, 0, 2, 3).reshape(n_nodes, 3 * n_joints, x.size)
            self._slopes = by_rate, stacked
        by_rate, stacked = self._slopes
        states = by_row.reshape(N_RATES, n_joints, n_nodes).transpose(0, 2, 1)
        tau, dtau = self._robot.inverse_dynamics_derivatives(*states[:3])
        ends = unknowns.boundary[0], unknowns.boundary[GOAL_POSITION]
        nodes = Nodes(self._robot, states[0], states[1], states[2], states[3], tau, *ends)
        slopes = dict(zip(QUANTITIES, (*by_rate, dtau @ stacked), strict=True))
        # The running costs are sums of squares over the nodes.
        residuals, jacobians = [], []
        root = np.sqrt(tables.quadrature * duration)[:, None]
        for weight, objective in self._objectives:
            values, partials = objective(nodes)
            jacobian = np.zeros((*values.shape, x.size))
            for name, partial in partials.items():
                slope = slopes[name]
                jacobian += partial * slope if np.ndim(partial) == 0 else partial @ slope
            if unknowns.duration_is_free:  # the time that each node stands for grows with T
                stretch = unknowns.log_duration_slope(x)
                jacobian[:, :, unknowns.n_linear] += 0.5 * stretch * values
            scale = np.sqrt(weight) * root
            jacobian *= scale[:, :, None]
            residuals.append((values * scale).ravel())
            jacobians.append(jacobian.reshape(values.size, x.size))
        residual, jacobian = np.concatenate(residuals), np.concatenate(jacobians)
        cost = 0.5 * float(residual @ residual)
        costs = cost, residual @ jacobian, jacobian.T @ jacobian
        self._known = {k: one for k, one in self._known.items() if k == expected}
        self._known[key] = course = Course(x, states, nodes, slopes, *costs)
        return course

    def naturalness(self, x: FloatArray) -> tuple[float, FloatArray]:
        """½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ), the cost of deviations from the demonstrations, and its gradient."""
        deviation = x - self.expected
        pull = self.precision @ deviation
        return 0.5 * float(pull @ deviation), pull

    def effort(self, x: FloatArray) -> float:
        """½∫‖τ‖²dt at x, whether it is an objective or not [N²·m²·s]."""
        squares = np.square(self.at(x).nodes.efforts).sum(axis=1)
        return float(0.5 * self.unknowns.duration_at(x) * self.tables.quadrature @ squares)
