# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is asked of the planner is complete and finite, or refused by name."""

import re
from typing import Any

import numpy as np
import pytest

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal

HERE = JointState(("a", "b"), [0.0, 1.0])


def test_quaternion_is_made_of_length_one() -> None:
    pose = Pose("hand", [0, 0, 1], [0, 0, 0, 1.0005])
    assert pose.orientation is not None
    assert np.linalg.norm(pose.orientation) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: JointState(("a", "a"), [0, 0]), "'a'"),
        (lambda: JointState(("a",), [np.nan]), "positions"),
        (lambda: JointState(("a",), [1.0, 2.0]), "positions"),
        (lambda: JointGoal(HERE, duration=-1.0), "-1"),
        (lambda: JointGoal(HERE, duration="shortest"), "'shortest'; use `PlannerOptions"),
        (lambda: PoseGoal(Pose("hand", [0, 0, 0]), duration=np.nan), "nan"),
        (lambda: Pose("hand", [0, 0, np.inf]), "position of a pose"),
        (lambda: Pose("hand", [0, 0, 0], [0, 0, 0, 2]), "length 2"),
        (lambda: Pose("hand", [0, 0, 0], [0, 0, 0, 0]), "length 0"),
        (lambda: SequenceGoal(()), "at least one target"),
        (lambda: SequenceGoal((HERE, HERE), (1.0,)), "2 targets, got 1"),
        (lambda: SequenceGoal((HERE, HERE), (2.0, 1.0)), "1.0 after 2"),
        (lambda: SequenceGoal((HERE,), (np.inf,)), "inf"),
    ],
)
def test_nonsense_is_refused(make: Any, words: str) -> None:
    with pytest.raises(GoalError, match=re.escape(words)):
        make()


def test_sequence_says_of_each_target_whether_it_stops_there() -> None:
    state = JointState(["a"], [0.0])
    assert SequenceGoal((state, state)).stops == (False, False)
    with pytest.raises(GoalError, match="a stop for each of its 2 targets, got 1"):
        SequenceGoal((state, state), stops=(True,))
