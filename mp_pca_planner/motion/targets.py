# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of arrays, dicts, poses and lists of targets to states and goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeGuard, cast

import numpy as np
from numpy.typing import ArrayLike

from ..exceptions import GoalError
from .goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal

StateLike = JointState | Mapping[str, float] | ArrayLike
"""A configuration: positions by joint name, or of all joints of the robot in their order."""

TargetLike = StateLike | Pose
GoalLike = Goal | TargetLike | Sequence[TargetLike]


def as_state(value: StateLike, joint_names: Sequence[str], what: str) -> JointState:
    """Make a state of positions.

    Parameters
    ----------
    value : JointState, mapping or array, shape (n_joints,)
        Positions [rad or m] by joint name, or of all joints in their order.
    joint_names : sequence of str
        The joints of an array, n_joints of them.
    what : str
        Name of the state in messages.

    Raises
    ------
    GoalError
        If the value is none of these, or its length is not the number of joints.
    """
    if isinstance(value, JointState):
        return value
    try:
        if isinstance(value, Mapping):
            return JointState(tuple(value), [float(position) for position in value.values()])
        positions = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise GoalError(
            f"{what} must be positions [rad or m] of the {len(joint_names)} joints, or a dict of "
            f"positions by joint name, got {value!r:.100}"
        ) from None
    if positions.shape != (len(joint_names),):
        raise GoalError(
            f"{what} needs one position for each of the {len(joint_names)} joints "
            f"({', '.join(joint_names)}), got an array of shape {positions.shape}"
        )
    return JointState(joint_names, positions)


def as_goal(value: GoalLike, joint_names: Sequence[str], duration: float | None = None) -> Goal:
    """Make a goal of a target or of several.

    Parameters
    ----------
    value : Goal, Pose, JointState, mapping, array or sequence of these
        A goal is returned unchanged. One target becomes a goal to reach at rest; several become a
        sequence, passed without a stop.
    joint_names : sequence of str
        The joints of an array, n_joints of them.
    duration : float, optional
        Duration of the motion [s]; chosen by the planner unless given.

    Raises
    ------
    GoalError
        If the value is none of these, or a duration is given for a finished goal.
    """
    if isinstance(value, Goal):
        if duration is not None:
            raise GoalError(
                f"a {type(value).__name__} holds its own duration or times: leave `duration` out"
            )
        return value
    if _is_several(value):
        targets = [_as_target(v, joint_names, f"target {i}") for i, v in enumerate(value, 1)]
        times = (*(None for _ in targets[1:]), duration)
        return SequenceGoal(tuple(targets), times)
    target = _as_target(cast(TargetLike, value), joint_names, "the goal")
    if isinstance(target, Pose):
        return PoseGoal(target, duration)
    return JointGoal(target, duration)


def _is_several(value: object) -> TypeGuard[Sequence[TargetLike]]:
    """Whether a value is a list of targets, rather than one list of positions."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2
    return isinstance(value, Sequence) and any(
        isinstance(one, (JointState, Pose, Mapping, Sequence, np.ndarray)) for one in value
    )


def _as_target(value: TargetLike, joint_names: Sequence[str], what: str) -> JointState | Pose:
    return value if isinstance(value, Pose) else as_state(value, joint_names, what)
