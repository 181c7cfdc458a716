# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The constraints of a segment: limits, path constraints, clearances, and its target.

A constraint is a list of values between bounds, at some phases of a segment. It starts with the
rows that a motion near the expected one needs, often none. After a check of the motion that was
found, it is refined: by tighter bounds or by more rows. To add a constraint on configurations,
write a class as in :mod:`..path_constraints`; for any other, a class as :class:`Constraint`.

Limits apply on a dense grid. Positions and their derivatives are linear in the weights, so their
constraints are exact and cost a product of matrices. Efforts are computed at the quadrature nodes
anyway; between them they are smooth, so the polynomial through the nodes of each piece
interpolates them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.collision import Collision, CollisionModel
from ...motion.goal import JointState, Pose
from ...motion.interpolation import hermite_functions
from ...motion.validation import Violation
from ...primitives.basis import Basis
from ...robot.distances import NearPairs
from ...robot.limits import JointLimits
from ...robot.model import Robot
from ..motion import N_LIMIT_POINTS, N_RATES, Tables, limit_phases
from ..path_constraints import PathConstraint
from .segment import Course, StateMap, Unknowns, all_states, positions_at

# Distance from the bound of a path constraint for the motion between the phases, at most half of
# that of fixed ends.
_MARGIN = 0.01

Ends = tuple[JointState | None, JointState | None]
"""States at the start and the goal of a segment; None where the position is free."""

# Least clearance [m], with a margin for the motion between the phases, and its largest share at the
# fixed ends of the motion.
_LEAST_CLEARANCE, _SHARE_OF_ENDS = 3e-3, 0.5

CLEARANCE_REACH = 0.03
"""Distance [m] from which on the change of a distance is not predicted."""

N_CLEARANCE_PHASES = 40
"""Number of phases at which pairs are constrained at first."""

N_MORE_PHASES = 5
"""Number of phases that are added during each further collision."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Values of a constraint at one x, with their derivatives by the unknowns of its segment.

    Attributes
    ----------
    values : array, shape (n,)
        The values.
    rows : callable
        Returns derivatives of the chosen values, shape (n_chosen, n_unknowns). With bounds of
        them, derivatives such that steps within these bounds to first order are within them
        altogether, where the constraint can provide them.
    after : callable
        Returns the prediction of the values after a step, correct to first order.
    """

    values: FloatArray
    rows: Callable[[NDArray[np.intp], FloatArray | None], FloatArray]
    after: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Findings:
    """What the check of a motion found in one segment; times count from its start.

    Attributes
    ----------
    duration : float
        Duration of the segment [s].
    positions : array, shape (n_points, n_joints)
        Positions at the points of the trajectory.
    phases : array, shape (n_points,)
        Their phases.
    violations, touched : sequence of Violation
        Limits that are violated; those and limits that are nearly reached.
    collisions : sequence of Collision
        Collisions; not known if limits are violated.
    """

    duration: float
    positions: FloatArray
    phases: FloatArray
    violations: Sequence[Violation] = ()
    touched: Sequence[Violation] = ()
    collisions: Sequence[Collision] = ()


class Constraint(Protocol):
    """One piece of the constraints of a segment, lower ≤ values ≤ upper.

    Attributes
    ----------
    lower, upper : array, shape (n,)
        The bounds; neighbours along a motion are neighbours here. Empty while nothing is
        constrained.
    """

    lower: FloatArray
    upper: FloatArray

    def at(self, course: Course) -> Linear:
        """The values of a motion."""

    def refined(self, found: Findings) -> Constraint:
        """The constraint with what a check found in a motion within the present one.

        The constraint itself, if the check found nothing for it.
        """

    def everywhere(self) -> Constraint:
        """The constraint with all of its rows."""


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


class AlongPath:
    """A path constraint during a segment (see :class:`Constraint`).

    Parameters
    ----------
    robot : Robot
        The model.
    constraint : PathConstraint
        The constraint.
    unknowns : Unknowns
        The unknowns of the segment.
    basis : Basis
        Its basis.
    ends : tuple of (JointState or None)
        Its ends.
    phases : array, shape (n_phases,)
        Phases of the constraints from 0 to 1, increasing.

    Attributes
    ----------
    lower, upper : array, shape (n_values * n_phases,)
        The bounds, value by value.
    """

    def __init__(
        self,
        robot: Robot,
        constraint: PathConstraint,
        unknowns: Unknowns,
        basis: Basis,
        ends: Ends,
        phases: FloatArray,
    ) -> None:
        self._for = robot, constraint, unknowns, basis, ends
        self._robot, self._constraint, self._phases = robot, constraint, phases
        free = phases[int(ends[0] is not None) : phases.size - int(ends[1] is not None)]
        self._states = positions_at(unknowns, basis, free)
        known = np.array([end.positions for end in ends if end]).reshape(-1, robot.n_joints)
        at_ends, _ = constraint.values(robot, known)
        least = np.clip(0.5 * at_ends.min(axis=0, initial=2.0 * _MARGIN), 0.0, _MARGIN)
        self.lower = np.repeat(least, free.size)
        self.upper = np.full(self.lower.size, np.inf)

    def at(self, course: Course) -> Linear:
        """The values of a motion, and their linear prediction."""
        q, by_x = self._states.at(course.x)
        by_unknown = by_x.rows().reshape(*q.shape, -1)
        values, slopes = self._constraint.values(self._robot, q.T)
        by_value = values.T.ravel()
        jacobian = np.einsum("svj,jsx->vsx", slopes, by_unknown).reshape(values.size, -1)
        return Linear(
            by_value,
            lambda chosen, _: np.asarray(jacobian[chosen]),
            lambda step: np.asarray(by_value + jacobian @ step),
        )

    def refined(self, found: Findings) -> AlongPath:
        """With further phases, where a motion strays most between the present ones."""
        values, _ = self._constraint.values(self._robot, found.positions)
        least = values.min(axis=1)
        outside = least < 0.0
        if not outside.any():
            return self
        before, after = np.append(np.inf, least[:-1]), np.append(least[1:], np.inf)
        worst = found.phases[outside & (least <= before) & (least <= after)]
        phases = np.unique(np.concatenate([self._phases, np.clip(worst, 0.0, 1.0)]))
        return AlongPath(*self._for, phases) if phases.size > self._phases.size else self

    def everywhere(self) -> AlongPath:
        """The constraint itself, which has all of its rows."""
        return self


class PoseTarget:
    """The equations of a pose at the goal of a segment whose goal positions are unknowns.

    Parameters
    ----------
    robot : Robot
        The model.
    tables : Tables
        The basis of the segment.
    unknowns : Unknowns
        Its unknowns.
    pose : Pose
        The frame and its pose.
    """

    def __init__(self, robot: Robot, tables: Tables, unknowns: Unknowns, pose: Pose) -> None:
        self._robot, self._pose = robot, pose
        self._goal = all_states(unknowns, tables.hermite[:1, -1:], tables.values[:1, -1:])

    def equations(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors of the pose, and their derivatives by the unknowns, (n_errors, n_unknowns).

        Distance [m] and, with an orientation, rotation vector [rad].
        """
        (q, by_x), pose = self._goal.at(x), self._pose
        place = pose.position, pose.orientation
        error, by_position = self._robot.pose_error(pose.frame, q[:, 0], *place)
        return error, np.asarray(by_position @ by_x.rows())


def least_distances(ends: FloatArray, model: CollisionModel) -> FloatArray:
    """Least distance of each pair beside its margin, smaller where the ends are nearer.

    Parameters
    ----------
    ends : array, shape (n_ends, n_joints)
        Fixed ends of the motion.
    model : CollisionModel
        The robot's.
    """
    least = np.full(len(model.pairs), _LEAST_CLEARANCE)
    near = model.near(ends, _LEAST_CLEARANCE / _SHARE_OF_ENDS)
    np.minimum.at(least, near.pairs, _SHARE_OF_ENDS * near.distances)
    return least


class Clearance:
    """Distances of all pairs of bodies during a segment.

    Parameters
    ----------
    model : CollisionModel
        Computes the distances.
    unknowns : Unknowns
        The unknowns of the segment.
    basis : Basis
        Its basis.
    ends : tuple of (JointState or None)
        Its ends.
    phases : array, shape (n_phases,), optional
        Phases of the constraints, increasing; no constraints unless given.
    least : array, shape (n_pairs,), or float
        Least distance of each pair beside its margin [m].

    Attributes
    ----------
    lower, upper : array, shape (n_pairs * n_phases,)
        Bounds of the distances [m], pair by pair.
    """

    def __init__(
        self,
        model: CollisionModel,
        unknowns: Unknowns,
        basis: Basis,
        ends: Ends,
        phases: FloatArray | None = None,
        least: FloatArray | float = 0.0,
    ) -> None:
        self._for = model, unknowns, basis, ends
        self._phases, self._least = phases, least
        self._before: NearPairs | None = None
        self.lower = self.upper = np.zeros(0)
        if phases is not None:
            self._states = positions_at(unknowns, basis, phases)
            self.lower = np.repeat(least, phases.size)
            self.upper = np.full(self.lower.size, np.inf)

    def everywhere(self) -> Clearance:
        """All pairs at evenly spread phases."""
        model, unknowns, _, ends = self._for
        phases = np.linspace(0.0, 1.0, N_CLEARANCE_PHASES + 1)
        phases = phases[ends[0] is not None : None if ends[1] is None else -1]
        fixed = np.array([end.positions for end in ends if end]).reshape(-1, unknowns.n_joints)
        least = least_distances(fixed, model)
        return Clearance(*self._for, phases, least)

    def refined(self, found: Findings) -> Clearance:
        """Constraints after a first collision; more phases after a further one."""
        if not found.collisions:
            return self
        if self._phases is None:
            return self.everywhere()
        phases = [self._phases]
        for one in found.collisions:
            times = np.linspace(one.first_time, one.last_time, N_MORE_PHASES)
            phases.append(times / found.duration)
        return Clearance(*self._for, np.unique(np.concatenate(phases)), self._least)

    def at(self, course: Course) -> Linear:
        """The distances of a motion [m]; lower bounds beyond the reach of predictions."""
        q, by_x = self._states.at(course.x)
        jacobian = by_x.rows().reshape(*q.shape, course.x.size)
        near = self._before = self._for[0].near(q.T, CLEARANCE_REACH, self._before)
        values = near.bounds.T.ravel()
        places = near.pairs * q.shape[1] + near.configurations
        # Number of the near entry of each distance, −1 if it is far.
        entries = np.full(values.size, -1)
        entries[places] = np.arange(places.size)

        def rows(chosen: NDArray[np.intp], _: FloatArray | None) -> FloatArray:
            """Derivatives of the chosen distances by the unknowns, 0 for far ones."""
            own = entries[chosen]
            found, is_near = np.zeros((chosen.size, jacobian.shape[2])), own >= 0
            own = own[is_near]
            by_unknown = jacobian[:, near.configurations[own]].transpose(1, 0, 2)
            found[is_near] = (near.rows[own][:, None] @ by_unknown)[:, 0]
            return found

        def after(step: FloatArray) -> FloatArray:
            predicted = values.copy()
            changes = (jacobian @ step)[:, near.configurations]
            predicted[places] += np.einsum("ej,je->e", near.rows, changes)
            return predicted

        return Linear(values, rows, after)
