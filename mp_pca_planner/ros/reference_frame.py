# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Poses that are stated in a frame of the robot → poses in the frame of its base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..exceptions import GoalError, unknown_name
from ..motion.goal import JointState, Pose, PoseGoal
from ..robot.model import Robot


def stated_in(goal: PoseGoal, reference: str, robot: Robot) -> Callable[[JointState], PoseGoal]:
    """Say how a goal that is stated in a frame becomes one in the frame of the base.

    Parameters
    ----------
    goal : PoseGoal
        Its pose is relative to the reference frame.
    reference : str
        A link of the robot; empty: its base. A link that moves is taken where it is at the
        start of the motion: "10 cm forward" in the frame of a tool.
    robot : Robot
        Knows the links.

    Raises
    ------
    GoalError
        If there is no such link.
    """
    if not reference:
        return lambda _: goal
    if reference not in robot.frame_names:
        reason = unknown_name("link of the robot", reference, robot.frame_names)
        raise GoalError(
            f"the goal is stated in the frame '{reference}', but {reason}; an empty frame_id "
            "stands for the base"
        )
    # The origin of the reference frame and the ends of its axes tell where and how it is.
    points = robot.attach_points([reference] * 4, np.vstack([np.zeros(3), np.eye(3)]))

    def make_goal(start: JointState) -> PoseGoal:
        index = [start.joint_names.index(name) for name in robot.joint_names]
        (ends,), _ = points.positions_and_jacobians(start.positions[None, index])
        axes = (ends[1:] - ends[0]).T
        pose = goal.pose
        orientation = pose.orientation
        if orientation is not None:
            # Late, so that the node starts fast.
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_matrix(axes) * Rotation.from_quat(orientation)
            orientation = turned.as_quat()
        position = ends[0] + axes @ pose.position
        return replace(goal, pose=Pose(pose.frame, position, orientation))

    return make_goal
