# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of goals: whether two of them are the same."""

from __future__ import annotations

from itertools import starmap
from typing import Any

import numpy as np

from ..motion.goal import Goal, JointGoal, JointState, Pose, SequenceGoal

# Goals closer than this are the same [rad or m]: controllers and encoders resolve no more.
_SAME = 1e-4


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
    order = [other.joint_names.index(name) for name in one.joint_names]
    return all(
        np.abs(getattr(one, field) - getattr(other, field)[order]).max(initial=0.0) <= _SAME
        for field in ("positions", "velocities", "accelerations")
    )


def _timing(goal: Goal) -> tuple[Any, ...]:
    """What two goals must share exactly; there are as many times as targets."""
    if isinstance(goal, SequenceGoal):
        return goal.primitive, goal.times, goal.stops
    # Vias are compared by identity: goals of the node have none.
    return goal.primitive, goal.duration, goal.vias


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
