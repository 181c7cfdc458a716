# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of bodies as constraints of a segment.

Most motions collide with nothing. After one that does, all pairs are constrained: first at evenly
spread phases, later also at the phases of further collisions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.collision import Collision, CollisionModel
from ...primitives.basis import Basis
from ..options import ClearanceOptions
from .constraints import Ends, Findings
from .segment import Course, StateMap, Unknowns, state_map


def with_phases_of(
    collisions: Sequence[Collision], phases: FloatArray, duration: float, n_more: int
) -> FloatArray:
    """Phases of clearance constraints, and some during each collision of a motion, increasing."""
    more = [np.linspace(one.first_time, one.last_time, n_more) / duration for one in collisions]
    return np.unique(np.concatenate([phases, *more]))


def least_distances(
    ends: FloatArray, model: CollisionModel, options: ClearanceOptions = ClearanceOptions()
) -> FloatArray:
    """Least distance of each pair beside its margin, smaller where the ends are nearer.

    Parameters
    ----------
    ends : array, shape (n_ends, n_joints)
        Fixed ends of the motion.
    model : CollisionModel
        The robot's.
    options : ClearanceOptions
        Options.
    """
    least = np.full(len(model.pairs), options.distance)
    near = model.near(ends, options.distance / options.share_of_ends)
    np.minimum.at(least, near.pairs, options.share_of_ends * near.distances)
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
    options : ClearanceOptions
        Options.
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
        options: ClearanceOptions,
        phases: FloatArray | None = None,
        least: FloatArray | float = 0.0,
    ) -> None:
        self._for = model, unknowns, basis, ends, options
        self._phases, self._least = phases, least
        self.lower = self.upper = np.zeros(0)
        if phases is not None:
            self._states = state_map(unknowns, basis, phases, 0)
            self.lower = np.repeat(least, phases.size)
            self.upper = np.full(self.lower.size, np.inf)

    def everywhere(self) -> Clearance:
        """All pairs at evenly spread phases."""
        model, unknowns, _, ends, options = self._for
        phases = np.linspace(0.0, 1.0, options.n_phases + 1)
        phases = phases[ends[0] is not None : None if ends[1] is None else -1]
        fixed = np.array([end.positions for end in ends if end]).reshape(-1, unknowns.n_joints)
        least = least_distances(fixed, model, options)
        return Clearance(*self._for, phases, least)

    def refined(self, found: Findings) -> Clearance:
        """Constraints after a first collision; more phases after a further one."""
        if not found.collisions:
            return self
        if self._phases is None:
            return self.everywhere()
        n_more = self._for[4].n_more
        phases = with_phases_of(found.collisions, self._phases, found.duration, n_more)
        return Clearance(*self._for, phases, self._least)

    def at(self, course: Course) -> Distances:
        """The distances of a motion."""
        return Distances(self._states, self._for[0], course.x, self._for[4].reach)


class Distances:
    """Distances of all pairs at the phases of constraints (see :class:`.constraints.Linear`).

    Parameters
    ----------
    states : StateMap
        The positions at the phases.
    model : CollisionModel
        Computes the distances.
    x : array, shape (n,)
        The unknowns.
    reach : float
        Distance from which on changes are not predicted [m].

    Attributes
    ----------
    values : array, shape (n_pairs * n_phases,)
        The distances [m]; lower bounds beyond the reach of predictions.
    """

    def __init__(
        self, states: StateMap, model: CollisionModel, x: FloatArray, reach: float
    ) -> None:
        q = states.values(x)
        self._jacobian = states.slopes(x, q).rows().reshape(*q.shape, x.size)
        self._near = near = model.near(q.T, reach)
        self.values = near.bounds.T.ravel()
        self._places = near.pairs * q.shape[1] + near.configurations
        # Number of the near entry of each distance, −1 if it is far.
        self._entries = np.full(self.values.size, -1)
        self._entries[self._places] = np.arange(self._places.size)

    def rows(self, chosen: NDArray[np.intp], bounds: FloatArray | None) -> FloatArray:
        """Derivatives of the chosen distances by the unknowns, 0 for far ones."""
        entries, near = self._entries[chosen], self._near
        rows, is_near = np.zeros((chosen.size, self._jacobian.shape[2])), entries >= 0
        entries = entries[is_near]
        by_unknown = self._jacobian[:, near.configurations[entries]].transpose(1, 0, 2)
        rows[is_near] = (near.rows[entries][:, None] @ by_unknown)[:, 0]
        return rows

    def after(self, step: FloatArray) -> FloatArray:
        """The linear prediction after a step of the unknowns."""
        values, near = self.values.copy(), self._near
        changes = (self._jacobian @ step)[:, near.configurations]
        values[self._places] += np.einsum("ej,je->e", near.rows, changes)
        return values
