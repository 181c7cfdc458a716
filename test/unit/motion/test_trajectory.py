# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories and the array checks behind every value type."""

import numpy as np
import pytest

from mp_pca_planner.arrays import frozen_array, unique_names
from mp_pca_planner.exceptions import GoalError, TrajectoryError
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory

ZERO = np.zeros((3, 2))


def test_arrays_are_copied_and_read_only():
    source = np.ones((3, 2))
    trajectory = Trajectory(("a", "b"), [0.0, 0.1, 0.2], source, ZERO, ZERO)
    source[0, 0] = 5.0
    assert trajectory.positions[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0, 0] = 2.0
    assert (trajectory.n_steps, trajectory.n_joints, trajectory.duration) == (3, 2, 0.2)


@pytest.mark.parametrize("times", [[0.1, 0.2, 0.3], [0.0, 0.2, 0.2], [0.0, 0.2, 0.1]])
def test_times_that_do_not_increase_from_zero_are_refused(times):
    with pytest.raises(TrajectoryError, match="start at 0 and strictly increase"):
        Trajectory(("a", "b"), times, ZERO, ZERO, ZERO)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", range(4))
def test_a_number_that_is_not_finite_is_refused_by_name_and_place(bad, field):
    arrays = [ZERO.copy() for _ in range(4)]
    arrays[field][2, 1] = bad
    name = ("positions", "velocities", "accelerations", "efforts")[field]
    with pytest.raises(TrajectoryError, match=rf"{name}\[2, 1\] is {bad}"):
        Trajectory(("a", "b"), [0.0, 0.1, 0.2], *arrays)


@pytest.mark.parametrize("names", [(), ("a", "a"), ("a", ""), ("a", 3)])
def test_joint_names_must_be_unique_strings(names):
    with pytest.raises(TrajectoryError):
        unique_names(names, "joints", TrajectoryError)


@pytest.mark.parametrize(
    ("values", "message"),
    [("abc", "must be numbers"), ([[1.0]], "shape"), ([1.0, 2.0], "shape"), (None, "shape")],
)
def test_arrays_of_wrong_content_or_shape_are_refused(values, message):
    with pytest.raises(GoalError, match=message):
        frozen_array(values, (3,), "x", GoalError)


def test_a_state_is_at_rest_unless_told_otherwise():
    state = JointState(["a"], [1.0])
    assert state.velocities.tolist() == state.accelerations.tolist() == [0.0]


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_a_goal_needs_a_positive_duration(duration):
    with pytest.raises(GoalError, match="positive number of seconds"):
        JointGoal(JointState(["a"], [1.0]), duration)
