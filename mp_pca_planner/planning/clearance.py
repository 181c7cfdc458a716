# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of links as inequalities of a motion program.

Most pairs never come near each other: a pair is kept apart once a motion was found in which it
isn't, at phases all along the motion, and later also where it met between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..primitives.basis import Basis
from .compiler import Rows, StateMap, Unknowns, hermite_tables
from .constraints import LimitedPoint, LimitedProgram

# Links are kept this far apart [m], so that they don't meet between the phases at which they are,
# but by no more than this share of what they are apart at the ends of the motion.
_CLEARANCE, _SHARE_OF_ENDS = 3e-3, 0.5
# Phases at which a pair is kept apart at first, and those added where it meets nevertheless.
_N_PHASES, _N_MORE = 40, 5


@dataclass(frozen=True, eq=False)
class Watch:
    """A pair of links to be kept apart.

    Attributes
    ----------
    pair : int
        Which pair of the collision model.
    phases : array, shape (n_phases,)
        When, rising.
    clearance : float
        How far apart [m].
    """

    pair: int
    phases: FloatArray
    clearance: float


def watches_of(
    collisions: Iterable[Collision],
    known: Sequence[Watch],
    model: CollisionModel,
    ends: Sequence[FloatArray],
    duration: float,
) -> tuple[Watch, ...]:
    """What to watch in addition, for pairs that meet in a motion.

    Parameters
    ----------
    collisions :
        Where they meet.
    known :
        What is watched already.
    model : CollisionModel
        The robot's.
    ends : sequence of array, shape (n_joints,)
        The ends of the motion that can't be changed.
    duration : float
        Of the motion [s].
    """
    clearances = {watch.pair: watch.clearance for watch in known}
    added = []
    for one in collisions:
        if one.pair in clearances:
            phases = np.linspace(one.first_time, one.last_time, _N_MORE) / duration
            added.append(Watch(one.pair, phases, clearances[one.pair]))
            continue
        pair = np.array([one.pair])
        room = min(float(model.distances(end, pair)[0][0]) for end in ends)
        clearance = min(_CLEARANCE, _SHARE_OF_ENDS * room)
        # A free end is at the last phase.
        phases = np.linspace(0.0, 1.0, _N_PHASES + 1)[1 : None if len(ends) == 1 else -1]
        added.append(Watch(one.pair, phases, clearance))
    return tuple(added)


class ClearProgram:
    """A motion program with limits in which pairs of links are kept apart, too.

    Parameters
    ----------
    limited : LimitedProgram
        The program without.
    basis : Basis
        Its basis.
    model : CollisionModel
        Tells the distances.
    watches : sequence of Watch
        At least one: what to keep apart.

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
        watches: Sequence[Watch],
    ) -> None:
        unknowns = limited.program.unknowns
        self._limited, self._model = limited, model
        sizes = [watch.phases.size for watch in watches]
        pairs = np.repeat([watch.pair for watch in watches], sizes)
        phases, places = np.unique(
            np.concatenate([watch.phases for watch in watches]), return_inverse=True
        )
        # All that is asked at a phase takes one pass of the kinematics.
        self._rows_at = [np.flatnonzero(places == i) for i in range(phases.size)]
        self._pairs_at = [pairs[rows] for rows in self._rows_at]
        self._states = _positions(unknowns, basis, phases)
        clearances = np.repeat([watch.clearance for watch in watches], sizes)
        self.lower = np.concatenate([limited.lower, clearances])
        self.upper = np.concatenate([limited.upper, np.full(clearances.size, np.inf)])

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
