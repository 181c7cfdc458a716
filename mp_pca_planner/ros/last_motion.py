# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last: its preview, and its storage as a primitive."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from ..exceptions import GoalError, PlannerError, RobotError
from ..execution.serving.execution import MotionOutcome, Served
from ..execution.threads import TimedLock
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from ..robot.urdf import StatedShape, stated_shape

_LAST = ColorRGBA(r=0.1, g=0.8, b=0.3, a=0.6)


class LastMotion:
    """The motion that was published last, and its preview.

    Parameters
    ----------
    show : callable
        Publishes the markers of a preview.
    """

    def __init__(self, show: Callable[[MarkerArray], None]) -> None:
        self._show = show
        self._served: Served | None = None
        self._previewed: Served | None = None
        self._is_over, self._is_shown, self._must_erase = True, False, False
        self._lock = TimedLock()

    def replace(self, served: Served) -> None:
        """Record a published motion."""
        self._served, self._is_over, self._must_erase = served, False, False

    def end(self, outcome: MotionOutcome) -> None:
        """Record that a motion is over; :meth:`tidy` erases its preview if it was begun.

        This waits for no lock.
        """
        if outcome is not MotionOutcome.REPLACED:
            self._must_erase, self._is_over = outcome is not MotionOutcome.NEVER_STARTED, True

    def tidy(self) -> None:
        """Erase the preview of a motion that is over."""
        if self._must_erase:
            self._must_erase = False
            self.erase_preview()

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
            raise PlannerError(
                "motions can't be saved: set the parameter 'save_folder' to a folder"
            )
        # Imported late, because SciPy's optimisers are slow to import.
        from ..execution.serving.kept_motion import keep_motion

        if self._served is None:
            raise GoalError("there is no motion to save: none was published")
        return keep_motion(self._served, Path(folder), {"kept_by": kept_by})


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
    for k, ((*_, kind, scale, mesh), (x, y, z, *turn)) in enumerate(zip(drawn, poses, strict=True)):
        marker = Marker(ns="last_pose", id=k, type=kind, color=_LAST)
        marker.scale = Vector3(x=scale[0], y=scale[1], z=scale[2])
        marker.mesh_resource = mesh
        orientation = Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])
        marker.pose = Pose(position=Point(x=x, y=y, z=z), orientation=orientation)
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
