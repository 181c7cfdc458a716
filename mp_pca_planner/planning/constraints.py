# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits as inequalities of the motion program, on a dense grid.

Positions and their derivatives are linear in the weights, so their constraints are exact and
cost a product of matrices. Efforts are computed at the quadrature nodes anyway; between them
they are smooth, so the polynomial through the nodes of each piece interpolates them.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.interpolation import hermite_functions
from ..motion.validation import Violation
from ..robot.limits import JointLimits
from .compiler import Linearisation, MotionProgram
from .unknowns import (
    N_RATES,
    QuadratureTables,
    Rows,
    Slopes,
    StateMap,
    hermite_tables,
)

# Margin between motions and limits, as a share of the limit. It leaves room for what the bounds of
# peaks between points of the grid miss, which the check on the denser grid finds.
MARGIN = 2e-4
# Points of the grid. Peaks of accelerations are bounded to about 0.1 %.
N_LIMIT_POINTS = 150
# Distance of the first and last point from the ends of the motion, as a share of the duration.
_INSIDE = 1e-6
# Share of Chebyshev's points in the grid, 0 to 1; the rest is even. Polynomials change fastest near
# their ends. With this share, 150 points bound motions as tightly as 200 even ones.
_CHEBYSHEV = 0.35
# A bound is tightened by this multiple of the violation between points, because the peak moves with
# the bound, and by this additional share.
_TIMES, _EXTRA = 2.0, 1e-4

QUANTITIES = ("position", "velocity", "acceleration", "jerk", "effort")
"""Limited quantities, in the order of the constraints; the last is not linear in the weights."""


class LimitTables:
    """Tables of a basis on the grid of the limits; they are the same for all requests.

    Parameters
    ----------
    tables : QuadratureTables
        The basis at the quadrature nodes.
    n_points : int
        Points of the grid, denser near the ends.

    Attributes
    ----------
    n_points : int
        Points of the grid.
    phases : array, shape (n_points,)
        Their phases.
    from_nodes : array, shape (n_points, n_nodes)
        Matrix that interpolates values at the nodes.
    """

    def __init__(self, tables: QuadratureTables, n_points: int = N_LIMIT_POINTS) -> None:
        self._tables = tables
        self._values: dict[int, FloatArray] = {}
        self.n_points = n_points

    @cached_property
    def phases(self) -> FloatArray:
        """See the class."""
        even = np.linspace(0.0, 1.0, self.n_points)
        chebyshev = 0.5 - 0.5 * np.cos(np.pi * even)
        # Just inside the ends, for only jerks are free there, and they are often largest there.
        return np.clip(even + _CHEBYSHEV * (chebyshev - even), _INSIDE, 1.0 - _INSIDE)

    def states(self, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Hermite functions and shapes of rows of states, see :class:`.StateMap`.

        Computed when limits become constraints. Tables with a time scaling are never reused by
        another request.
        """
        highest = int(rows.orders.max())
        if highest not in self._values:
            self._values[highest] = self._tables.basis.tables(self.phases, highest)
        shapes = _peaks(self._values[highest][rows.orders, :, rows.joints], self.phases)
        return _hermite_peaks(self.phases.tobytes())[rows.orders], shapes

    @cached_property
    def from_nodes(self) -> FloatArray:
        """See the class."""
        basis = self._tables.basis
        return _interpolation(
            *(x.tobytes() for x in (self._tables.phases, basis.breakpoints, self.phases))
        )


def _peaks(values: FloatArray, phases: FloatArray) -> FloatArray:
    """Values at points, shape (n, n_points, ...), as bounds of peaks between them.

    A parabola whose largest value at three points is the middle one has its vertex within half a
    step of that, and rises above it by at most |second derivative| · step² / 8. This is linear in
    the values; it lowers least values as much.
    """
    steps = np.diff(phases).reshape(-1, *(1,) * (values.ndim - 2))
    before, after = steps[:-1], steps[1:]
    slopes = values[:, 1:] - values[:, :-1]
    slopes /= steps
    bend = slopes[:, 1:] - slopes[:, :-1]
    bend *= np.maximum(before, after) ** 2 / (4.0 * (before + after))
    peaks = values.copy()
    peaks[:, 1:-1] -= bend
    return peaks


@lru_cache(maxsize=16)
def _hermite_peaks(phases: bytes) -> FloatArray:
    return _peaks(hermite_tables(phases), np.frombuffer(phases))


@lru_cache(maxsize=16)
def _interpolation(nodes: bytes, breakpoints: bytes, points: bytes) -> FloatArray:
    """Matrix from values at nodes to those of the polynomials through them, piece by piece.

    To bounds of peaks, see :func:`_peaks`.
    """
    # Imported late for a fast start of the node.
    from scipy.interpolate import BarycentricInterpolator

    known, edges, asked = (np.frombuffer(x) for x in (nodes, breakpoints, points))
    matrix = np.zeros((asked.size, known.size))
    piece_of_node, piece_of_point = (np.searchsorted(edges[1:-1], x) for x in (known, asked))
    for piece in range(edges.size - 1):
        of_nodes = np.flatnonzero(piece_of_node == piece)
        of_points = np.flatnonzero(piece_of_point == piece)
        lagrange = BarycentricInterpolator(known[of_nodes], np.eye(of_nodes.size))
        matrix[np.ix_(of_points, of_nodes)] = lagrange(asked[of_points])
    return np.asarray(_peaks(matrix[None], asked)[0])


class LimitedProgram:
    """A motion program with bounds on positions, their derivatives and efforts.

    Parameters
    ----------
    program : MotionProgram
        The program without bounds.
    tables : LimitTables
        Its basis on the grid.
    limits : JointLimits
        Limits of its joints. Infinite ones make no constraints.
    end_states : array, shape (n_ends, 4, n_joints)
        Positions, velocities, accelerations and efforts at the fixed ends: the margin is reduced
        where an end is closer to the limit.
    chosen : array of bool, shape (5, n_joints), optional
        Limits that become constraints, by quantity and joint; all unless given.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        The bounds, as shares of the limit (or of half the range of positions).
    groups : array of int, shape (n_inequalities,)
        Constraints of one quantity of one joint, in the order of the phases, are of one group,
        which is n_joints · (index in `QUANTITIES`) + joint.
    """

    def __init__(
        self,
        program: MotionProgram,
        tables: LimitTables,
        limits: JointLimits,
        end_states: FloatArray,
        chosen: NDArray[np.bool_] | None = None,
    ) -> None:
        self.program = program
        self._tables = tables
        self._joint_names = limits.joint_names
        self._states: StateMap | None = None
        if chosen is not None and not chosen.any():
            self.lower = self.upper = self._effort_units = np.zeros(0)
            self._group_of_row = self._effort_joints = np.zeros(0, dtype=np.intp)
            return
        lower, upper, scale, room = _bounds(limits, end_states)
        self._end_room = room.ravel()
        limited = np.isfinite(lower) | np.isfinite(upper)
        quantities, joints = np.nonzero(limited if chosen is None else limited & chosen)
        self._group_of_row = quantities * len(limits.joint_names) + joints
        self.lower, self.upper = (
            np.repeat(x[quantities, joints], tables.n_points) for x in (lower, upper)
        )
        outside = end_states[:, 0] - np.clip(end_states[:, 0], limits.lower, limits.upper)
        if outside.any():
            self._widen(outside / scale[0], joints[quantities == 0])
        n_state_rows = int(np.count_nonzero(quantities < N_RATES))
        of_states, of_efforts = slice(n_state_rows), slice(n_state_rows, None)
        units = scale[quantities, joints]
        rows = Rows(quantities[of_states], joints[of_states], units[of_states])
        if n_state_rows:
            self._states = StateMap(program.unknowns, *tables.states(rows), rows)
        self._effort_joints, self._effort_units = joints[of_efforts], units[of_efforts]

    def _widen(self, outside: FloatArray, joints: NDArray[np.intp]) -> None:
        """Add to the bounds of positions what ends outside add to motions from the limit.

        Parameters
        ----------
        outside : array, shape (n_ends, n_joints)
            Distances of the ends beyond the limits, as shares.
        joints : array of int
            The joints whose positions are bounded, in the order of the constraints.
        """
        course = hermite_functions(self._tables.phases, 0)[:, 0]
        below, above = np.minimum(outside, 0.0).min(axis=0), np.maximum(outside, 0.0).max(axis=0)
        for bound, most in ((self.lower, below), (self.upper, above)):
            added = np.outer(most[joints], course).ravel()
            bound[: added.size] += added

    @property
    def groups(self) -> NDArray[np.intp]:
        """See the class."""
        return np.repeat(self._group_of_row, self._tables.n_points)

    def _group(self, violation: Violation) -> int:
        quantity = QUANTITIES.index(violation.quantity)
        return quantity * len(self._joint_names) + self._joint_names.index(violation.joint)

    def covers(self, violations: Iterable[Violation]) -> bool:
        """Whether all limits that a motion violates are constraints."""
        return all(self._group(violation) in self._group_of_row for violation in violations)

    def tightened(self, violations: Iterable[Violation]) -> LimitedProgram:
        """The same program with bounds tightened for violations between points of the grid.

        Parameters
        ----------
        violations : iterable of Violation
            Limits that a motion within the present bounds violates or touches. A bound moves by at
            most half of the distance between the fixed ends and the limit.
        """
        amount = np.zeros(self._end_room.size)
        for violation in violations:
            group = self._group(violation)
            # Bounds of positions are shares of half the range, violations are shares of the whole
            # range.
            excess = violation.excess * (2.0 if violation.quantity == "position" else 1.0)
            amount[group] = min(_TIMES * max(excess, 0.0) + _EXTRA, 0.5 * self._end_room[group])
        tighter = copy(self)
        by_constraint = amount[self.groups]
        tighter.lower, tighter.upper = self.lower + by_constraint, self.upper - by_constraint
        tighter._end_room = self._end_room - amount
        return tighter

    def evaluate(self, x: FloatArray) -> LimitedPoint:
        """Objective and bounded quantities at scaled weights x, with their derivatives."""
        return LimitedPoint(self, x, self.program.linearise(x))

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """Residuals of the conditions alone."""
        return self.program.equations.errors(x)

    def _efforts(self, node_efforts: FloatArray) -> FloatArray:
        """Bounded efforts from those at the nodes, shape (n_effort_joints, n_points)."""
        if not self._effort_joints.size:
            return np.zeros((0, self._tables.n_points))
        shares = node_efforts[:, self._effort_joints] / self._effort_units
        return np.asarray(shares.T @ self._tables.from_nodes.T)


class LimitedPoint:
    """A limited motion program at one x (see :class:`.program.Point`).

    Attributes
    ----------
    cost : float
        The objective.
    gradient : array, shape (n,)
        Its gradient.
    hessian : array, shape (n, n)
        RᵀR of the efforts plus the naturalness.
    inequalities : array, shape (n_inequalities,)
        The bounded quantities as shares of their limits.
    equalities : array, shape (n_equalities,)
        Residuals of the program's conditions; the ends are met by construction.
    equality_rows : array, shape (n_equalities, n)
        Their derivatives.
    """

    def __init__(self, owner: LimitedProgram, x: FloatArray, at: Linearisation) -> None:
        self._owner, self._x, self._at = owner, x, at
        deviation = x - owner.program.expected
        pull = owner.program.precision @ deviation
        self.cost = 0.5 * float(at.residual @ at.residual + pull @ deviation)
        self.gradient = at.residual @ at.jacobian + pull
        self._states = np.zeros((0, 0)) if owner._states is None else owner._states.values(x)
        efforts = owner._efforts(at.efforts).ravel()
        self.inequalities = np.concatenate([self._states.ravel(), efforts])
        self.equalities, self.equality_rows = owner.program.equations.residuals(x)

    @cached_property
    def hessian(self) -> FloatArray:
        """The known part of the Hessian."""
        return np.asarray(self._at.jacobian.T @ self._at.jacobian + self._owner.program.precision)

    @cached_property
    def _slopes(self) -> Slopes | None:
        """Derivatives of the bounded states."""
        states = self._owner._states
        return None if states is None else states.slopes(self._x, self._states)

    def inequality_rows(
        self, chosen: NDArray[np.intp], values: FloatArray | None = None
    ) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n); see :class:`.Slopes`."""
        n_states = self._states.size
        of_states = chosen < n_states
        rows = np.empty((chosen.size, self._x.size))
        if self._slopes is not None:
            room = 0.0 if values is None else (values - self.inequalities[chosen])[of_states]
            rows[of_states] = self._slopes.rows(chosen[of_states], room)
        if not of_states.all():
            rows[~of_states] = self._effort_rows(chosen[~of_states] - n_states)
        return rows

    def _effort_rows(self, chosen: NDArray[np.intp]) -> FloatArray:
        tables, units = self._owner._tables, self._owner._effort_units
        row, point = np.divmod(chosen, tables.n_points)
        from_nodes = tables.from_nodes[point] / units[row, None]
        by_joint = self._at.effort_jacobian.transpose(1, 0, 2)[self._owner._effort_joints[row]]
        return np.asarray((from_nodes[:, None] @ by_joint)[:, 0])

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Their prediction, exact at a fixed duration but for the efforts."""
        values, n_states = self.inequalities.copy(), self._states.size
        if self._slopes is not None:
            values[:n_states] = self._slopes.after(values[:n_states], step)
        if n_states < values.size:
            by_unknown = self._at.effort_jacobian.reshape(-1, step.size)
            change = (by_unknown @ step).reshape(self._at.efforts.shape)
            values[n_states:] += self._owner._efforts(change).ravel()
        return values


def _bounds(
    limits: JointLimits, end_states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Lower and upper bounds, their scales, and the room at the ends, shape (5, n_joints)."""
    half = (limits.upper - limits.lower) / 2.0
    upper = np.array([getattr(limits, name) for name in ("upper", *QUANTITIES[1:])])
    lower = -upper
    lower[0] = limits.lower
    scale = np.where(np.isfinite(upper), upper, 1.0)
    scale[0] = np.where(np.isfinite(half), half, 1.0)
    # Jerks at the ends are not fixed: they depend on the weights.
    room, ends = np.full(upper.shape, np.inf), end_states.copy()
    ends[:, 0] = np.clip(ends[:, 0], limits.lower, limits.upper)
    given = [QUANTITIES.index(name) for name in ("position", "velocity", "acceleration", "effort")]
    room[given] = np.minimum(upper[given] - ends, ends - lower[given]).min(axis=0, initial=np.inf)
    room /= scale
    margin = np.clip(0.5 * room, 0.0, MARGIN)
    return lower / scale + margin, upper / scale - margin, scale, room - margin
