# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable, unknown_name
from ..input_limits import INPUT_LIMITS
from ..robot.mesh_files import find_mesh, scaled
from ..robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"

_MAX_NAME = 500  # characters


def marker_name(marker: Marker) -> str:
    """The name of a marker's obstacle: its namespace and number."""
    return f"{marker.ns}/{marker.id}" if marker.ns else f"marker {marker.id}"


def to_obstacle(marker: Marker, package_dirs: Sequence[Path]) -> Obstacle:
    """The obstacle of a marker that is added or modified.

    Parameters
    ----------
    marker :
        The marker. Its colour, lifetime and stamp are not used.
    package_dirs :
        Folders of packages, for meshes.

    Raises
    ------
    WorldError
        If its type is not supported, or its numbers can't be used.
    """
    name = marker_name(marker)
    try:
        p, o = marker.pose.position, marker.pose.orientation
        pose = np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        shapes = [shape.moved(pose) for shape in _shapes(marker, package_dirs)]
        return Obstacle(name, shapes, marker.header.frame_id)
    except WorldError as error:
        raise WorldError(f"marker '{printable(name)}': {error}") from None


def _shapes(marker: Marker, package_dirs: Sequence[Path]) -> list[Shape]:
    """The shapes in the frame of the marker's pose."""
    scale = frozen_array(
        [marker.scale.x, marker.scale.y, marker.scale.z], (3,), "scale", WorldError
    )
    kind = marker.type
    if kind == Marker.CUBE:
        return [Box(scale)]
    if kind == Marker.SPHERE:
        return [Sphere(0.5 * _diameter(scale, "a sphere"))]
    if kind == Marker.CYLINDER:
        return [Cylinder(0.5 * _diameter(scale[:2], "a cylinder"), scale[2])]
    if kind == Marker.MESH_RESOURCE:
        found = find_mesh(marker.mesh_resource, package_dirs)
        return [Mesh(scaled(found.vertices, scale), found.triangles)]
    points = _points(marker)
    if kind == Marker.TRIANGLE_LIST:
        if len(points) % 3:
            raise WorldError(f"a TRIANGLE_LIST has 3 points per triangle, got {len(points)} points")
        return [Mesh(scaled(points, scale), np.arange(len(points)).reshape(-1, 3))]
    if kind == Marker.CUBE_LIST:
        return [Box(scale, point) for point in points]
    if kind == Marker.SPHERE_LIST:
        radius = 0.5 * _diameter(scale, "a sphere")
        return [Sphere(radius, point) for point in points]
    raise WorldError(f"type {kind} is not supported; accepted are {_ACCEPTED}")


def _points(marker: Marker) -> FloatArray:
    limits, is_mesh = INPUT_LIMITS, marker.type == Marker.TRIANGLE_LIST
    most = 3 * limits.triangles if is_mesh else limits.shapes
    if len(marker.points) > most:
        raise WorldError(f"it has {len(marker.points)} points, at most {most} are accepted")
    return np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)


def _diameter(scale: Any, what: str) -> float:
    if np.ptp(scale) > 1e-6 * np.abs(scale).max():
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"the diameters of {what} must be equal, got {numbers}")
    return float(scale[0])


class MarkerMessages:
    """Applies messages of markers to a world, each once.

    They come on two subscriptions, since latched messages and those of best-effort publishers need
    one each.

    Attributes
    ----------
    rejected : dict
        Why the last marker of a name can't be used, by the names of such markers.
    """

    most = 400
    """Largest numbers of remembered messages, of rejections, and of names that were deleted."""

    def __init__(self) -> None:
        self.rejected: dict[str, str] = {}
        # The latest messages, because latched ones arrive on both subscriptions.
        self._seen: deque[int] = deque(maxlen=self.most)
        # Source time of the last change of each obstacle, and of all of them [ns]; the latest last.
        self._changed: dict[str, int] = {}
        self._cleared = 0

    def apply(
        self,
        world: World,
        message: MarkerArray,
        stamp: int,
        *,
        is_late: bool,
        links: Collection[str] | None,
        folders: Sequence[Path],
    ) -> tuple[list[Obstacle], list[str]] | None:
        """Apply a message; a marker that can't be used changes nothing.

        Parameters
        ----------
        world :
            The obstacles before.
        message :
            The message.
        stamp :
            Its source time [ns].
        is_late :
            Whether it came on the subscription of latched messages.
        links :
            Links of the robot that obstacles may be attached to; any by default.
        folders :
            Folders of packages, for meshes.

        Returns
        -------
        obstacles, problems :
            The obstacles after, and why markers were rejected; None if the message came before.
        """
        if stamp and stamp in self._seen:
            return None
        self._seen.append(stamp)
        obstacles, problems = {one.name: one for one in world}, list[str]()
        for marker in message.markers:
            name = marker_name(marker)
            # A latched message may come after a newer one.
            if is_late and stamp < max(self._changed.get(name, 0), self._cleared):
                continue
            try:
                _apply_marker(marker, obstacles, links, folders)
            except WorldError as error:
                problems.append(str(error))
                if len(self.rejected) < self.most:
                    self.rejected[name[:_MAX_NAME]] = str(error)
                continue
            for cleared in [x for x in self.rejected if _concerns(marker, x)]:
                del self.rejected[cleared]
            self._changed.pop(name, None)
            self._changed[name] = stamp
            if marker.action == Marker.DELETEALL and not marker.ns:
                self._cleared = stamp
        self._forget(obstacles)
        return list(obstacles.values()), problems

    def _forget(self, obstacles: Collection[str]) -> None:
        """Forget the first of too many deleted names: a late message may bring them back."""
        deleted = [name for name in self._changed if name not in obstacles]
        for name in deleted[: max(len(deleted) - self.most, 0)]:
            del self._changed[name]


def _concerns(marker: Marker, name: str) -> bool:
    """Whether a marker changes or deletes the obstacle of a name."""
    if marker.action != Marker.DELETEALL:
        return name == marker_name(marker)
    return name.startswith(f"{marker.ns}/" if marker.ns else "")


def _apply_marker(
    marker: Marker,
    obstacles: dict[str, Obstacle],
    links: Collection[str] | None,
    folders: Sequence[Path],
) -> None:
    name, frame = marker_name(marker), marker.header.frame_id
    if len(name) > _MAX_NAME:
        raise WorldError(
            f"a marker's name has {len(name)} characters, at most {_MAX_NAME} are used"
        )
    if marker.action == Marker.DELETEALL:
        for other in [one for one in obstacles if _concerns(marker, one)]:
            del obstacles[other]
    elif marker.action == Marker.DELETE:
        obstacles.pop(name, None)
    elif marker.action == Marker.ADD:
        if frame and links is not None and frame not in links:
            raise WorldError(f"marker '{name}': {unknown_name('link', frame, links)}")
        obstacles[name] = to_obstacle(marker, folders)
    else:
        raise WorldError(
            f"marker '{name}' has the action {marker.action}; accepted are 0 (add or modify), "
            "2 (delete) and 3 (delete all)"
        )
