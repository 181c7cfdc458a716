# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of goals: whether two of them ask for the same."""

from __future__ import annotations

from itertools import starmap

import numpy as np

from ..motion.goal import Goal, JointGoal, JointState, Pose, SequenceGoal

# Goals that are nearer to each other than this are the same [rad or m]: controllers and encoders
# resolve no more.
_SAME = 1e-4


def is_same_goal(one: Goal, other: Goal) -> bool:
    """Whether two goals are of the same kind and ask for the same, but for rounding."""
    if type(one) is not type(other) or one.primitive != other.primitive:
        return False
    if isinstance(one, SequenceGoal) and isinstance(other, SequenceGoal):
        return (
            one.times == other.times
            and one.stops == other.stops
            and len(one.targets) == len(other.targets)
            and all(starmap(_is_same_target, zip(one.targets, other.targets, strict=True)))
        )
    if isinstance(one, SequenceGoal) or isinstance(other, SequenceGoal):
        return False
    if one.duration != other.duration or one.vias or other.vias:
        return False
    first, second = (
        goal.state if isinstance(goal, JointGoal) else goal.pose for goal in (one, other)
    )
    return _is_same_target(first, second)


def is_same_configuration(one: JointState, other: JointState) -> bool:
    """Whether two states are of the same joints, in whichever order, and agree."""
    if set(one.joint_names) != set(other.joint_names):
        return False
    order = [other.joint_names.index(name) for name in one.joint_names]
    return all(
        np.abs(getattr(one, field) - getattr(other, field)[order]).max(initial=0.0) <= _SAME
        for field in ("positions", "velocities", "accelerations")
    )


def _is_same_target(one: JointState | Pose, other: JointState | Pose) -> bool:
    if isinstance(one, JointState) and isinstance(other, JointState):
        return is_same_configuration(one, other)
    if not (isinstance(one, Pose) and isinstance(other, Pose)) or one.frame != other.frame:
        return False
    if np.abs(one.position - other.position).max() > _SAME:
        return False
    if one.orientation is None or other.orientation is None:
        return one.orientation is other.orientation
    # Quaternions of the same rotation differ in sign.
    return abs(float(one.orientation @ other.orientation)) >= 1.0 - 0.125 * _SAME**2
