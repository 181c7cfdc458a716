# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States and goals from arrays, dicts, poses and lists of them, complete and finite."""

import re

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
HERE = JointState(JOINTS, [0.0, 1.0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: JointState(("a", "a"), [0, 0]), "'a'"),
        (lambda: JointState(("a",), [np.nan]), "positions"),
        (lambda: JointGoal(HERE, duration=-1.0), "-1"),
        (
            lambda: JointGoal(HERE, duration="shortest"),
            "`PlannerOptions(timing=…)` chooses without one, must be a number of",
        ),
        (lambda: Pose("hand", [0, 0, 0], [0, 0, 0, 2]), "length 2"),
        (lambda: SequenceGoal(()), "number of targets must be a whole number from 1 to 200, got 0"),
        (lambda: SequenceGoal((HERE, HERE), (2.0, 1.0)), "positive and increase, got (2.0, 1.0)"),
        (lambda: SequenceGoal((HERE, HERE), stops=(True,)), "a stop for each of its 2 targets"),
        (lambda: as_goal(JointGoal(HERE), JOINTS, 2.0), "has its own duration"),
        (lambda: as_goal([[0.1, 0.2], [0.3]], JOINTS), "target 2 must be one position"),
        (lambda: as_state([0.1], JOINTS, "the start"), "the start must be one position"),
        (lambda: as_state([0, np.inf], JOINTS, "the start"), "the position of joint 'b' is inf"),
    ],
)
def test_bad_goals_are_rejected(make, words):
    with pytest.raises(GoalError, match=re.escape(words)):
        make()


@pytest.mark.parametrize("value", [[0.1, 0.2], np.array([0.1, 0.2]), {"a": 0.1, "b": 0.2}])
def test_one_target_is_a_goal_with_its_duration(value):
    goal = as_goal(value, JOINTS, 2.0)
    assert isinstance(goal, JointGoal) and goal.duration == 2.0
    assert goal.state.joint_names == JOINTS
    assert [x.tolist() for x in goal.state.values] == [[0.1, 0.2], [0.0, 0.0], [0.0, 0.0]]
    assert as_goal(goal, JOINTS) is goal


def test_pose_is_a_pose_goal_with_a_quaternion_of_length_one():
    pose = Pose("hand", [0.1, 0.2, 0.3], [0, 0, 0, 1.0005])
    assert np.linalg.norm(pose.orientation) == pytest.approx(1.0, abs=1e-15)
    goal = as_goal(pose, JOINTS)
    assert isinstance(goal, PoseGoal) and (goal.pose, goal.duration) == (pose, None)


@pytest.mark.parametrize(
    "value",
    [
        [[0.1, 0.2], {"a": 0.3}, Pose("hand", [0.1, 0.2, 0.3])],
        np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]),
    ],
)
def test_several_targets_are_a_sequence_that_ends_in_its_duration(value):
    goal = as_goal(value, JOINTS, 3.0)
    assert isinstance(goal, SequenceGoal) and len(goal.targets) == 3
    assert (goal.times, goal.stops) == ((None, None, 3.0), (False, False, False))
