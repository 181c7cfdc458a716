# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Selection of the best primitive for a request, without solving for all of them.

The in-span score is a first filter: only primitives whose demonstrations are about as near to the
request as those of the nearest primitive remain. An index finds them among many
(:mod:`.request_index`). The remaining ones are ranked by the cost of their expected motion,
compiled but not optimised. The reduction of the cost by optimisation differs by a few percent
between primitives. Therefore the planner solves for all primitives whose expected costs differ from
the least one by less.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..primitives.library import PrimitiveLibrary
from ..primitives.prediction import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot
from .motion import Motion, Tables, cost_of, rank_of
from .objectives import Objective, effort

# Largest in-span score of a primitive that is considered, as a multiple of the least one, and the
# score below which all are: the request is like their demonstrations.
_RELATIVE_SCORE, _NEAR_SCORE = 1.25, 1.0
# Primitives that are considered at most. Among many alike, the least expected cost of the 12
# nearest is 0.6 % above that of the 32 nearest, in the mean.
_MAX_CONSIDERED = 12
# Usual relative error of expected costs: three standard deviations of optimised to expected costs
# among the primitives of a request (1.6 % for the human-like arm).
_USUAL_ERROR = 0.05
# Primitives with which motions are planned at most, and whose tables stay in memory.
_MAX_CONTENDERS, _N_KEPT_TABLES = 5, 1000


Contender = tuple[MovementPrimitive, ConditionalDistribution]
"""A primitive and its prediction for a request."""


class Selector:
    """Chooses among primitives of the same joints.

    Parameters
    ----------
    robot : Robot
        The model.
    primitives : PrimitiveLibrary or sequence of MovementPrimitive
        At least one.
    objectives : sequence of (float, Objective)
        Running costs and their weights, as in :class:`.PlannerOptions`.
    max_score : float
        In-span score above which a primitive is only chosen if all are above it; 0: none.
    """

    def __init__(
        self,
        robot: Robot,
        primitives: Sequence[MovementPrimitive],
        objectives: Sequence[tuple[float, Objective]] = ((1.0, effort),),
        max_score: float = 0.0,
    ) -> None:
        self._robot, self._max_score = robot, max_score
        self.primitives = library = PrimitiveLibrary.of(primitives)
        self._objectives = tuple(objectives)
        self._tables = lru_cache(_N_KEPT_TABLES)(lambda i: Tables(library[i].basis))

    def named(self, name: str) -> Selector:
        """The selector for the primitive of that name alone.

        Raises
        ------
        GoalError
            If no primitive has that name.
        """
        return Selector(self._robot, [self.primitives.named(name)], self._objectives)

    def least_score(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> float:
        """The least in-span score of all primitives for end points [rad or m] and a time [s]."""
        return float(self._scores(start, goal, duration).min())

    def _scores(self, start: FloatArray, goal: FloatArray, duration: float | None) -> FloatArray:
        """In-span scores of a request for all primitives, shape (n_primitives,)."""
        models, continuous = (p.model for p in self.primitives), self._robot.continuous
        scores = (
            model.in_span_score(*model.turned(start, goal, continuous), duration)
            for model in models
        )
        return np.array(list(scores))

    def choose(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> list[Contender]:
        """The best primitives for a motion from rest to rest.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            End points [rad or m].
        duration : float, optional
            Duration [s]; the one that each primitive predicts unless given.

        Returns
        -------
        contenders : list of Contender
            The one with the least expected cost, then those whose costs are too close to it to be
            ranked.
        """
        chosen = np.zeros(1, dtype=np.intp)
        if len(self.primitives) > 1:
            scores = self._scores(start, goal, duration)
            nearest = np.argsort(scores, kind="stable")[:_MAX_CONSIDERED]
            scores = scores[nearest]
            most = max(self._max_score or np.inf, float(scores.min()))
            near_score = max(_RELATIVE_SCORE * float(scores.min()), _NEAR_SCORE)
            chosen = nearest[(scores <= near_score) & (scores <= most)]
        found = list[Contender]()
        for primitive in (self.primitives[i] for i in chosen):
            ends = primitive.model.turned(start, goal, self._robot.continuous)
            found.append((primitive, primitive.model.predict(*ends, duration)))
        if len(found) == 1:
            return found
        costs = [
            rank_of(self._cost(i, start, goal, expected))
            for i, (_, expected) in zip(chosen.tolist(), found, strict=True)
        ]
        cheapest = np.argsort(costs, kind="stable")[:_MAX_CONTENDERS]
        near = (1.0 + _USUAL_ERROR) * min(costs)
        return [found[i] for i in cheapest if costs[i] <= near]

    def _cost(
        self, i: int, start: FloatArray, goal: FloatArray, expected: ConditionalDistribution
    ) -> float:
        tables = self._tables(i)
        here, there = (JointState(self._robot.joint_names, q) for q in (start, goal))
        # Without time scaling, because tables for each request would dominate the computing time.
        motion = Motion(here, there, expected.duration, tables.basis, expected.weights)
        return cost_of(self._robot, motion, tables, self._objectives)
