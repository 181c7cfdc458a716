# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from mp_pca_planner.exceptions import PlannerError, TrajectoryError
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


@pytest.mark.parametrize("times", [[0.1, 0.2, 0.3], [0.0, 0.2, 0.2]])
def test_times_that_do_not_increase_from_zero_are_rejected(times):
    with pytest.raises(TrajectoryError, match="start at 0 and strictly increase"):
        Trajectory(("a", "b"), times, ZERO, ZERO, ZERO)


@pytest.mark.parametrize("field", ["positions", "velocities", "accelerations", "efforts"])
def test_a_number_that_is_not_finite_is_rejected_by_name_and_place(field):
    arrays = dict.fromkeys(("positions", "velocities", "accelerations", "efforts"), ZERO)
    arrays[field] = np.where(np.arange(6).reshape(3, 2) == 5, np.nan, 0.0)
    with pytest.raises(TrajectoryError, match=rf"{field}\[2, 1\] is nan"):
        Trajectory(("a", "b"), [0.0, 0.1, 0.2], **arrays)


def test_trajectories_are_saved_and_become_messages_point_by_point(tmp_path):
    motion = Trajectory(["a"], [0.0, 0.25], *np.arange(8.0).reshape(4, 2, 1))
    columns = ["times", "positions", "velocities", "accelerations"]
    assert list(motion.columns()) == [*columns, "efforts"]
    assert list(motion.with_efforts(None).columns()) == columns
    motion.save(tmp_path / "motion.mcap")
    assert (tmp_path / "motion.mcap").stat().st_size > 0
    with pytest.raises(PlannerError, match=r"motion\.txt' must end in \.csv"):
        motion.save(tmp_path / "motion.txt")
    pytest.importorskip("trajectory_msgs")
    message = motion.to_message()
    assert message.joint_names == ["a"]
    assert list(message.points[1].velocities) == [3.0]
    assert message.points[1].time_from_start.nanosec == 250_000_000
    assert not message.points[1].effort
    assert list(motion.to_message(with_efforts=True).points[0].effort) == [6.0]
