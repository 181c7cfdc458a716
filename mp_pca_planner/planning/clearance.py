# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of bodies as inequalities of a motion program.

Most motions collide with nothing. After one that does, all pairs are constrained: first at evenly
spread phases, later also at the phases of further collisions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..primitives.basis import Basis
from .constraints import LimitedPoint, LimitedProgram
from .unknowns import StateMap, state_map


@dataclass(frozen=True)
class ClearanceOptions:
    """Options of clearance constraints.

    Attributes
    ----------
    distance : float
        Least clearance [m], with a margin for the motion between the phases.
    share_of_ends : float
        Largest share of the distance at the fixed ends of the motion, 0 to 1.
    reach : float
        Distance [m] from which on the change of a distance is not predicted.
    n_phases : int
        Number of phases at which pairs are constrained at first.
    n_more : int
        Number of phases that are added during each further collision.
    """

    distance: float = 3e-3
    share_of_ends: float = 0.5
    reach: float = 0.03
    n_phases: int = 40
    n_more: int = 5


_OPTIONS = ClearanceOptions()


@dataclass(frozen=True, eq=False)
class Clearances:
    """Clearance constraints of a motion.

    Attributes
    ----------
    phases : array, shape (n_phases,)
        Phases of the constraints, increasing.
    least : array, shape (n_pairs,)
        Least distance of each pair beside its margin [m].
    """

    phases: FloatArray
    least: FloatArray

    @classmethod
    def between(
        cls, ends: Sequence[FloatArray | None], model: CollisionModel, n_joints: int
    ) -> Clearances:
        """Constraints at evenly spread phases.

        Parameters
        ----------
        ends : sequence of (array, shape (n_joints,), or None)
            Positions at the start and at the goal of the motion, None where they are free.
        model : CollisionModel
            The robot's.
        n_joints : int
            Number of its joints.
        """
        phases = np.linspace(0.0, 1.0, _OPTIONS.n_phases + 1)
        phases = phases[ends[0] is not None : None if ends[1] is None else -1]
        fixed = np.array([end for end in ends if end is not None]).reshape(-1, n_joints)
        return cls(phases, least_distances(fixed, model))

    def during(self, collisions: Sequence[Collision], duration: float) -> Clearances:
        """The same with further phases, those of the collisions of a motion."""
        more = [
            np.linspace(one.first_time, one.last_time, _OPTIONS.n_more) / duration
            for one in collisions
        ]
        return Clearances(np.unique(np.concatenate([self.phases, *more])), self.least)


def least_distances(ends: FloatArray, model: CollisionModel) -> FloatArray:
    """Least distance of each pair beside its margin, smaller where the ends are nearer.

    Parameters
    ----------
    ends : array, shape (n_ends, n_joints)
        Fixed ends of the motion.
    model : CollisionModel
        The robot's.
    """
    least = np.full(len(model.pairs), _OPTIONS.distance)
    near = model.near(ends, _OPTIONS.distance / _OPTIONS.share_of_ends)
    np.minimum.at(least, near.pairs, _OPTIONS.share_of_ends * near.distances)
    return least


class ClearProgram:
    """A motion program with limits and clearance constraints.

    Parameters
    ----------
    limited : LimitedProgram
        The program without.
    basis : Basis
        Its basis.
    model : CollisionModel
        Computes the distances.
    clearances : Clearances
        The constraints.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        Bounds of the limited program, then those of the distances [m], pair by pair.
    """

    def __init__(
        self, limited: LimitedProgram, basis: Basis, model: CollisionModel, clearances: Clearances
    ) -> None:
        self._limited, self._model = limited, model
        self._states = state_map(limited.program.unknowns, basis, clearances.phases, 0)
        least = np.repeat(clearances.least, clearances.phases.size)
        self.lower = np.concatenate([limited.lower, least])
        self.upper = np.concatenate([limited.upper, np.full(least.size, np.inf)])

    def evaluate(self, x: FloatArray) -> ClearPoint:
        """Objective and inequalities at x, with their derivatives."""
        return ClearPoint(self._limited.evaluate(x), Distances(self._states, self._model, x))

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """Residuals of the conditions alone."""
        return self._limited.equalities_at(x)


class Distances:
    """Distances of all pairs at the phases of constraints, with their derivatives.

    Parameters
    ----------
    states : StateMap
        The positions at the phases.
    model : CollisionModel
        Computes the distances.
    x : array, shape (n,)
        The unknowns.

    Attributes
    ----------
    values : array, shape (n_pairs * n_phases,)
        The distances [m]; lower bounds beyond the reach of predictions.
    """

    def __init__(self, states: StateMap, model: CollisionModel, x: FloatArray) -> None:
        q = states.values(x)
        self._jacobian = states.jacobian(x, q).reshape(*q.shape, x.size)
        self._near = near = model.near(q.T, _OPTIONS.reach)
        self.values = near.bounds.T.ravel()
        self._places = near.pairs * q.shape[1] + near.configurations

    @cached_property
    def _entries(self) -> NDArray[np.intp]:
        """Number of the near entry of each distance, −1 if it is far."""
        entries = np.full(self.values.size, -1)
        entries[self._places] = np.arange(self._places.size)
        return entries

    def rows(self, chosen: NDArray[np.intp]) -> FloatArray:
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


class ClearPoint:
    """A :class:`ClearProgram` at one x (see :class:`.program.Point`)."""

    def __init__(self, limited: LimitedPoint, distances: Distances) -> None:
        self._limited, self._distances = limited, distances
        self.cost, self.gradient = limited.cost, limited.gradient
        self.equalities, self.equality_rows = limited.equalities, limited.equality_rows
        self.inequalities = np.concatenate([limited.inequalities, distances.values])

    @property
    def hessian(self) -> FloatArray:
        """The known part of the Hessian."""
        return self._limited.hessian

    def inequality_rows(
        self, chosen: NDArray[np.intp], values: FloatArray | None = None
    ) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n)."""
        n_limited = self._limited.inequalities.size
        of_limits = chosen < n_limited
        rows = np.empty((chosen.size, self.gradient.size))
        limits = None if values is None else values[of_limits]
        rows[of_limits] = self._limited.inequality_rows(chosen[of_limits], limits)
        if not of_limits.all():
            rows[~of_limits] = self._distances.rows(chosen[~of_limits] - n_limited)
        return rows

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Their linear prediction."""
        return np.concatenate([self._limited.inequalities_after(step), self._distances.after(step)])
