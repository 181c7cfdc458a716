# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What all steps of planning share: robot, limits, world and options."""

from __future__ import annotations

from dataclasses import dataclass

from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.collision import CollisionModel
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .options import PlannerOptions
from .program.bases import BasisStore


@dataclass(frozen=True, eq=False)
class Context:
    """Everything about a planner but its primitives.

    Attributes
    ----------
    robot : Robot
        The model.
    limits : JointLimits
        Limits of its joints.
    options : PlannerOptions
        Options of planning.
    collision : CollisionModel or None
        The model of its collisions, if they are checked.
    bases : BasisStore
        The bases of motions, with tables that are kept.
    longest : float
        The longest duration of a motion that is accepted [s].
    """

    robot: Robot
    limits: JointLimits
    options: PlannerOptions
    collision: CollisionModel | None
    bases: BasisStore
    longest: float


def check_duration(context: Context, what: str, seconds: float) -> None:
    """Reject a motion whose points would take too much time and memory, or overflow.

    Parameters
    ----------
    context : Context
        Of the planner.
    what : str
        The beginning of the message, such as "the duration is".
    seconds : float
        The duration [s].

    Raises
    ------
    GoalError
        If the duration is longer than `longest`, or shorter than a microsecond.
    """
    if not seconds <= context.longest:
        raise GoalError(
            f"{what} {seconds:.4g} s, at most {context.longest:g} s are accepted with a sample "
            f"period of {context.options.sample_period:g} s"
        )
    if not seconds >= INPUT_LIMITS.shortest:
        raise GoalError(
            f"{what} {seconds:.4g} s, at least {INPUT_LIMITS.shortest:g} s are accepted"
        )
