# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The goal that was served last, and goals that repeat it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import starmap
from typing import TYPE_CHECKING, Any

import numpy as np

from ..motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.requests.states import in_order
from ..primitives.primitive import MovementPrimitive
from .assembly import Model
from .published_motion import PublishedMotion
from .start_state import MotionStart

if TYPE_CHECKING:
    from .goal_planner import AnyPlan
    from .trial_store import ServedTrial

# Goals closer than this are the same [rad or m]: controllers and encoders resolve no more.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class Served:
    """A goal whose motion was published, or is under way already.

    Attributes
    ----------
    goal : Goal
        The goal.
    plan : Plan or AdaptedPlan
        The plan.
    model : Model
        The model it was planned with.
    motion : PublishedMotion
        The published motion.
    name : object
        Identifies the goal in the report of its execution.
    trial : ServedTrial or None
        The trial of the motion, if the goal is learned by trials.
    primitives : tuple of MovementPrimitive
        Those of the plan. Its names may be missing in the library of a newer model.
    under_way : str
        Why nothing was published for a goal that repeats; empty if a motion was.
    """

    goal: Goal
    plan: AnyPlan
    model: Model
    motion: PublishedMotion
    name: Any = None
    trial: ServedTrial | None = None
    primitives: tuple[MovementPrimitive, ...] = ()
    under_way: str = ""

    def rest_of_goal(self, place: float) -> Goal:
        """The goal for all joints, without a duration and without the targets before a place [s].

        Joints that the goal doesn't name keep the position that they were to have, not the one at
        that place.
        """
        goal, motions = self.goal, getattr(self.plan, "motions", ())
        if isinstance(goal, PoseGoal):
            return replace(goal, duration=None)
        end = self.plan.trajectory
        names = end.joint_names
        last: JointState | Pose = JointState(
            names, end.positions[-1], end.velocities[-1], end.accelerations[-1]
        )
        if isinstance(goal, SequenceGoal) and len(motions) == len(goal.targets):
            # The published motion begins with a part of the one that it continues.
            ends = np.cumsum([motion.duration for motion in motions])
            began = self.motion.duration - ends[-1]
            first = int(np.count_nonzero(began + ends[:-1] <= place))
            targets = [
                target if isinstance(target, Pose) else JointState(names, motion.goal.positions)
                for target, motion in zip(goal.targets, motions, strict=True)
            ]
            if targets[first + 1 :]:
                stops = goal.stops[first:]
                return SequenceGoal(tuple(targets[first:]), primitive=goal.primitive, stops=stops)
            last = targets[-1]
        # For one target, more detours are tried than for a sequence.
        if isinstance(last, Pose):
            return PoseGoal(last, primitive=goal.primitive)
        return JointGoal(last, primitive=goal.primitive)

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


def is_same_goal(one: Goal, other: Goal) -> bool:
    """Whether two goals are of the same kind and the same except for rounding."""
    if type(one) is not type(other) or _timing(one) != _timing(other):
        return False
    pairs = zip(_targets(one), _targets(other), strict=True)
    return all(starmap(_is_same_target, pairs))


def is_same_configuration(one: JointState, other: JointState) -> bool:
    """Whether two states of the same joints, in any order, agree."""
    if set(one.joint_names) != set(other.joint_names):
        return False
    pairs = zip(one.values, in_order(other, one.joint_names).values, strict=True)
    return all(np.abs(a - b).max(initial=0.0) <= _SAME for a, b in pairs)


def _timing(goal: Goal) -> tuple[Any, ...]:
    """Options that two goals must share exactly; there are as many times as targets."""
    if isinstance(goal, SequenceGoal):
        return goal.primitive, goal.times, goal.stops
    return goal.primitive, goal.duration


def _targets(goal: Goal) -> tuple[JointState | Pose, ...]:
    if isinstance(goal, SequenceGoal):
        return goal.targets
    return (goal.state if isinstance(goal, JointGoal) else goal.pose,)


def _is_same_target(one: JointState | Pose, other: JointState | Pose) -> bool:
    if isinstance(one, JointState) and isinstance(other, JointState):
        return is_same_configuration(one, other)
    if not (isinstance(one, Pose) and isinstance(other, Pose)) or one.frame != other.frame:
        return False
    if np.abs(one.position - other.position).max() > _SAME:
        return False
    if one.orientation is None or other.orientation is None:
        return one.orientation is other.orientation
    # Quaternions of the same rotation may differ in sign.
    return abs(float(one.orientation @ other.orientation)) >= 1.0 - 0.125 * _SAME**2
