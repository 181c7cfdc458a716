# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of pose goals from a frame of the robot to the frame of its base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..exceptions import GoalError, unknown_name
from ..motion.goal import JointState, Pose, PoseGoal
from ..robot.model import Robot


def stated_in(goal: PoseGoal, reference: str, robot: Robot) -> Callable[[JointState], PoseGoal]:
    """Return the conversion of a goal from a reference frame to the frame of the base.

    Parameters
    ----------
    goal : PoseGoal
        Its pose is relative to the reference frame.
    reference : str
        A link of the robot; empty: its base. For a moving link, its pose at the start of the
        motion counts: "10 cm forward" in the frame of a tool.
    robot : Robot
        The robot with the links.

    Raises
    ------
    GoalError
        If there is no such link.

    Returns
    -------
    :
        Takes the start state of the motion and returns the goal in the frame of the base.
    """
    if not reference:
        return lambda _: goal
    if reference not in robot.frame_names:
        reason = unknown_name("link of the robot", reference, robot.frame_names)
        raise GoalError(
            f"the goal is stated in the frame '{reference}', but {reason}; an empty frame_id "
            "means the base"
        )
    # The origin of the reference frame and the ends of its axes give its pose.
    points = robot.attach_points([reference] * 4, np.vstack([np.zeros(3), np.eye(3)]))

    def make_goal(start: JointState) -> PoseGoal:
        index = [start.joint_names.index(name) for name in robot.joint_names]
        (ends,), _ = points.positions_and_jacobians(start.positions[None, index])
        axes = (ends[1:] - ends[0]).T
        pose = goal.pose
        orientation = pose.orientation
        if orientation is not None:
            # Imported late for a fast start of the node.
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_matrix(axes) * Rotation.from_quat(orientation)
            orientation = turned.as_quat()
        position = ends[0] + axes @ pose.position
        return replace(goal, pose=Pose(pose.frame, position, orientation))

    return make_goal
