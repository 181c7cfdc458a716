# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A motion as markers for RViz: the path of the end effector, and poses of the robot along it."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from .ghosts import ghost_markers, visual_shapes


def link_pairs(urdf: str) -> tuple[str, list[tuple[str, str]]]:
    """Return the base link of a robot description, and parent and child link of each joint."""
    root = ET.fromstring(urdf)
    pairs = []
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            pairs.append((parent.get("link", ""), child.get("link", "")))
    children = {child for _, child in pairs}
    links = (link.get("name", "") for link in root.findall("link"))
    return next(name for name in links if name not in children), pairs


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
        The description of the robot; lines join its links, and its visual shapes are drawn.
    """
    base, pairs = link_pairs(urdf)
    points = robot.frame_positions(_spread(trajectory, 60), [end_effector])
    blue = ColorRGBA(r=0.1, g=0.5, b=1.0, a=1.0)
    path = Marker(ns="path", type=Marker.LINE_STRIP, color=blue)
    path.scale.x, path.points = 0.005, _points(points[:, 0])
    markers = [path]
    known = set(robot.frame_names)
    ends = [link for pair in pairs if known.issuperset(pair) for link in pair]
    shown = _spread(trajectory, 6)
    # From orange to green.
    colours = [
        ColorRGBA(r=r, g=g, b=b, a=0.6)
        for r, g, b in np.linspace([1.0, 0.6, 0.1], [0.1, 0.8, 0.3], len(shown)).tolist()
    ]
    for k, (pose, colour) in enumerate(
        zip(robot.frame_positions(shown, ends), colours, strict=True)
    ):
        ghost = Marker(ns="ghosts", id=k, type=Marker.LINE_LIST, color=colour)
        ghost.scale.x, ghost.points = 0.01, _points(pose)
        markers.append(ghost)
    for marker in markers:
        marker.pose.orientation.w = 1.0
    markers += ghost_markers(robot, visual_shapes(urdf), shown, colours)
    for marker in markers:
        # Without a stamp it is drawn where the frame is now.
        marker.header.frame_id = base
    return MarkerArray(markers=markers)


def _spread(trajectory: Trajectory, n: int) -> FloatArray:
    """Positions at evenly spaced times, shape (n, n_joints)."""
    times = np.linspace(0.0, trajectory.duration, n)
    return np.column_stack([np.interp(times, trajectory.times, q) for q in trajectory.positions.T])


def _points(positions: FloatArray) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in positions.tolist()]
