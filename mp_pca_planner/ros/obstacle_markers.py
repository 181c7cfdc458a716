# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable, unknown_name
from ..input_limits import INPUT_LIMITS
from ..robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World
from ..robot.world_meshes import read_mesh
from .marker_bytes import MarkerData

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"

MeshData = tuple[FloatArray, NDArray[np.intp]]


def to_obstacle(marker: MarkerData, mesh: MeshData | None = None) -> Obstacle:
    """The obstacle of a marker that is added or modified.

    Parameters
    ----------
    marker :
        The marker.
    mesh :
        Vertices and triangles of its mesh file.

    Raises
    ------
    WorldError
        If its type is not supported, or its numbers can't be used.
    """
    try:
        shapes = [shape.moved(marker.pose) for shape in _shapes(marker, mesh)]
        return Obstacle(marker.name, shapes, marker.frame_id)
    except WorldError as error:
        raise _rejection(marker, error) from None


def _rejection(marker: MarkerData, reason: object) -> WorldError:
    return WorldError(f"marker '{printable(marker.name)}': {reason}")


def _shapes(marker: MarkerData, mesh: MeshData | None) -> list[Shape]:
    """The shapes in the frame of the marker's pose."""
    scale, kind = frozen_array(marker.scale, (3,), "scale", WorldError), marker.type
    if kind == Marker.CUBE:
        return [Box(scale)]
    if kind == Marker.SPHERE:
        return [Sphere(0.5 * _diameter(scale, "a sphere"))]
    if kind == Marker.CYLINDER:
        return [Cylinder(0.5 * _diameter(scale[:2], "a cylinder"), scale[2])]
    if kind == Marker.MESH_RESOURCE and mesh is not None:
        vertices, triangles = mesh
        return [Mesh(vertices * scale, triangles)]
    points = _points(marker)
    if kind == Marker.TRIANGLE_LIST:
        if len(points) % 3:
            raise WorldError(f"a TRIANGLE_LIST has 3 points per triangle, got {len(points)} points")
        return [Mesh(points * scale, np.arange(len(points)).reshape(-1, 3))]
    if kind == Marker.CUBE_LIST:
        return [Box(scale, point) for point in points]
    if kind == Marker.SPHERE_LIST:
        radius = 0.5 * _diameter(scale, "a sphere")
        return [Sphere(radius, point) for point in points]
    raise WorldError(f"type {kind} is not supported; accepted are {_ACCEPTED}")


def _points(marker: MarkerData) -> FloatArray:
    limits, is_mesh = INPUT_LIMITS, marker.type == Marker.TRIANGLE_LIST
    most = 3 * limits.triangles if is_mesh else limits.shapes
    if len(marker.points) > most:
        raise WorldError(f"it has {len(marker.points)} points, at most {most} are accepted")
    return marker.points


def _diameter(scale: Any, what: str) -> float:
    if np.ptp(scale) > 1e-6 * np.abs(scale).max():
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"the diameters of {what} must be equal, got {numbers}")
    return float(scale[0])


class MeshReads:
    """Mesh files that are being read, by threads that only wait for the process that reads."""

    most = 100
    """Largest number of files that are read or wait."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(2, "meshes")
        self._reads: dict[str, Future[MeshData]] = {}

    def begin(self, resource: str, folders: Sequence[Path]) -> Future[MeshData]:
        """Read a file, unless it is being read just now.

        Raises
        ------
        WorldError
            If too many files are being read.
        """
        self._reads = {name: read for name, read in self._reads.items() if not read.done()}
        if resource not in self._reads:
            if len(self._reads) >= self.most:
                raise WorldError(f"more than {self.most} meshes are being read; send it again")
            self._reads[resource] = self._threads.submit(read_mesh, resource, folders)
        return self._reads[resource]

    def close(self) -> None:
        """Read no further file."""
        self._threads.shutdown(wait=False, cancel_futures=True)


class MarkerMessages:
    """Applies messages of markers to a world, each once.

    Obstacles with a mesh file appear when it has been read, and those with a lifetime vanish: call
    :meth:`refresh` again and again.

    Attributes
    ----------
    rejected : dict
        Why the last marker of a name can't be used, by the names of such markers.
    """

    most = 400
    """Largest numbers of remembered messages, and of remembered rejections."""

    most_names = 10_000
    """Largest number of remembered names."""

    def __init__(self) -> None:
        self.rejected: dict[str, str] = {}
        # The latest messages, because a message may arrive on several subscriptions.
        self._seen: deque[int] = deque(maxlen=self.most)
        # Source time of the last change of each obstacle, and of all of them [ns].
        self._changed: dict[str, int] = {}
        self._cleared = 0
        self._ends: dict[str, float] = {}
        self._meshes = MeshReads()
        self._waiting: dict[str, tuple[MarkerData, Future[MeshData]]] = {}

    @property
    def is_waiting(self) -> bool:
        """Whether obstacles are still missing because their meshes are being read."""
        return bool(self._waiting)

    def close(self) -> None:
        """Read no further mesh."""
        self._meshes.close()

    def apply(
        self,
        world: World,
        markers: Sequence[MarkerData],
        stamp: int,
        *,
        is_late: bool,
        links: Collection[str] | None,
        folders: Sequence[Path],
        now: float,
    ) -> tuple[list[Obstacle], list[str]] | None:
        """Apply a message; a marker that can't be used changes nothing.

        Parameters
        ----------
        world :
            The obstacles before.
        markers :
            The markers of the message.
        stamp :
            Its source time [ns].
        is_late :
            Whether it may be older than others, because it was latched.
        links :
            Links of the robot that obstacles may be attached to; any by default.
        folders :
            Folders of packages, for meshes.
        now :
            The time that lifetimes are counted from [s].

        Returns
        -------
        obstacles, problems :
            The obstacles after, and why markers were rejected; None if the message came before.
        """
        if stamp and stamp in self._seen:
            return None
        self._seen.append(stamp)
        obstacles, problems = {one.name: one for one in world}, list[str]()
        for marker in markers:
            # A latched message may come after a newer one.
            if is_late and stamp < max(self._changed.get(marker.name, 0), self._cleared):
                continue
            try:
                self._apply_marker(marker, obstacles, links, folders)
            except WorldError as error:
                problems.append(self._reject(marker, error))
                continue
            for cleared in [x for x in self.rejected if _concerns(marker, x)]:
                del self.rejected[cleared]
            self._note_change(marker, stamp, now)
        return list(obstacles.values()), problems

    def refresh(self, world: World, now: float) -> tuple[list[Obstacle], list[str]] | None:
        """Add the obstacles whose meshes have been read, and drop those whose lifetime is over.

        Returns
        -------
        obstacles, problems :
            See :meth:`apply`; None if nothing has changed.
        """
        over = [name for name, end in self._ends.items() if end <= now]
        read = [name for name, (_, mesh) in self._waiting.items() if mesh.done()]
        if not (over or read):
            return None
        obstacles, problems = {one.name: one for one in world}, list[str]()
        for name in read:
            marker, mesh = self._waiting.pop(name)
            try:
                obstacles[name] = to_obstacle(marker, mesh.result())
            except Exception as error:  # whatever a reader of files raises
                problems.append(self._reject(marker, error))
        for name in over:
            del self._ends[name]
            self._waiting.pop(name, None)
            obstacles.pop(name, None)
        return list(obstacles.values()), problems

    def _reject(self, marker: MarkerData, error: Exception) -> str:
        text = str(error)
        if not text.startswith("marker "):
            text = str(_rejection(marker, text))
        if len(self.rejected) < self.most:
            self.rejected[marker.name] = text
        return text

    def _note_change(self, marker: MarkerData, stamp: int, now: float) -> None:
        if marker.action == Marker.DELETEALL:
            if not marker.ns:
                self._cleared = stamp
            return
        # The latest at the end; the oldest are forgotten.
        self._changed.pop(marker.name, None)
        self._changed[marker.name] = stamp
        if len(self._changed) > self.most_names:
            del self._changed[next(iter(self._changed))]
        self._ends.pop(marker.name, None)
        if marker.action == Marker.ADD and marker.lifetime > 0.0:
            self._ends[marker.name] = now + marker.lifetime

    def _apply_marker(
        self,
        marker: MarkerData,
        obstacles: dict[str, Obstacle],
        links: Collection[str] | None,
        folders: Sequence[Path],
    ) -> None:
        name, frame = marker.name, marker.frame_id
        if marker.action == Marker.ADD:
            if frame and links is not None and frame not in links:
                raise _rejection(marker, unknown_name("link", frame, links))
            if marker.type == Marker.MESH_RESOURCE:
                self._waiting[name] = marker, self._meshes.begin(marker.mesh_resource, folders)
            else:
                obstacles[name] = to_obstacle(marker)
                self._waiting.pop(name, None)
        elif marker.action in (Marker.DELETE, Marker.DELETEALL):
            for one in (obstacles, self._waiting):
                for other in [other for other in one if _concerns(marker, other)]:
                    del one[other]  # type: ignore[attr-defined]
        else:
            raise _rejection(
                marker,
                f"its action is {marker.action}; accepted are 0 (add or modify), 2 (delete) and 3 "
                "(delete all)",
            )


def _concerns(marker: MarkerData, name: str) -> bool:
    """Whether a marker changes or deletes the obstacle of a name."""
    if marker.action != Marker.DELETEALL:
        return name == marker.name
    return name.startswith(f"{marker.ns}/" if marker.ns else "")
