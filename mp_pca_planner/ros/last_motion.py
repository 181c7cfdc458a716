# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last: its preview, its cost, and its storage as a primitive."""

from __future__ import annotations

import math
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..execution.execution_monitor import NEVER_STARTED, REPLACED
from ..execution.parameters import ParameterError
from ..execution.served_goal import Served
from ..execution.trial_store import keep_motion
from ..motion.trajectory import Trajectory
from ..robot.model import Robot


class LastMotion:
    """The motion that was published last, its preview and its measured cost.

    Parameters
    ----------
    show : callable
        Publishes the markers of a preview.

    Attributes
    ----------
    cost : float or None
        The measured cost; None if none was reported.
    """

    def __init__(self, show: Callable[[MarkerArray], None]) -> None:
        self.cost: float | None = None
        self._show = show
        self._served: Served | None = None
        self._previewed: Served | None = None
        self._is_over, self._is_shown = True, False
        self._lock = threading.Lock()

    def replace(self, served: Served) -> None:
        """Record a published motion."""
        self._served, self.cost, self._is_over = served, None, False

    def end(self, outcome: str) -> None:
        """Record that a motion is over; its preview is erased if the robot has left its start."""
        if outcome != REPLACED:
            self._is_over = True
            if outcome != NEVER_STARTED:
                self.erase_preview()

    @property
    def facts(self) -> dict[str, str | float]:
        """The measured cost, for the diagnostics."""
        return {"trial_cost": "none" if self.cost is None else self.cost}

    def report_cost(self, cost: float) -> None:
        """Record the measured cost, and learn from it if the motion is a trial.

        Raises
        ------
        GoalError
            If the cost is not finite, or no motion was published.
        """
        served = self._served
        if served is None or not math.isfinite(cost):
            raise GoalError(
                f"the cost {cost} of a trial is ignored: it must be a finite number that follows "
                "a motion"
            )
        if served.trial is not None:
            served.trial.record(cost)
        self.cost = cost

    def show_preview(self) -> None:
        """Show the motion, if it was not shown before."""
        with self._lock:
            served = self._served
            if served is None or served is self._previewed:
                return
            self._previewed, self._is_shown = served, True
            context = served.model
            robot, frame = context.planning_robot, context.end_effector
            self._show(to_preview(served.plan.trajectory, robot, frame, context.urdf))

    def erase_preview(self) -> None:
        """Erase the preview, unless its motion is being executed."""
        with self._lock:
            if self._is_over:
                self._previewed = self._served
                if self._is_shown:
                    self._show(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
                self._is_shown = False

    def keep(self, folder: str, kept_by: str) -> Path:
        """Write the motion as a primitive; returns the file.

        Raises
        ------
        PlannerError
            If there is no folder or no motion, or the motion can't be saved.
        """
        if not folder:
            raise ParameterError(
                "motions can't be saved: set the parameter 'save_folder' to a folder"
            )
        if self._served is None:
            raise GoalError("there is no motion to save: none was published")
        cost = {} if self.cost is None else {"trial_cost": self.cost}
        return keep_motion(self._served, Path(folder), {"kept_by": kept_by, **cost})


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


@dataclass(frozen=True, eq=False)
class VisualShape:
    """A visual shape of a link.

    Attributes
    ----------
    link : str
        The link.
    origin : tuple of float
        Its place on the link: x, y, z [m], roll, pitch, yaw [rad].
    kind : int
        Type of its marker.
    scale : tuple of float
        Scale of its marker [m], or that of its mesh.
    mesh : str
        URI of its mesh; empty for other shapes.
    """

    link: str
    origin: tuple[float, ...]
    kind: int
    scale: tuple[float, ...]
    mesh: str = ""


def visual_shapes(urdf: str) -> list[VisualShape]:
    """The visual shapes in a robot description; those that are malformed are left out."""
    shapes: list[VisualShape] = []
    for link in ET.fromstring(urdf).findall("link"):
        for visual in link.findall("visual"):
            try:
                shapes += _shapes_of(link.get("name", ""), visual)
            except ValueError:
                continue
    return shapes


def ghost_markers(
    robot: Robot, shapes: list[VisualShape], q: FloatArray, colours: list[ColorRGBA]
) -> list[Marker]:
    """Markers of the shapes in configurations, without a frame.

    Parameters
    ----------
    robot : Robot
        The robot.
    shapes : list of VisualShape
        Shapes of its links; those of other links are left out.
    q : array, shape (n_poses, n_joints)
        The configurations [rad or m].
    colours : list of ColorRGBA
        A colour for each of them.
    """
    known = set(robot.frame_names)
    drawn = [shape for shape in shapes if shape.link in known]
    origins = np.reshape([shape.origin for shape in drawn], (-1, 6))
    poses = robot.attached_poses(q, [shape.link for shape in drawn], origins).tolist()
    markers: list[Marker] = []
    for row, colour in zip(poses, colours, strict=True):
        for shape, (x, y, z, *turn) in zip(drawn, row, strict=True):
            marker = Marker(ns="ghost_shapes", id=len(markers), type=shape.kind, color=colour)
            marker.scale = Vector3(x=shape.scale[0], y=shape.scale[1], z=shape.scale[2])
            marker.mesh_resource = shape.mesh
            orientation = Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])
            marker.pose = Pose(position=Point(x=x, y=y, z=z), orientation=orientation)
            markers.append(marker)
    return markers


def _shapes_of(link: str, visual: ET.Element) -> Iterator[VisualShape]:
    """The shape of a visual element, if its kind is known; `ValueError` if it is malformed."""
    origin, geometry = visual.find("origin"), visual.find("geometry")
    place = (*_numbers(origin, "xyz", "0 0 0"), *_numbers(origin, "rpy", "0 0 0"))
    for shape in [] if geometry is None else geometry:
        if shape.tag == "box":
            yield VisualShape(link, place, Marker.CUBE, _numbers(shape, "size"))
        elif shape.tag == "sphere":
            yield VisualShape(link, place, Marker.SPHERE, (_diameter(shape),) * 3)
        elif shape.tag == "cylinder":
            size = (_diameter(shape), _diameter(shape), _number(shape, "length"))
            yield VisualShape(link, place, Marker.CYLINDER, size)
        elif shape.tag == "mesh" and shape.get("filename"):
            name, scale = shape.get("filename", ""), _numbers(shape, "scale", "1 1 1")
            address = f"file://{name}" if name.startswith("/") else name
            yield VisualShape(link, place, Marker.MESH_RESOURCE, scale, address)


def _diameter(shape: ET.Element) -> float:
    return 2.0 * _number(shape, "radius")


def _number(element: ET.Element, name: str) -> float:
    value = float(element.get(name, ""))
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}")
    return value


def _numbers(element: ET.Element | None, name: str, default: str = "") -> tuple[float, ...]:
    text = default if element is None else element.get(name, default)
    values = tuple(map(float, text.split()))
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{name} is '{text}'")
    return values
