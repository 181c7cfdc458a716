# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Path constraints at phases of a segment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...primitives.basis import Basis
from ...robot.model import Robot
from ..path_constraints import PathConstraint
from .constraints import Dense, Findings
from .segment import Course
from .unknowns import Unknowns, state_map

# Distance from the bound for the motion between the phases, at most half of that of fixed ends.
_MARGIN = 0.01


class AlongPath:
    """A path constraint during a segment (see :class:`.constraints.Constraint`).

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
    ends : sequence of (array, shape (n_joints,), or None)
        Positions at its start and goal, None where they are free.
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
        ends: Sequence[FloatArray | None],
        phases: FloatArray,
    ) -> None:
        self._for = robot, constraint, unknowns, basis, ends
        self._robot, self._constraint, self._phases = robot, constraint, phases
        free = phases[int(ends[0] is not None) : phases.size - int(ends[1] is not None)]
        self._states = state_map(unknowns, basis, free, 0)
        known = np.array([end for end in ends if end is not None]).reshape(-1, robot.n_joints)
        at_ends, _ = constraint.values(robot, known)
        least = np.clip(0.5 * at_ends.min(axis=0, initial=2.0 * _MARGIN), 0.0, _MARGIN)
        self.lower = np.repeat(least, free.size)
        self.upper = np.full(self.lower.size, np.inf)

    def at(self, course: Course) -> Dense:
        """The values of a motion."""
        q = self._states.values(course.x)
        by_unknown = self._states.jacobian(course.x, q).reshape(*q.shape, -1)
        values, slopes = self._constraint.values(self._robot, q.T)
        rows = np.einsum("svj,jsx->vsx", slopes, by_unknown)
        return Dense(values.T.ravel(), rows.reshape(values.size, -1))

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
