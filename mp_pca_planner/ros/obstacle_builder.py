# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles with meshes, which are made in a thread of their own."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from visualization_msgs.msg import Marker

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable
from ..input_limits import INPUT_LIMITS
from ..robot.mesh_files import find_mesh, scaled
from ..robot.mesh_formats import MeshContent
from ..robot.shapes import Box, Cylinder, Mesh, Shape, Sphere
from ..robot.solids import solids_of
from ..robot.world import Obstacle
from .marker_bytes import MarkerData

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"
MANY_POINTS = 3000
"""Points of a mesh from which on its obstacle is made in the thread."""


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


def is_slow(marker: MarkerData) -> bool:
    """Whether a marker has a mesh that takes long to read or to use."""
    is_large = marker.type == Marker.TRIANGLE_LIST and len(marker.points) > MANY_POINTS
    return marker.type == Marker.MESH_RESOURCE or is_large


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


class ObstacleBuilder:
    """Makes the obstacles of markers with meshes in a thread, one after the other.

    The newest marker of a name counts: one that waits is replaced, one that is being made is
    finished, so that a marker that is sent again and again becomes an obstacle, too.

    Attributes
    ----------
    n_asked, n_fetched : int
        Markers that were given, without those that were replaced, and those that were fetched.
    """

    most = 1000
    """Largest number of names that wait."""

    def __init__(self) -> None:
        # By name, in the order in which they came; None ends the thread.
        self._waiting: dict[str, tuple[MarkerData, Sequence[Path]]] = {}
        self._names: SimpleQueue[str | None] = SimpleQueue()
        self._made: SimpleQueue[tuple[MarkerData, Obstacle | WorldError]] = SimpleQueue()
        self._meshes: dict[str, tuple[_Source, Mesh]] = {}
        self.n_asked = self.n_fetched = 0
        # A daemon: a file that is being read must not keep the process alive.
        threading.Thread(target=self._run, name="meshes", daemon=True).start()

    def begin(self, marker: MarkerData, folders: Sequence[Path]) -> None:
        """Make the obstacle of a marker.

        Raises
        ------
        WorldError
            If too many wait.
        """
        if marker.name not in self._waiting:
            if len(self._waiting) >= self.most:
                reason = f"more than {self.most} meshes wait to be read; send it again"
                raise rejection(marker, reason)
            self.n_asked += 1
            self._waiting[marker.name] = marker, folders
            self._names.put(marker.name)
        else:
            self._waiting[marker.name] = marker, folders

    def fetch(self) -> list[tuple[MarkerData, Obstacle | WorldError]]:
        """Return the markers that are finished, each with its obstacle or why there is none."""
        made = []
        while not self._made.empty():
            made.append(self._made.get())
        self.n_fetched += len(made)
        return made

    def close(self) -> None:
        """End the thread after the marker that is being made."""
        self._names.put(None)

    def _run(self) -> None:
        while (name := self._names.get()) is not None:
            marker, folders = self._waiting.pop(name)
            try:
                self._made.put((marker, self._make(marker, folders)))
            except Exception as error:
                self._made.put((marker, rejection(marker, error)))

    def _make(self, marker: MarkerData, folders: Sequence[Path]) -> Obstacle:
        found = _mesh_of(marker, folders, self._meshes.pop(marker.name, None))
        assert found is not None
        source, mesh = found
        if source is not None:
            self._meshes[marker.name] = source, mesh
            while len(self._meshes) > INPUT_LIMITS.kept_meshes:
                del self._meshes[next(iter(self._meshes))]
        with suppress(WorldError):
            solids_of(mesh)  # made here, and kept
        return _obstacle(marker, mesh)
