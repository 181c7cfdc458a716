# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The goal that was served last, and its answer to goals that repeat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..motion.goal import Goal, JointGoal, SequenceGoal
from ..planning.plan import Plan
from ..planning.sequence import SequencePlan
from .adaptation import AdaptedPlan
from .assembly import Model
from .goal_comparison import is_same_configuration, is_same_goal
from .published_motion import PublishedMotion
from .start_state import MotionStart

if TYPE_CHECKING:
    from .trial_store import ServedTrial

AnyPlan = Plan | SequencePlan | AdaptedPlan


@dataclass(frozen=True, eq=False)
class Served:
    """A goal whose motion was published, or is under way already.

    Attributes
    ----------
    goal : Goal
        The goal.
    plan : Plan, SequencePlan or AdaptedPlan
        The plan.
    model : Model
        What it was made with.
    motion : PublishedMotion
        What was published.
    trial : ServedTrial or None
        The trial that it is, if the goal is learned by trials.
    under_way : str
        Why nothing was published for a goal that repeats; empty if a motion was.
    """

    goal: Goal
    plan: AnyPlan
    model: Model
    motion: PublishedMotion
    trial: ServedTrial | None = None
    under_way: str = ""

    def answer(self, goal: Goal, start: MotionStart, model: Model) -> str:
        """Why nothing has to be published for another goal; empty if a motion is needed."""
        following = start.following
        if following is None or self.motion is not following.motion or self.model is not model:
            return ""
        if following.is_running:
            if not is_same_goal(goal, self.goal):
                return ""
            rate = max(following.progress.rate, 0.01)
            left = (following.motion.duration - following.progress.place) / rate
            return f"the goal is under way: the robot arrives in {left:.2g} s"
        if isinstance(goal, SequenceGoal):
            return ""
        if not is_same_goal(goal, self.goal):
            if not isinstance(goal, JointGoal):
                return ""
            model.planner.check(goal)
            target = model.planner.target(goal, start.state)
            if not is_same_configuration(target, start.state):
                return ""
        error = f"{following.distance:.3g} rad (or m), of joint '{following.joint}'"
        return f"the robot is at the goal: the largest error is {error}"
