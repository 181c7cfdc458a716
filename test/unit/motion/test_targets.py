# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States and goals from arrays, dicts, poses and lists of them."""

import numpy as np
import pytest

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.goal import (
    JointGoal,
    JointState,
    Pose,
    PoseGoal,
    SequenceGoal,
    as_goal,
    as_state,
)

JOINTS = ("a", "b")


@pytest.mark.parametrize("value", [[0.1, 0.2], (0.1, 0.2), np.array([0.1, 0.2])])
def test_array_is_a_state_of_all_joints(value: object) -> None:
    state = as_state(value, JOINTS, "the start")
    assert state.joint_names == JOINTS
    assert state.positions.tolist() == [0.1, 0.2]


def test_dict_is_a_state_of_the_joints_it_names() -> None:
    state = as_state({"b": 1}, JOINTS, "the start")
    assert (state.joint_names, state.positions.tolist()) == (("b",), [1.0])


@pytest.mark.parametrize("value", [[0.1], [[0.1, 0.2]], 0.1, "ab", None, {"a": "x"}, {"a": None}])
def test_other_states_are_rejected_with_what_is_accepted(value: object) -> None:
    with pytest.raises(GoalError, match=r"^the start .* joints"):
        as_state(value, JOINTS, "the start")


def test_one_target_is_a_goal_with_its_duration() -> None:
    goal = as_goal({"a": 0.5}, JOINTS, 2.0)
    assert isinstance(goal, JointGoal)
    assert (goal.state.joint_names, goal.duration) == (("a",), 2.0)


def test_pose_is_a_pose_goal() -> None:
    pose = Pose("hand", [0.1, 0.2, 0.3])
    goal = as_goal(pose, JOINTS)
    assert isinstance(goal, PoseGoal)
    assert (goal.pose, goal.duration) == (pose, None)


@pytest.mark.parametrize(
    "value",
    [
        [[0.1, 0.2], {"a": 0.3}, Pose("hand", [0.1, 0.2, 0.3])],
        np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]),
        [JointState(JOINTS, [0.1, 0.2]), np.array([0.3, 0.4]), (0.5, 0.6)],
    ],
)
def test_several_targets_are_a_sequence_that_ends_in_its_duration(value: object) -> None:
    goal = as_goal(value, JOINTS, 3.0)
    assert isinstance(goal, SequenceGoal)
    assert len(goal.targets) == 3
    assert goal.times == (None, None, 3.0)


def test_finished_goal_stays_as_it_is_and_takes_no_second_duration() -> None:
    goal = JointGoal(JointState(JOINTS, [0.1, 0.2]), duration=1.0)
    assert as_goal(goal, JOINTS) is goal
    with pytest.raises(GoalError, match="has its own duration"):
        as_goal(goal, JOINTS, 2.0)


def test_message_names_the_target_of_a_list() -> None:
    with pytest.raises(GoalError, match="^target 2 must be one position .* for each of the 2"):
        as_goal([[0.1, 0.2], [0.3]], JOINTS)
