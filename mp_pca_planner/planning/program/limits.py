# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits as constraints of a segment, on a dense grid.

Positions and their derivatives are linear in the weights, so their constraints are exact and
cost a product of matrices. Efforts are computed at the quadrature nodes anyway; between them
they are smooth, so the polynomial through the nodes of each piece interpolates them.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.interpolation import hermite_functions
from ...motion.validation import Violation
from ...robot.limits import JointLimits
from ...robot.model import Robot
from ..motion import N_LIMIT_POINTS, N_RATES, Tables, limit_phases
from .constraints import Ends, Findings, Linear
from .segment import Course, StateMap, Unknowns

# Margin between motions and limits, as a share of the limit. It leaves room for what the bounds of
# peaks between points of the grid miss, which the check on the denser grid finds.
MARGIN = 2e-4
# A bound is tightened by this multiple of the violation between points, because the peak moves with
# the bound, and by this additional share.
_TIMES, _EXTRA = 2.0, 1e-4

QUANTITIES = ("position", "velocity", "acceleration", "jerk", "effort")
"""Limited quantities, in the order of the constraints; the last is not linear in the weights."""


class Limits:
    """Bounds on positions, their derivatives and efforts of a segment.

    Parameters
    ----------
    robot : Robot
        The model.
    tables : Tables
        The basis of the segment.
    unknowns : Unknowns
        Its unknowns.
    limits : JointLimits
        Limits of its joints. Infinite ones make no constraints.
    ends : tuple of (JointState or None)
        Its ends: the margin is reduced where a fixed one is closer to the limit.
    chosen : array of bool, shape (5, n_joints), optional
        Limits that become constraints, by quantity and joint; all unless given.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        The bounds, as shares of the limit (or of half the range of positions).
    groups : array of int, shape (n_inequalities / n_points,)
        n_joints · (index in `QUANTITIES`) + joint of each course of constraints along the motion.
    states : StateMap or None
        Bounded positions and their derivatives as functions of the unknowns.
    """

    def __init__(
        self,
        robot: Robot,
        tables: Tables,
        unknowns: Unknowns,
        limits: JointLimits,
        ends: Ends,
        chosen: NDArray[np.bool_] | None = None,
    ) -> None:
        self._for = robot, tables, unknowns, limits, ends
        self._tables, self._joint_names = tables, limits.joint_names
        self.states: StateMap | None = None
        if chosen is not None and not chosen.any():
            self.lower = self.upper = self._effort_units = np.zeros(0)
            self.groups = self._effort_joints = np.zeros(0, dtype=np.intp)
            return
        end_states = _end_states(robot, ends)
        lower, upper, scale, room = _bounds(limits, end_states)
        self._end_room = room.ravel()
        limited = np.isfinite(lower) | np.isfinite(upper)
        quantities, joints = np.nonzero(limited if chosen is None else limited & chosen)
        self.groups = quantities * len(limits.joint_names) + joints
        self.lower, self.upper = (
            np.repeat(x[quantities, joints], N_LIMIT_POINTS) for x in (lower, upper)
        )
        outside = end_states[:, 0] - np.clip(end_states[:, 0], limits.lower, limits.upper)
        if outside.any():
            self._widen(outside / scale[0], joints[quantities == 0])
        n_state_rows = int(np.count_nonzero(quantities < N_RATES))
        of_states, of_efforts = slice(n_state_rows), slice(n_state_rows, None)
        units = scale[quantities, joints]
        if n_state_rows:
            orders, own = quantities[of_states], joints[of_states]
            hermite, shapes = tables.on_grid(orders, own)
            self.states = StateMap(unknowns, hermite, shapes, orders, own, units[of_states])
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
        course = hermite_functions(limit_phases(), 0)[:, 0]
        below, above = np.minimum(outside, 0.0).min(axis=0), np.maximum(outside, 0.0).max(axis=0)
        for bound, most in ((self.lower, below), (self.upper, above)):
            added = np.outer(most[joints], course).ravel()
            bound[: added.size] += added

    def _group(self, violation: Violation) -> int:
        quantity = QUANTITIES.index(violation.quantity)
        return quantity * len(self._joint_names) + self._joint_names.index(violation.joint)

    def everywhere(self) -> Limits:
        """All limits."""
        return Limits(*self._for)

    def refined(self, found: Findings) -> Limits:
        """All limits if one is violated that is no constraint; or else tighter bounds.

        Bounds are tightened for what a motion within them violates or touches between the points of
        the grid, by at most half of the distance between the fixed ends and the limit.
        """
        violated, touched = (
            [self._group(one) for one in part] for part in (found.violations, found.touched)
        )
        if not np.isin(violated, self.groups).all():
            return self.everywhere()
        if not violated and not (touched and np.isin(touched, self.groups).all()):
            return self
        amount = np.zeros(self._end_room.size)
        for group, violation in zip(touched, found.touched, strict=True):
            # Bounds of positions are shares of half the range, violations are shares of the whole
            # range.
            excess = violation.excess * (2.0 if violation.quantity == "position" else 1.0)
            amount[group] = min(_TIMES * max(excess, 0.0) + _EXTRA, 0.5 * self._end_room[group])
        tighter = copy(self)
        by_constraint = np.repeat(amount[self.groups], N_LIMIT_POINTS)
        tighter.lower, tighter.upper = self.lower + by_constraint, self.upper - by_constraint
        tighter._end_room = self._end_room - amount
        return tighter

    def at(self, course: Course) -> Linear:
        """The bounded quantities of a motion, as shares of their limits."""
        states, slopes = np.zeros((0, 0)), None
        if self.states is not None:
            states, slopes = self.states.at(course.x)
        n_states = states.size
        values = np.concatenate([states.ravel(), self._efforts(course.nodes.efforts)])

        def rows(chosen: NDArray[np.intp], bounds: FloatArray | None) -> FloatArray:
            """Derivatives of the chosen ones, see :meth:`.Slopes.rows`."""
            of_states = chosen < n_states
            found = np.empty((chosen.size, course.x.size))
            if slopes is not None:
                room = 0.0 if bounds is None else (bounds - values[chosen])[of_states]
                found[of_states] = slopes.rows(chosen[of_states], room)
            if not of_states.all():
                found[~of_states] = self._effort_rows(course, chosen[~of_states] - n_states)
            return found

        def after(step: FloatArray) -> FloatArray:
            """Their prediction, exact at a fixed duration but for the efforts."""
            predicted = values.copy()
            if slopes is not None:
                predicted[:n_states] = slopes.after(values[:n_states], step)
            if n_states < values.size:
                predicted[n_states:] += self._efforts(course.slopes["efforts"] @ step)
            return predicted

        return Linear(values, rows, after)

    def _efforts(self, node_efforts: FloatArray) -> FloatArray:
        """Bounded efforts from those at the nodes, shape (n_effort_joints * n_points,)."""
        if not self._effort_joints.size:
            return np.zeros(0)
        shares = node_efforts[:, self._effort_joints] / self._effort_units
        return np.asarray(shares.T @ self._tables.from_nodes().T).ravel()

    def _effort_rows(self, course: Course, chosen: NDArray[np.intp]) -> FloatArray:
        """Derivatives of the chosen bounded efforts."""
        row, point = np.divmod(chosen, N_LIMIT_POINTS)
        from_nodes = self._tables.from_nodes()[point] / self._effort_units[row, None]
        by_joint = course.slopes["efforts"].transpose(1, 0, 2)[self._effort_joints[row]]
        return np.asarray((from_nodes[:, None] @ by_joint)[:, 0])


def limit_shares(limits: JointLimits, states: FloatArray, efforts: FloatArray) -> FloatArray:
    """Values of a motion as shares of the limits, shape (5, n_steps, n_joints).

    Those of positions are 0 in the middle of a range and 1 at its ends.

    Parameters
    ----------
    limits : JointLimits
        Limits of the joints.
    states : array, shape (4, n_steps, n_joints)
        Positions, velocities, accelerations and jerks.
    efforts : array, shape (n_steps, n_joints)
        Efforts; NaN counts as beyond a limit.
    """
    half = (limits.upper - limits.lower) / 2.0
    beyond = np.maximum(limits.lower - states[0], states[0] - limits.upper)
    bounds = np.array([limits.velocity, limits.acceleration, limits.jerk, limits.effort])
    of_positions = 1.0 + beyond / np.where(np.isfinite(half), half, 1.0)
    return np.stack([of_positions, *(np.abs([*states[1:], efforts]) / bounds[:, None])])


def _end_states(robot: Robot, ends: Ends) -> FloatArray:
    """Positions, velocities, accelerations and efforts at fixed ends, shape (n, 4, n_joints)."""
    values = [end.values for end in ends if end is not None]
    if not values:
        return np.zeros((0, 4, robot.n_joints))
    q, v, a = np.array(values).transpose(1, 0, 2)
    return np.stack([q, v, a, robot.inverse_dynamics(q, v, a)], axis=1)


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
