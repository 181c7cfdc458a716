# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of links as inequalities of a motion program.

Most pairs never come near each other. A pair is constrained after a motion in which it collides:
first at evenly spread phases, later also at the phases of further collisions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..primitives.basis import Basis
from .constraints import LimitedPoint, LimitedProgram
from .unknowns import Rows, StateMap, Unknowns, hermite_tables


@dataclass(frozen=True)
class ClearanceOptions:
    """Options of clearance constraints.

    Attributes
    ----------
    distance : float
        Least clearance [m], with a margin for the motion between the phases.
    share_of_ends : float
        Largest share of the distance at the fixed ends of the motion, 0 to 1.
    n_phases : int
        Number of phases at which a pair is constrained at first.
    n_more : int
        Number of phases that are added during each further collision.
    """

    distance: float = 3e-3
    share_of_ends: float = 0.5
    n_phases: int = 40
    n_more: int = 5


_OPTIONS = ClearanceOptions()


@dataclass(frozen=True, eq=False)
class Clearance:
    """A clearance constraint: a pair of links, phases and a least distance.

    Attributes
    ----------
    pair : int
        Index of the pair in the collision model.
    phases : array, shape (n_phases,)
        Phases of the constraint, increasing.
    distance : float
        Least distance [m].
    """

    pair: int
    phases: FloatArray
    distance: float


def clearances_of(
    collisions: Iterable[Collision],
    known: Sequence[Clearance],
    model: CollisionModel,
    ends: Sequence[FloatArray | None],
    duration: float,
) -> tuple[Clearance, ...]:
    """Further clearance constraints, for the collisions of a motion.

    Parameters
    ----------
    collisions : iterable of Collision
        Collisions of the motion.
    known : sequence of Clearance
        Present constraints.
    model : CollisionModel
        The robot's.
    ends : sequence of (array, shape (n_joints,), or None)
        Positions at the start and at the goal of the motion, None where they are free.
    duration : float
        Of the motion [s].
    """
    distances = {clearance.pair: clearance.distance for clearance in known}
    grid = np.linspace(0.0, 1.0, _OPTIONS.n_phases + 1)
    grid = grid[ends[0] is not None : None if ends[1] is None else -1]
    added = []
    for one in collisions:
        phases = np.linspace(one.first_time, one.last_time, _OPTIONS.n_more) / duration
        if one.pair not in distances:
            phases, pair = grid, np.array([one.pair])
            room = [model.distances(end, pair)[0][0] for end in ends if end is not None]
            at_ends = float(min(room, default=np.inf))
            distances[one.pair] = min(_OPTIONS.distance, _OPTIONS.share_of_ends * at_ends)
        added.append(Clearance(one.pair, phases, distances[one.pair]))
    return tuple(added)


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
    clearances : sequence of Clearance
        At least one constraint.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        Bounds of the limited program, then those of the distances [m].
    """

    def __init__(
        self,
        limited: LimitedProgram,
        basis: Basis,
        model: CollisionModel,
        clearances: Sequence[Clearance],
    ) -> None:
        unknowns = limited.program.unknowns
        self._limited, self._model = limited, model
        sizes = [one.phases.size for one in clearances]
        pairs = np.repeat([one.pair for one in clearances], sizes)
        phases, places = np.unique(
            np.concatenate([one.phases for one in clearances]), return_inverse=True
        )
        # All pairs of a phase share one pass of the kinematics.
        self._rows_at = [np.flatnonzero(places == i) for i in range(phases.size)]
        self._pairs_at = [pairs[rows] for rows in self._rows_at]
        self._states = _positions(unknowns, basis, phases)
        least = np.repeat([one.distance for one in clearances], sizes)
        self.lower = np.concatenate([limited.lower, least])
        self.upper = np.concatenate([limited.upper, np.full(least.size, np.inf)])

    def evaluate(self, x: FloatArray) -> ClearPoint:
        """Objective and inequalities at x, with their derivatives."""
        return ClearPoint(self._limited.evaluate(x), *self._distances(x))

    def _distances(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The distances, shape (n_distances,), and their derivatives by the unknowns."""
        q = self._states.values(x)
        by_unknown = self._states.jacobian(x, q).reshape(*q.shape, x.size)
        n_distances = self.lower.size - self._limited.lower.size
        distances, rows = np.empty(n_distances), np.empty((n_distances, x.size))
        for i, (at, pairs) in enumerate(zip(self._rows_at, self._pairs_at, strict=True)):
            distances[at], by_joint = self._model.distances(q[:, i], pairs)
            rows[at] = by_joint @ by_unknown[:, i]
        return distances, rows


class ClearPoint:
    """A :class:`ClearProgram` at one x (see :class:`.program.Point`)."""

    def __init__(self, limited: LimitedPoint, distances: FloatArray, rows: FloatArray) -> None:
        self._limited, self._distances, self._rows = limited, distances, rows
        self.cost, self.gradient = limited.cost, limited.gradient
        self.equalities, self.equality_rows = limited.equalities, limited.equality_rows
        self.inequalities = np.concatenate([limited.inequalities, distances])

    @property
    def hessian(self) -> FloatArray:
        """The known part of the Hessian."""
        return self._limited.hessian

    def inequality_rows(self, chosen: NDArray[np.intp]) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n)."""
        n_limited = self._limited.inequalities.size
        of_limits = chosen < n_limited
        rows = np.empty((chosen.size, self.gradient.size))
        rows[of_limits] = self._limited.inequality_rows(chosen[of_limits])
        rows[~of_limits] = self._rows[chosen[~of_limits] - n_limited]
        return rows

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Their linear prediction."""
        distances = self._distances + self._rows @ step
        return np.concatenate([self._limited.inequalities_after(step), distances])


def _positions(unknowns: Unknowns, basis: Basis, phases: FloatArray) -> StateMap:
    """Positions of all joints at some phases."""
    tables = basis.tables(phases, 0)
    joints = np.arange(tables.shape[2])
    rows = Rows(np.zeros_like(joints), joints, np.ones(joints.size))
    hermite = hermite_tables(phases.tobytes())[:1]
    return StateMap(unknowns, hermite, tables[..., 0], tables[..., 1:] * basis.scales, rows)
