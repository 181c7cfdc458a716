# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner under the name that it had for sequences."""

from __future__ import annotations

from collections.abc import Sequence

from ..motion.collision import CollisionModel
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .plan import MODES, OPTIMAL, REAL_TIME, PlannerOptions
from .plan import Plan as SequencePlan
from .planner import Planner

__all__ = ["MODES", "OPTIMAL", "REAL_TIME", "SequencePlan", "SequencePlanner"]


class SequencePlanner(Planner):
    """A :class:`.Planner` without a time limit unless given.

    Parameters
    ----------
    robot, primitives, limits, collision
        See :class:`.Planner`.
    naturalness, sample_period, max_solve_time : float
        See :class:`.PlannerOptions`.
    """

    def __init__(
        self,
        robot: Robot,
        primitives: Sequence[MovementPrimitive],
        limits: JointLimits,
        *,
        naturalness: float = 1.0,
        sample_period: float = 0.01,
        max_solve_time: float = float("inf"),
        collision: CollisionModel | None = None,
    ) -> None:
        options = PlannerOptions(
            naturalness=naturalness, sample_period=sample_period, max_solve_time=max_solve_time
        )
        super().__init__(robot, primitives, limits, options, collision)
