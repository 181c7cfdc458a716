# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The preview of a motion in RViz: its path, and the robot at its end."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from contextlib import suppress

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from ..robot.urdf import StatedShape, stated_shape
from .messages import to_pose

_LAST = ColorRGBA(r=0.1, g=0.8, b=0.3, a=0.6)


def to_preview(trajectory: Trajectory, robot: Robot, end_effector: str, urdf: str) -> MarkerArray:
    """Draw a motion in the frame of the robot's base link.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    robot : Robot
        A robot with the same joints in the same order.
    end_effector : str
        The link whose path is drawn.
    urdf : str
        The description of the robot, whose visual shapes are drawn in the last pose.
    """
    times = np.linspace(0.0, trajectory.duration, 60)
    q = [np.interp(times, trajectory.times, joint) for joint in trajectory.positions.T]
    path = Marker(ns="path", type=Marker.LINE_STRIP, color=ColorRGBA(r=0.1, g=0.5, b=1.0, a=1.0))
    points = robot.frame_positions(np.column_stack(q), [end_effector])[:, 0]
    path.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    path.scale.x, path.pose.orientation.w = 0.005, 1.0
    markers = [path, *shape_markers(robot, urdf, trajectory.positions[-1])]
    for marker in markers:
        # Without a stamp it is drawn where the frame is now.
        marker.header.frame_id = robot.frame_names[0]
    return MarkerArray(markers=markers)


def shape_markers(robot: Robot, urdf: str, q: FloatArray) -> list[Marker]:
    """Markers of the visual shapes of a robot in a configuration, shape (n_joints,).

    Shapes that are malformed, or on links that the robot does not have, are left out.
    """
    drawn = []
    for link in ET.fromstring(urdf).findall("link"):
        name = link.get("name", "")
        for visual in link.findall("visual") if name in robot.frame_names else ():
            with suppress(RobotError):
                shape = stated_shape(visual)
                drawn += [(name, shape.origin, *marker) for marker in _markers_of(shape)]
    origins = np.reshape([origin for _, origin, *_ in drawn], (-1, 6))
    (poses,) = robot.attached_poses(q[None], [name for name, *_ in drawn], origins).tolist()
    markers = []
    for k, ((*_, kind, scale, mesh), pose) in enumerate(zip(drawn, poses, strict=True)):
        marker = Marker(ns="last_pose", id=k, type=kind, color=_LAST)
        marker.scale = Vector3(x=scale[0], y=scale[1], z=scale[2])
        marker.mesh_resource = mesh
        marker.pose = to_pose(pose)
        markers.append(marker)
    return markers


def _markers_of(shape: StatedShape) -> list[tuple[int, FloatArray, str]]:
    """Kind of marker, scale [m] and mesh of a shape; none if a marker can't show it."""
    sizes, name = shape.sizes, shape.file
    if shape.kind == "box":
        return [(Marker.CUBE, sizes, "")]
    if shape.kind == "sphere":
        return [(Marker.SPHERE, np.repeat(2.0 * sizes, 3), "")]
    if shape.kind == "cylinder":
        return [(Marker.CYLINDER, np.array([2.0, 2.0, 1.0]) * sizes[[0, 0, 1]], "")]
    if shape.kind != "mesh" or not name:
        return []
    return [(Marker.MESH_RESOURCE, sizes, f"file://{name}" if name.startswith("/") else name)]
