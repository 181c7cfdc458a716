# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories and the array checks behind every value type."""

import numpy as np
import pytest

from mp_pca_planner.arrays import frozen_array
from mp_pca_planner.exceptions import (
    GoalError,
    PlannerError,
    TrajectoryError,
)
from mp_pca_planner.motion.goal import JointState
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


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("abc", "must be numbers"),
        ([[1.0]], "shape"),
        ([1.0, 2.0], "shape"),
        (None, "must be numbers"),
    ],
)
def test_arrays_of_wrong_content_or_shape_are_refused(values, message):
    with pytest.raises(GoalError, match=message):
        frozen_array(values, (3,), "x", GoalError)


def test_a_state_is_at_rest_unless_told_otherwise():
    state = JointState(["a"], [1.0])
    assert state.velocities.tolist() == state.accelerations.tolist() == [0.0]


def test_a_trajectory_is_saved_as_a_bag(tmp_path):
    Trajectory(["a"], [0.0, 0.1], *np.zeros((3, 2, 1))).save(tmp_path / "motion.mcap")
    assert (tmp_path / "motion.mcap").stat().st_size > 0


def test_a_file_of_an_unknown_format_is_refused(tmp_path):
    with pytest.raises(PlannerError, match=r"motion\.txt' must end in \.csv"):
        Trajectory(["a"], [0.0], *np.zeros((3, 1, 1))).save(tmp_path / "motion.txt")


def test_a_trajectory_becomes_a_message_point_by_point():
    pytest.importorskip("trajectory_msgs")
    motion = Trajectory(["a"], [0.0, 0.25], *np.arange(8.0).reshape(4, 2, 1))
    message = motion.to_message()
    assert message.joint_names == ["a"]
    assert list(message.points[1].velocities) == [3.0]
    assert message.points[1].time_from_start.nanosec == 250_000_000
    assert not message.points[1].effort
    assert list(motion.to_message(with_efforts=True).points[0].effort) == [6.0]
