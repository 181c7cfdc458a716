# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A motion as markers for RViz: the way of the end effector, and ghosts of the arm on it."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.model import Robot

_N_PATH_POINTS = 60
_N_GHOSTS = 6
_PATH_WIDTH, _GHOST_WIDTH = 0.005, 0.01  # [m]
_PATH_COLOUR = (0.1, 0.5, 1.0, 1.0)
_FIRST_GHOST, _LAST_GHOST = (1.0, 0.6, 0.1), (0.1, 0.8, 0.3)
_GHOST_OPACITY = 0.6


def link_pairs(urdf: str) -> tuple[str, list[tuple[str, str]]]:
    """The base link of a robot description, and parent and child link of each joint."""
    root = ET.fromstring(urdf)
    pairs = []
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            pairs.append((parent.get("link", ""), child.get("link", "")))
    children = {child for _, child in pairs}
    base = next(
        link.get("name", "") for link in root.findall("link") if link.get("name") not in children
    )
    return base, pairs


def to_preview(trajectory: Trajectory, robot: Robot, end_effector: str, urdf: str) -> MarkerArray:
    """Draw a motion in the frame of the robot's base link.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    robot : Robot
        Has its joints, in their order.
    end_effector : str
        The link whose way is drawn.
    urdf : str
        The description of the robot, whose links are joined by lines.
    """
    base, pairs = link_pairs(urdf)
    points = robot.frame_positions(_spread(trajectory, _N_PATH_POINTS), [end_effector])
    path = _marker(base, "path", 0, Marker.LINE_STRIP, _PATH_WIDTH, _PATH_COLOUR, points[:, 0])
    known = set(robot.frame_names)
    drawn = [pair for pair in pairs if known.issuperset(pair)]
    ends = [link for pair in drawn for link in pair]
    poses = robot.frame_positions(_spread(trajectory, _N_GHOSTS), ends)
    ghosts = []
    for k, pose in enumerate(poses):
        share = k / (_N_GHOSTS - 1)
        colour = (1.0 - share) * np.array(_FIRST_GHOST) + share * np.array(_LAST_GHOST)
        rgba = (*colour.tolist(), _GHOST_OPACITY)
        ghosts.append(_marker(base, "ghosts", k, Marker.LINE_LIST, _GHOST_WIDTH, rgba, pose))
    return MarkerArray(markers=[path, *ghosts])


def _spread(trajectory: Trajectory, n: int) -> FloatArray:
    """Positions at evenly spaced times, shape (n, n_joints)."""
    times = np.linspace(0.0, trajectory.duration, n)
    return np.column_stack([np.interp(times, trajectory.times, q) for q in trajectory.positions.T])


def _marker(
    frame: str,
    namespace: str,
    number: int,
    kind: int,
    width: float,
    colour: tuple[float, ...],
    points: FloatArray,
) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
    # Without a stamp it is drawn where the frame is now.
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x = width
    r, g, b, a = colour
    marker.color = ColorRGBA(r=r, g=g, b=b, a=a)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    return marker
