# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What all steps of planning share: robot, limits, world and options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.collision import Collision, CollisionModel
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .motion import Motion
from .options import PlannerOptions
from .program.store import BasisStore


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
    """

    robot: Robot
    limits: JointLimits
    options: PlannerOptions
    collision: CollisionModel | None
    bases: BasisStore

    @property
    def searches_paths(self) -> bool:
        """Whether there are pairs of bodies that paths lead around."""
        return self.collision is not None and bool(self.collision.pairs)

    @property
    def longest(self) -> float:
        """The longest duration of a motion that is accepted [s]."""
        return INPUT_LIMITS.longest_motion(self.options.sample_period)

    def check_duration(self, what: str, seconds: float) -> None:
        """Reject a motion whose points would take too much time and memory.

        Raises
        ------
        GoalError
            If the duration is longer than `longest`.
        """
        if not seconds <= self.longest:
            raise GoalError(
                f"{what} {seconds:.4g} s, at most {self.longest:g} s are accepted with a sample "
                f"period of {self.options.sample_period:g} s"
            )

    def sample(self, motions: Sequence[Motion]) -> Trajectory:
        """The points of a trajectory through some segments, without efforts.

        Raises
        ------
        GoalError
            If they would take longer than `longest`; nothing is sampled then.
        """
        self.check_duration("the motion would take", sum(motion.duration for motion in motions))
        times, states, began = [], [], 0.0
        for i, motion in enumerate(motions):
            own, values = motion.sample(self.options.sample_period)
            first = min(i, 1)
            times.append(began + own[first:])
            states.append(values[:, first:])
            began += motion.duration
        q, v, a = np.concatenate(states, axis=1)
        return Trajectory(self.robot.joint_names, np.concatenate(times), q, v, a)

    def check(self, trajectory: Trajectory) -> LimitCheck:
        """Comparison of a trajectory with the limits."""
        return check_limits(trajectory, self.robot, self.limits)

    def collisions(
        self, trajectory: Trajectory, *, precisely: bool = False
    ) -> tuple[Collision, ...]:
        """Collisions of a trajectory, if they are checked."""
        if self.collision is None:
            return ()
        return self.collision.collisions(trajectory, precisely=precisely)
