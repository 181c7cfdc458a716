# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.robot.model import Robot


@pytest.fixture(scope="module")
def robot() -> Robot:
    return arm_robot()


@pytest.fixture(scope="module")
def limits(robot) -> JointLimits:
    slower = {name: {"max_velocity": 2.0, "max_acceleration": 30.0} for name in JOINTS}
    return robot.limits(slower)


def test_reaches_keep_the_limits_and_go_from_rest_to_rest(robot, limits):
    for reach in random_reaches(robot, limits, 10, 3):
        motion = Trajectory(
            reach.joint_names, reach.times, reach.positions, reach.velocities, reach.accelerations
        )
        assert check_limits(motion, robot, limits).worst_excess <= 1e-6
        assert np.abs(reach.velocities[[0, -1]]).max() < 1e-9
        assert np.abs(reach.positions[-1] - reach.positions[0]).max() > 0.1


def test_arm_that_can_hold_nothing_is_refused_in_a_sentence(robot):
    weak = robot.limits({name: {"max_effort": 1e-3} for name in JOINTS})
    with pytest.raises(RecordingError, match="at least 1, got 0"):
        random_reaches(robot, weak, 0, 1)
    with pytest.raises(RecordingError, match=r"that the 4 joints .* fewer joints"):
        random_reaches(robot, weak, 1, 1)
