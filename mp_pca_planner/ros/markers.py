# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages: read, kept, and placed around the robot.

A worker does so, because meshes take long to read, and their libraries may end a process.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import PlannerError, WorldError, printable
from ..execution.link import WorldFacts
from ..execution.parameters import fixed_frames
from ..execution.planning import Model, WatchedModel, in_world
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..robot.meshes import MeshContent, find_mesh, package_folders, scaled
from ..robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World
from .messages import to_seconds

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"
_MAX_NAME = 500  # characters
_NOISE = 1e-4  # of the poses of frames [m]
_LEAST_BYTES = 200  # of a marker without names, points and images


def read_markers(content: bytes) -> list[Marker]:
    """The markers of a serialised visualization_msgs/MarkerArray.

    Raises
    ------
    WorldError
        If the message is malformed.
    """
    if len(content) > INPUT_LIMITS.marker_bytes:
        raise WorldError(
            f"the message of markers has {len(content)} bytes, at most "
            f"{INPUT_LIMITS.marker_bytes} are accepted"
        )
    # ROS makes room for all markers that are announced, before it reads them.
    n = int.from_bytes(content[4:8], "little")
    if n * _LEAST_BYTES > len(content):
        raise WorldError(f"the message of markers has {len(content)} bytes, too few for {n}")
    with reading("the message of markers", WorldError):
        return list(deserialize_message(content, MarkerArray).markers)


def _name(marker: Marker) -> str:
    """The name of the obstacle of a marker: its namespace, and its number unless that is 0."""
    if marker.id == 0 and re.fullmatch("(?!marker )[^/]+", marker.ns):  # names stay unique
        return str(marker.ns)
    return f"{marker.ns}/{marker.id}" if marker.ns else f"marker {marker.id}"


def to_obstacle(marker: Marker, folders: Sequence[Path] = ()) -> Obstacle:
    """The obstacle of a marker that is added or modified.

    Parameters
    ----------
    marker : Marker
        The marker.
    folders : sequence of Path
        Folders of packages, for meshes.

    Raises
    ------
    WorldError
        If its type is not supported, or its numbers can't be used.
    """
    try:
        shapes = _shapes(marker, folders)
    except WorldError as error:
        raise rejection(marker, error) from None
    p, o = marker.pose.position, marker.pose.orientation
    pose = np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
    frame = marker.header.frame_id.lstrip("/")
    return Obstacle(_name(marker), [one.moved(pose) for one in shapes], frame)


def rejection(marker: Marker, reason: object) -> WorldError:
    """The error that names a marker."""
    return WorldError(f"marker '{printable(_name(marker))}': {reason}")


@lru_cache(maxsize=INPUT_LIMITS.kept_meshes)
def _scaled(content: MeshContent, scale: tuple[float, ...]) -> Mesh:
    """The mesh of a file, kept because markers are published again and again."""
    return Mesh(scaled(content.vertices, np.array(scale)), content.triangles)


def _shapes(marker: Marker, folders: Sequence[Path]) -> Sequence[Shape]:
    """The shapes in the frame of the marker's pose."""
    s, kind = marker.scale, marker.type
    scale = frozen_array([s.x, s.y, s.z], (3,), "scale", WorldError)
    if kind == Marker.MESH_RESOURCE:
        return [_scaled(find_mesh(marker.mesh_resource, folders), tuple(scale.tolist()))]
    if kind == Marker.CUBE:
        return [Box(scale)]
    if kind == Marker.SPHERE:
        return [Sphere(0.5 * _diameter(scale, "a sphere"))]
    if kind == Marker.CYLINDER:
        return [Cylinder(0.5 * _diameter(scale[:2], "a cylinder"), scale[2])]
    if kind == Marker.TRIANGLE_LIST:
        points = _points(marker, 3 * INPUT_LIMITS.triangles)
        if len(points) % 3:
            text = f"a TRIANGLE_LIST has 3 points per triangle, got {len(points)} points"
            raise WorldError(text)
        return [Mesh(scaled(points, scale), np.arange(len(points)).reshape(-1, 3))]
    points = _points(marker, INPUT_LIMITS.shapes)
    if kind == Marker.CUBE_LIST:
        return [Box(scale, point) for point in points]
    if kind == Marker.SPHERE_LIST:
        radius = 0.5 * _diameter(scale, "a sphere")
        return [Sphere(radius, point) for point in points]
    raise WorldError(f"type {kind} is not supported; accepted are {_ACCEPTED}")


def _points(marker: Marker, most: int) -> FloatArray:
    if len(marker.points) > most:
        raise WorldError(f"it has {len(marker.points)} points, at most {most} are accepted")
    return np.reshape([(p.x, p.y, p.z) for p in marker.points], (-1, 3))


def _diameter(scale: FloatArray, what: str) -> float:
    if np.ptp(scale) > 1e-6 * np.abs(scale).max():
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"the diameters of {what} must be equal, got {numbers}")
    return float(scale[0])


@dataclass(frozen=True, eq=False)
class Markers:
    """A message of markers, as it is sent to a worker.

    Attributes
    ----------
    content : bytes
        The serialised message.
    stamp : int
        When it was sent [ns].
    is_late : bool
        Whether it may be older than others, because it was latched.
    """

    content: bytes
    stamp: int
    is_late: bool


@dataclass(frozen=True, eq=False)
class Frames:
    """Poses of frames in the base frame, shape (7,) each; None where it is unknown."""

    poses: Mapping[str, FloatArray | None]


class Obstacles:
    """The obstacles that markers state, and the world that they make around the robot.

    Attributes
    ----------
    world : World
        The obstacles in the base frame; another object after each change.
    unplaced, missing : str
        Why it is unknown where an obstacle is, and why one is not avoided; empty if all are.
    model : Model, WatchedModel or None
        The robot around which they are placed.
    """

    most = 400
    """Largest numbers of remembered messages, of rejections, and of names that were deleted."""

    def __init__(self) -> None:
        self.world, self.unplaced, self.missing = World(), "", ""
        self._stated: dict[str, Obstacle] = {}
        self._rejected: dict[str, str] = {}
        # The latest messages, because a message may arrive on several subscriptions.
        self._seen: deque[int] = deque(maxlen=self.most)
        # Source time of the last change of each obstacle, and of all of them [ns]; the latest last.
        self._changed: dict[str, int] = {}
        self._cleared = 0
        # When lifetimes end, by a clock that is never set back [s].
        self._ends: dict[str, float] = {}
        self._poses: dict[str, FloatArray] = {}
        self.model: Model | WatchedModel | None = None
        self._lost = ""

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "model": None}

    def apply(self, message: Markers) -> None:
        """Apply a message; a marker that can't be used changes nothing."""
        if message.stamp and message.stamp in self._seen:
            return
        self._seen.append(message.stamp)
        self._lost = ""
        try:
            markers = read_markers(message.content)
        except WorldError as error:
            self._rejected["a message"] = str(error)
            self._place()
            return
        self._rejected.pop("a message", None)
        before = dict(self._stated)
        for marker in markers:
            # A latched message may come after a newer one.
            last = max(self._changed.get(_name(marker), 0), self._cleared)
            if message.is_late and message.stamp < last:
                continue
            try:
                self._apply_marker(marker)
            except WorldError as error:
                if len(self._rejected) < self.most:
                    self._rejected[_name(marker)[:_MAX_NAME]] = str(error)
                continue
            for cleared in [name for name in self._rejected if _concerns(marker, name)]:
                del self._rejected[cleared]
            self._note_change(marker, message.stamp)
        deleted = [name for name in self._changed if name not in self._stated]
        for name in deleted[: max(len(deleted) - self.most, 0)]:
            del self._changed[name]
        if not self._place():
            self._stated = before

    def lose(self, reason: str) -> None:
        """Note that obstacles are unknown, until markers come."""
        self._lost = reason
        self._place()

    def use(self, model: Model | WatchedModel | None) -> None:
        """Place the obstacles around another robot."""
        if model is not self.model:
            self.model = model
            self._place()

    def use_frames(self, frames: Frames) -> None:
        """Place the obstacles by other poses of frames, unless these differ by noise alone."""
        known = {name: pose for name, pose in frames.poses.items() if pose is not None}
        same = (
            np.allclose(pose, self._poses.get(name, np.nan), 0.0, _NOISE)
            for name, pose in known.items()
        )
        if known.keys() != self._poses.keys() or not all(same):
            self._poses = known
            self._place()

    def refresh(self) -> bool:
        """Drop the obstacles whose lifetime is over; returns whether there are any."""
        now = time.monotonic()
        over = [name for name, end in self._ends.items() if end <= now]
        for name in over:
            del self._ends[name]
            self._stated.pop(name, None)
        if over:
            self._place()
        return bool(over)

    @property
    def facts(self) -> WorldFacts:
        """What the node needs to know."""
        n = len(self._stated if self.model is None else self.world)
        return WorldFacts(n, self.missing, self._foreign())

    def _foreign(self) -> tuple[str, ...]:
        """Frames of obstacles that are neither links nor fixed."""
        if self.model is None:
            return ()
        known = {"", *self.model.robot.frame_names}
        known |= fixed_frames(self.model.settings.fixed_frames).keys()
        return tuple(sorted({one.frame for one in self._stated.values()} - known))

    def _place(self) -> bool:
        """Make the world of the obstacles as they are stated; false if that is impossible."""
        model, problems = self.model, list(self._rejected.values())
        if model is None:
            return True
        fixed = fixed_frames(model.settings.fixed_frames)
        poses: dict[str, Any] = {**self._poses, **fixed}
        placed, unplaced = list[Obstacle](), list[str]()
        for obstacle in self._stated.values():
            frame = obstacle.frame
            if frame == "" or frame in model.robot.frame_names:
                placed.append(obstacle)
            elif (pose := poses.get(frame)) is not None:
                shapes = [shape.moved(np.asarray(pose)) for shape in obstacle.shapes]
                placed.append(Obstacle(obstacle.name, shapes, "", obstacle.touch_links))
            else:
                unplaced.append(
                    f"obstacle '{obstacle.name}' is stated in the frame '{frame}', which is not a "
                    "link of the robot and has no known pose: set the parameter 'fixed_frames' "
                    "(FRAME: X Y Z), or publish its transform to tf2"
                )
        is_possible = True
        try:
            world = World(placed)
            if len(world):
                in_world(model, world)
            self.world = world
        except WorldError as error:
            problems.append(str(error))
            is_possible = False
        except PlannerError as error:  # the robot can't avoid any: goals are rejected
            problems.append(str(error))
            self.world = world
        unplaced = [self._lost, *unplaced] if self._lost else unplaced
        self.unplaced = printable(unplaced[0][:1000]) if unplaced else ""
        missing = [*problems, *unplaced]
        self.missing = printable(missing[0][:1000]) if missing else ""
        return is_possible

    def _note_change(self, marker: Marker, stamp: int) -> None:
        if marker.action == Marker.DELETEALL:
            if not marker.ns:
                self._cleared = stamp
            return
        name, lifetime = _name(marker), to_seconds(marker.lifetime)
        self._changed.pop(name, None)
        self._changed[name] = stamp
        self._ends.pop(name, None)
        if marker.action == Marker.ADD and lifetime > 0.0:
            self._ends[name] = time.monotonic() + lifetime

    def _apply_marker(self, marker: Marker) -> None:
        name = _name(marker)
        if len(name) > _MAX_NAME:
            raise WorldError(
                f"a marker's name has {len(name)} characters, at most {_MAX_NAME} are used"
            )
        if marker.action == Marker.ADD:
            folders: Sequence[Path] = ()
            if self.model is not None:
                folders = package_folders(self.model.settings.package_folders)
            self._stated[name] = to_obstacle(marker, folders)
        elif marker.action in (Marker.DELETE, Marker.DELETEALL):
            for other in [other for other in self._stated if _concerns(marker, other)]:
                del self._stated[other]
        else:
            raise rejection(
                marker,
                f"its action is {marker.action}; accepted are 0 (add or modify), 2 (delete) and 3 "
                "(delete all)",
            )


def _concerns(marker: Marker, name: str) -> bool:
    """Whether a marker changes or deletes the obstacle of a name."""
    if marker.action != Marker.DELETEALL:
        return name == _name(marker)
    return name == marker.ns or name.startswith(f"{marker.ns}/" if marker.ns else "")
