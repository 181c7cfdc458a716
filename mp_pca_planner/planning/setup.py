# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot, limits and options that all parts of a planner share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.collision import Collision, CollisionModel
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .motion import Motion
from .plan import PlannerOptions


@dataclass(eq=False)
class Setup:
    """The robot, limits and options of a planner.

    Attributes
    ----------
    robot : Robot
        The model.
    limits : JointLimits
        Limits of its joints.
    options : PlannerOptions
        Options of planning.
    collision : CollisionModel or None
        The model of its collisions, if they are checked; the only part that may be replaced.
    """

    robot: Robot
    limits: JointLimits
    options: PlannerOptions
    collision: CollisionModel | None

    @property
    def longest(self) -> float:
        """The longest duration of a motion that is accepted [s]."""
        return INPUT_LIMITS.longest_motion(self.options.sample_period)

    def check_duration(self, what: str, seconds: float) -> None:
        """Reject a motion whose points would take too much time and memory, or overflow.

        Raises
        ------
        GoalError
            If the duration is longer than `longest`, or shorter than a microsecond.
        """
        if not seconds <= self.longest:
            raise GoalError(
                f"{what} {seconds:.4g} s, at most {self.longest:g} s are accepted with a sample "
                f"period of {self.options.sample_period:g} s"
            )
        if not seconds >= INPUT_LIMITS.shortest:
            raise GoalError(
                f"{what} {seconds:.4g} s, at least {INPUT_LIMITS.shortest:g} s are accepted"
            )

    def sample(self, motions: Sequence[Motion]) -> Trajectory:
        """The points of a trajectory through some segments, without efforts.

        Raises
        ------
        GoalError
            If they would take too long, see :meth:`check_duration`; nothing is sampled then.
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

    def for_detours(self) -> Setup:
        """The same with the tolerance and the first radius of the solver on detours."""
        tolerance, radius = self.options.search.detour_tolerance, self.options.search.detour_radius
        solver = replace(self.options.solver, tolerance=tolerance, first_radius=radius)
        return replace(self, options=replace(self.options, solver=solver))
