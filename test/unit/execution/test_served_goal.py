# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals that ask for the same."""

from __future__ import annotations

import numpy as np
import pytest

from mp_pca_planner.execution.outcomes import is_same_configuration, is_same_goal
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal

STATE = JointState(("a", "b"), [0.1, 0.2])
HALF = np.sqrt(0.5)
POSE = Pose("hand", [0.1, 0.2, 0.3], [HALF, 0.0, 0.0, HALF])


def turned(angle):
    return Pose(
        "hand",
        [0.1, 0.2, 0.3],
        [np.sin(np.pi / 4 + angle / 2), 0.0, 0.0, np.cos(np.pi / 4 + angle / 2)],
    )


SAME = [
    (JointGoal(STATE), JointGoal(JointState(("b", "a"), [0.2, 0.1]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.10009, 0.2]))),
    (PoseGoal(POSE), PoseGoal(Pose("hand", POSE.position, -POSE.orientation))),
    (PoseGoal(POSE), PoseGoal(turned(0.9e-4))),
    (PoseGoal(Pose("hand", [0, 0, 1])), PoseGoal(Pose("hand", [0, 0, 1.00009]))),
    (SequenceGoal((STATE, POSE), (None, 2.0)), SequenceGoal((STATE, POSE), (None, 2.0))),
]
DIFFERENT = [
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.10011, 0.2]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "c"), [0.1, 0.2]))),
    (JointGoal(STATE), JointGoal(JointState(("a",), [0.1]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.1, 0.2], [0.0, 0.1]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.1, 0.2], None, [0.0, 0.1]))),
    (JointGoal(STATE), JointGoal(STATE, duration=2.0)),
    (JointGoal(STATE), JointGoal(STATE, primitive="reach")),
    (JointGoal(STATE), PoseGoal(POSE)),
    (JointGoal(STATE), SequenceGoal((STATE,))),
    (PoseGoal(POSE), PoseGoal(Pose("hand", POSE.position))),
    (PoseGoal(POSE), PoseGoal(Pose("elbow", POSE.position, POSE.orientation))),
    (PoseGoal(POSE), PoseGoal(turned(1.1e-4))),
    (PoseGoal(Pose("hand", [0, 0, 1])), PoseGoal(Pose("hand", [0, 0, 1.00011]))),
    (SequenceGoal((STATE, POSE)), SequenceGoal((POSE, STATE))),
    (SequenceGoal((STATE, POSE)), SequenceGoal((STATE,))),
    (SequenceGoal((STATE, POSE)), SequenceGoal((STATE, POSE), (None, 2.0))),
    (SequenceGoal((STATE, POSE)), SequenceGoal((STATE, POSE), stops=(True, False))),
]


@pytest.mark.parametrize(("one", "other"), SAME)
def test_goals_that_ask_for_the_same_but_for_rounding_are_the_same(one, other):
    assert is_same_goal(one, other) and is_same_goal(other, one)


@pytest.mark.parametrize(("one", "other"), DIFFERENT)
def test_goals_that_ask_for_something_else_are_not_the_same(one, other):
    assert not is_same_goal(one, other) and not is_same_goal(other, one)


def test_configurations_are_compared_by_name_and_with_their_velocities():
    assert is_same_configuration(STATE, JointState(("b", "a"), [0.2, 0.1]))
    assert not is_same_configuration(STATE, JointState(("b", "a"), [0.1, 0.2]))
    assert not is_same_configuration(STATE, JointState(("a", "b"), [0.1, 0.2], [1e-3, 0.0]))
