# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What a constraint of a segment is; path constraints, and targets.

A constraint is a list of values between bounds, at some phases of a segment. It starts with the
rows that a motion near the expected one needs, often none. After a check of the motion that was
found, it is refined: by tighter bounds or by more rows. To add a constraint on configurations,
write a class as in :mod:`..path_constraints`; for any other, a class as :class:`Constraint`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.collision import Collision, CollisionModel
from ...motion.goal import JointState, Pose
from ...motion.validation import Violation
from ...primitives.basis import Basis
from ...robot.distances import NearPairs
from ...robot.model import Robot
from ..motion import Tables
from ..path_constraints import PathConstraint
from .segment import Course, Unknowns, all_states, state_map

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
        self._states = state_map(unknowns, basis, free, 0)
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

    def errors(self, x: FloatArray) -> FloatArray:
        """Distance [m] and, with an orientation, rotation vector [rad]."""
        return self.equations(x)[0]

    def equations(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same with the derivatives by the unknowns, shape (n_errors, n_unknowns)."""
        (q, by_x), pose = self._goal.at(x), self._pose
        place = pose.position, pose.orientation
        error, by_position = self._robot.pose_error(pose.frame, q[:, 0], *place)
        return error, np.asarray(by_position @ by_x.rows())


def with_phases_of(
    collisions: Sequence[Collision], phases: FloatArray, duration: float, n_more: int
) -> FloatArray:
    """Phases of clearance constraints, and some during each collision of a motion, increasing."""
    more = [np.linspace(one.first_time, one.last_time, n_more) / duration for one in collisions]
    return np.unique(np.concatenate([phases, *more]))


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
            self._states = state_map(unknowns, basis, phases, 0)
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
        phases = with_phases_of(found.collisions, self._phases, found.duration, N_MORE_PHASES)
        return Clearance(*self._for, phases, self._least)

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
