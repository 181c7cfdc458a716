# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that are stated in frames outside of the robot."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping

import numpy as np

from ..arrays import FloatArray
from ..robot.world import Obstacle

Poses = Mapping[str, FloatArray | None]
"""Poses of frames in the base frame of the robot, shape (7,) each; None where it is unknown."""

# Change of a coordinate or of a component of a quaternion that moves an obstacle.
_MOVED = 1e-4


def foreign_poses(
    obstacles: Iterable[Obstacle],
    links: Collection[str],
    pose_of: Callable[[str], FloatArray | None],
) -> dict[str, FloatArray | None]:
    """Look up the frames of obstacles that are not links.

    Parameters
    ----------
    obstacles :
        The obstacles as stated.
    links :
        The links of the robot.
    pose_of :
        Returns the pose of a frame, or None.
    """
    frames = {obstacle.frame for obstacle in obstacles} - {""} - set(links)
    return {frame: pose_of(frame) for frame in sorted(frames)}


def is_same(one: Poses, other: Poses) -> bool:
    """Whether the same frames have the same poses, except for noise."""
    return one.keys() == other.keys() and all(
        a is b or (a is not None and b is not None and bool(np.abs(a - b).max() <= _MOVED))
        for a, b in ((pose, other[frame]) for frame, pose in one.items())
    )


def placed(obstacles: Iterable[Obstacle], poses: Poses) -> tuple[list[Obstacle], list[str]]:
    """Place obstacles in the base frame, and name those whose frame has no pose.

    Parameters
    ----------
    obstacles :
        The obstacles as stated.
    poses :
        Poses of the frames that are not links.

    Returns
    -------
    obstacles, unplaced :
        The obstacles on links and in the base frame, and why others are missing.
    """
    found, unplaced = list[Obstacle](), list[str]()
    for obstacle in obstacles:
        if obstacle.frame not in poses:
            found.append(obstacle)
        elif (pose := poses[obstacle.frame]) is None:
            unplaced.append(
                f"obstacle '{obstacle.name}' is stated in the frame '{obstacle.frame}', which is "
                "not a link of the robot and has no known pose: set the parameter 'fixed_frames' "
                "(FRAME: X Y Z), or publish its transform to tf2"
            )
        else:
            shapes = [shape.moved(pose) for shape in obstacle.shapes]
            found.append(Obstacle(obstacle.name, shapes, "", obstacle.touch_links))
    return found, unplaced
