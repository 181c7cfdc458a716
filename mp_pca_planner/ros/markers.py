# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages: read, kept, and placed around the robot.

A worker does so, because meshes take long to read, and their libraries may end a process.
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from visualization_msgs.msg import Marker

from ..arrays import FloatArray, frozen_array
from ..exceptions import PlannerError, WorldError, printable
from ..execution.link import WorldFacts
from ..execution.parameters import fixed_frames
from ..execution.planning import Model, in_world
from ..input_limits import INPUT_LIMITS
from ..recordings.joint_states import ENCAPSULATION
from ..robot.meshes import MeshContent, find_mesh, package_folders, scaled
from ..robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"
_ORDERS = {b"\0\0": ">", b"\0\1": "<"}  # of bytes, by the start of a message in CDR
_BYTES = {kind: struct.calcsize(f"={kind}") for kind in "?iI"}
_MAX_NAME = 500  # characters


class CdrReader:
    """Reads one value after the other from a message in CDR.

    Whatever is malformed raises a `ValueError`.

    Parameters
    ----------
    content : bytes
        The message.
    """

    def __init__(self, content: bytes) -> None:
        if len(content) < ENCAPSULATION:
            raise ValueError(f"it has {len(content)} bytes, at least {ENCAPSULATION} are needed")
        if content[:2] not in _ORDERS:
            raise ValueError("it is not in plain CDR")
        self._content, self._order = content, _ORDERS[content[:2]]
        self._place = ENCAPSULATION

    def count(self, least_bytes: int) -> int:
        """The length of a sequence, whose items have this many bytes at least."""
        (n,) = self.numbers("I")
        if n * least_bytes > len(self._content) - self._place + least_bytes:
            raise ValueError(f"it is too short for {n} items")
        return int(n)

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Numbers of the same size, by their characters in `struct`."""
        size = _BYTES[kinds[0]]
        self._align(size)
        try:
            found = struct.unpack_from(self._order + kinds, self._content, self._place)
        except struct.error:
            raise ValueError(f"it ends within its {len(self._content)} bytes") from None
        self._place += size * len(kinds)
        return found

    def text(self) -> str:
        """A string."""
        n = self.count(1)
        begin, self._place = self._place, self._place + n
        return self._content[begin : self._place].rstrip(b"\0").decode()

    def array(self, kind: str, n: int) -> FloatArray:
        """Numbers of a type of NumPy."""
        if not n:
            return np.zeros(0)
        size = int(kind[1])
        self._align(size)
        numbers = np.frombuffer(self._content, self._order + kind, n, self._place)
        self._place += size * n
        return numbers.astype(float) if kind == "f8" else numbers

    def _align(self, size: int) -> None:
        self._place += (ENCAPSULATION - self._place) % size


@dataclass(frozen=True, eq=False)
class MarkerData:
    """The fields of a visualization_msgs/Marker that describe an obstacle.

    Attributes
    ----------
    frame_id, ns, id, type, action, mesh_resource
        As in the message.
    pose : array, shape (7,)
        Position [m] and quaternion (x, y, z, w).
    scale : array, shape (3,)
        Sizes [m], or factors.
    lifetime : float
        Time after which the marker is deleted [s]; 0: never.
    points : array, shape (n_points, 3)
        Points in the frame of the pose [m].
    """

    frame_id: str
    ns: str
    id: int
    type: int
    action: int
    pose: FloatArray
    scale: FloatArray
    lifetime: float
    points: FloatArray
    mesh_resource: str

    @property
    def name(self) -> str:
        """The name of its obstacle: its namespace and number."""
        return f"{self.ns}/{self.id}" if self.ns else f"marker {self.id}"


def read_markers(content: bytes) -> list[MarkerData]:
    """The markers of a serialised visualization_msgs/MarkerArray.

    Raises
    ------
    WorldError
        If the message is malformed.
    """
    try:
        reader = CdrReader(content)
        return [_marker(reader) for _ in range(reader.count(_LEAST_BYTES))]
    except ValueError as error:
        raise WorldError(f"the message of markers is malformed: {error}") from None


# Of a marker without names, points and images.
_LEAST_BYTES = 200


def _marker(reader: CdrReader) -> MarkerData:
    reader.numbers("iI")  # stamp
    frame, namespace = reader.text(), reader.text()
    number, kind, action = reader.numbers("iii")
    pose, scale = reader.array("f8", 7), reader.array("f8", 3)
    reader.array("f4", 4)  # colour
    seconds, nanoseconds = reader.numbers("iI")
    reader.numbers("?")  # frame_locked
    points = reader.array("f8", 3 * reader.count(24)).reshape(-1, 3)
    reader.array("f4", 4 * reader.count(16))  # colours
    reader.text()  # texture
    reader.numbers("iI")
    reader.text()
    reader.text()
    reader.array("u1", reader.count(1))
    reader.array("f4", 2 * reader.count(8))  # its coordinates
    reader.text()
    mesh = reader.text()
    reader.text()  # embedded mesh
    reader.array("u1", reader.count(1))
    reader.numbers("?")
    lifetime = seconds + 1e-9 * nanoseconds
    return MarkerData(frame, namespace, number, kind, action, pose, scale, lifetime, points, mesh)


def to_obstacle(marker: MarkerData, folders: Sequence[Path] = ()) -> Obstacle:
    """The obstacle of a marker that is added or modified.

    Parameters
    ----------
    marker : MarkerData
        The marker.
    folders : sequence of Path
        Folders of packages, for meshes.

    Raises
    ------
    WorldError
        If its type is not supported, or its numbers can't be used.
    """
    try:
        mesh = _mesh_of(marker, folders, None)
        return _obstacle(marker, None if mesh is None else mesh[1])
    except WorldError as error:
        raise rejection(marker, error) from None


def rejection(marker: MarkerData, reason: object) -> WorldError:
    """The error that names a marker."""
    return WorldError(f"marker '{printable(marker.name)}': {reason}")


_Source = tuple[MeshContent, bytes]


def _mesh_of(
    marker: MarkerData, folders: Sequence[Path], last: tuple[_Source, Mesh] | None
) -> tuple[_Source | None, Mesh] | None:
    """The mesh of a marker and its source; the last one if that is the same, None without mesh."""
    scale = frozen_array(marker.scale, (3,), "scale", WorldError)
    if marker.type == Marker.MESH_RESOURCE:
        found = find_mesh(marker.mesh_resource, folders)
        source = found, scale.tobytes()
        if last is not None and last[0][0] is found and last[0][1] == source[1]:
            return last
        return source, Mesh(scaled(found.vertices, scale), found.triangles)
    if marker.type != Marker.TRIANGLE_LIST:
        return None
    points = _points(marker, 3 * INPUT_LIMITS.triangles)
    if len(points) % 3:
        raise WorldError(f"a TRIANGLE_LIST has 3 points per triangle, got {len(points)} points")
    return None, Mesh(scaled(points, scale), np.arange(len(points)).reshape(-1, 3))


def _obstacle(marker: MarkerData, mesh: Mesh | None) -> Obstacle:
    shapes = [mesh] if mesh is not None else _shapes(marker)
    return Obstacle(
        marker.name, [one.moved(marker.pose) for one in shapes], marker.frame_id.lstrip("/")
    )


def _shapes(marker: MarkerData) -> list[Shape]:
    """The shapes in the frame of the marker's pose, without a mesh."""
    scale, kind = frozen_array(marker.scale, (3,), "scale", WorldError), marker.type
    if kind == Marker.CUBE:
        return [Box(scale)]
    if kind == Marker.SPHERE:
        return [Sphere(0.5 * _diameter(scale, "a sphere"))]
    if kind == Marker.CYLINDER:
        return [Cylinder(0.5 * _diameter(scale[:2], "a cylinder"), scale[2])]
    points = _points(marker, INPUT_LIMITS.shapes)
    if kind == Marker.CUBE_LIST:
        return [Box(scale, point) for point in points]
    if kind == Marker.SPHERE_LIST:
        radius = 0.5 * _diameter(scale, "a sphere")
        return [Sphere(radius, point) for point in points]
    raise WorldError(f"type {kind} is not supported; accepted are {_ACCEPTED}")


def _points(marker: MarkerData, most: int) -> FloatArray:
    if len(marker.points) > most:
        raise WorldError(f"it has {len(marker.points)} points, at most {most} are accepted")
    return marker.points


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
    now : float
        The time that lifetimes are counted from [s].
    """

    content: bytes
    stamp: int
    is_late: bool
    now: float


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
        self._meshes: dict[str, tuple[_Source, Mesh]] = {}
        self._poses: Mapping[str, FloatArray | None] = {}
        self._model: Model | None = None
        self._lost = ""

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_model": None}

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
            last = max(self._changed.get(marker.name, 0), self._cleared)
            if message.is_late and message.stamp < last:
                continue
            try:
                self._apply_marker(marker)
            except WorldError as error:
                if len(self._rejected) < self.most:
                    self._rejected[marker.name[:_MAX_NAME]] = str(error)
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

    def use(self, model: Model | None) -> None:
        """Place the obstacles around another robot."""
        if model is not self._model:
            self._model = model
            self._place()

    def use_frames(self, frames: Frames) -> None:
        """Place the obstacles by other poses of frames."""
        self._poses = frames.poses
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
        n = len(self._stated if self._model is None else self.world)
        return WorldFacts(n, self.missing, self._foreign())

    def _foreign(self) -> tuple[str, ...]:
        """Frames of obstacles that are neither links nor fixed."""
        if self._model is None:
            return ()
        known = {"", *self._model.robot.frame_names}
        known |= fixed_frames(self._model.settings.fixed_frames).keys()
        return tuple(sorted({one.frame for one in self._stated.values()} - known))

    def _place(self) -> bool:
        """Make the world of the obstacles as they are stated; false if that is impossible."""
        model, problems = self._model, list(self._rejected.values())
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

    def _note_change(self, marker: MarkerData, stamp: int) -> None:
        if marker.action == Marker.DELETEALL:
            if not marker.ns:
                self._cleared = stamp
            return
        self._changed.pop(marker.name, None)
        self._changed[marker.name] = stamp
        self._ends.pop(marker.name, None)
        if marker.action == Marker.ADD and marker.lifetime > 0.0:
            self._ends[marker.name] = time.monotonic() + marker.lifetime

    def _apply_marker(self, marker: MarkerData) -> None:
        name = marker.name
        if len(name) > _MAX_NAME:
            raise WorldError(
                f"a marker's name has {len(name)} characters, at most {_MAX_NAME} are used"
            )
        if marker.action == Marker.ADD:
            folders: Sequence[Path] = ()
            if self._model is not None:
                folders = package_folders(self._model.settings.package_folders)
            self._stated[name] = self._obstacle(marker, folders)
        elif marker.action in (Marker.DELETE, Marker.DELETEALL):
            for other in [other for other in self._stated if _concerns(marker, other)]:
                del self._stated[other]
        else:
            raise rejection(
                marker,
                f"its action is {marker.action}; accepted are 0 (add or modify), 2 (delete) and 3 "
                "(delete all)",
            )

    def _obstacle(self, marker: MarkerData, folders: Sequence[Path]) -> Obstacle:
        """The obstacle of a marker; a mesh that was read for it before is used again."""
        try:
            found = _mesh_of(marker, folders, self._meshes.pop(marker.name, None))
            if found is not None and found[0] is not None:
                self._meshes[marker.name] = found[0], found[1]
                while len(self._meshes) > INPUT_LIMITS.kept_meshes:
                    del self._meshes[next(iter(self._meshes))]
            return _obstacle(marker, None if found is None else found[1])
        except WorldError as error:
            raise rejection(marker, error) from None


def _concerns(marker: MarkerData, name: str) -> bool:
    """Whether a marker changes or deletes the obstacle of a name."""
    if marker.action != Marker.DELETEALL:
        return name == marker.name
    return name.startswith(f"{marker.ns}/" if marker.ns else "")
