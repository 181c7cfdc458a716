# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Pieces of triangle meshes with their convex hulls.

The hulls are built by SciPy, which rejects vertices without volume and runs without the lock of the
interpreter. Coal ends the process on such vertices. Large meshes are cut, because Coal keeps the
lock while it builds the tree of a mesh or measures a distance, and the robot may have to stop.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

THICKNESS = 1e-4
"""Thickness of the hull of a mesh without volume [m]."""

# Extent below which a mesh has no volume, relative to its largest extent and in metres.
_THIN, _SMALLEST = 1e-6, 1e-7
# Share of its convex hull's volume, or area, from which on a mesh is convex: files hold 6 digits.
# The hull in its place is on the safe side.
_CONVEX_SHARE = 1.0 - 1e-3
# Coal takes some 15 ms for the tree of this many triangles, and for a hull of so many vertices.
_MAX_TRIANGLES, _MAX_VERTICES = 5_000, 10_000
# After the tree of more triangles than these, other threads get the lock for as long [s].
_MANY_TRIANGLES, _PAUSE = 1_000, 15e-3
# The corners of a box by their coordinates, and its triangles.
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=bool)
_SIDES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ],
    dtype=np.intp,
)

Triangles = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MeshPiece:
    """A part of a mesh, and its convex hull.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates [m].
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    corners, faces : array, shapes (n_corners, 3) and (n_faces, 3)
        The same of the convex hull, whose faces are anticlockwise seen from outside. That of a
        surface without volume has a small thickness.
    is_convex : bool
        Whether the hull is the part itself.
    is_thin : bool
        Whether the part has no volume.
    """

    vertices: FloatArray
    triangles: Triangles
    corners: FloatArray
    faces: Triangles
    is_convex: bool
    is_thin: bool

    @cached_property
    def surface(self) -> Any:
        """The triangles for Coal, made once and never changed."""
        surface = coal.BVHModelOBBRSS()
        surface.beginModel(len(self.triangles), len(self.vertices))
        surface.addVertices(self.vertices)
        surface.addTriangles(self.triangles)
        surface.endModel()
        if len(self.triangles) > _MANY_TRIANGLES:
            time.sleep(_PAUSE)
        return surface

    @cached_property
    def hull(self) -> Any:
        """The convex hull for Coal, made once and never changed."""
        points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for corner in self.corners:
            points.append(corner)
        # No list of each face: so many start a search for garbage, which stops all threads.
        for face in zip(*self.faces.T.tolist(), strict=True):
            faces.append(coal.Triangle(*face))
        return coal.Convex(points, faces)


def is_point(vertices: FloatArray) -> bool:
    """Whether vertices of a mesh have no extent: even a needle has one."""
    return bool(np.ptp(vertices, axis=0).max(initial=0.0) <= _SMALLEST)


def whole_piece(vertices: FloatArray, triangles: Triangles) -> MeshPiece:
    """A mesh as one piece, however large."""
    return _piece(*_merged(vertices, triangles))


def pieces_of(vertices: FloatArray, triangles: Triangles) -> tuple[MeshPiece, ...]:
    """The pieces of a mesh: the mesh itself unless it is large.

    Parameters
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates [m].
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    """
    return tuple(_cut(*_merged(vertices, triangles)))


def _merged(vertices: FloatArray, triangles: Triangles) -> tuple[FloatArray, Triangles]:
    """The same mesh without vertices that are equal to others or unused."""
    used = vertices[triangles.ravel()]
    order, is_new = _distinct(used)
    indices = np.empty(len(order), dtype=np.intp)
    indices[order] = np.cumsum(is_new) - 1
    return used[order[is_new]], indices.reshape(-1, 3)


def _distinct(rows: NDArray[Any]) -> tuple[Triangles, NDArray[np.bool_]]:
    """An order in which equal rows are neighbours, and which of them differ from those before.

    Unlike `np.unique` of rows, this does not keep the lock of the interpreter.
    """
    order = np.lexsort(rows.T)
    in_order = rows[order]
    is_new = np.ones(len(order), dtype=bool)
    np.any(in_order[1:] != in_order[:-1], axis=1, out=is_new[1:])
    return order, is_new


def _cut(vertices: FloatArray, triangles: Triangles) -> Iterator[MeshPiece]:
    """The mesh as a whole, or its halves if it is too large."""
    if len(vertices) <= _MAX_VERTICES:
        piece = _piece(vertices, triangles)
        if piece.is_convex or len(triangles) <= _MAX_TRIANGLES:
            yield piece
            return
    centres = vertices[triangles].mean(axis=1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    for half in np.array_split(order, 2):
        used, indices = np.unique(triangles[half], return_inverse=True)
        yield from _cut(vertices[used], indices.reshape(-1, 3))


def _piece(vertices: FloatArray, triangles: Triangles) -> MeshPiece:
    from scipy.spatial import ConvexHull, QhullError

    axes = _axes(vertices)
    local = vertices @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    is_flat = high - low <= max(_THIN * (high[0] - low[0]), _SMALLEST)
    # A surface without volume gets a small thickness.
    thick_low = np.where(is_flat, 0.5 * (low + high - THICKNESS), low)
    thick_high = np.where(is_flat, 0.5 * (low + high + THICKNESS), high)
    points = local
    if is_flat[2]:
        points = np.concatenate([local, local])
        points[: len(local), 2], points[len(local) :, 2] = thick_low[2], thick_high[2]
    is_convex = bool(is_flat[1])
    corners, faces = np.where(_CORNERS, thick_high, thick_low), _SIDES
    if not is_flat[1]:
        try:
            hull = ConvexHull(points)
        except QhullError:  # nearly flat: the box around it takes the place of the hull
            pass
        else:
            used, indices = np.unique(hull.simplices, return_inverse=True)
            corners, faces = points[used], indices.reshape(-1, 3).astype(np.intp)
            a, b, c = np.moveaxis(corners[faces], 1, 0)
            inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
            faces[inward] = faces[inward, ::-1]
            size = _area(local, triangles) * THICKNESS if is_flat[2] else _volume(local, triangles)
            is_convex = bool(size >= _CONVEX_SHARE * hull.volume)
    return MeshPiece(vertices, triangles, corners @ axes.T, faces, is_convex, bool(is_flat[2]))


def _axes(vertices: FloatArray) -> FloatArray:
    """Principal axes of points as right-handed columns, that of the largest extent first."""
    off = vertices - vertices.mean(axis=0)
    off /= np.abs(off).max(initial=0.0) or 1.0
    axes = np.linalg.eigh(off.T @ off)[1]
    axes = axes[:, np.argsort(-np.ptp(off @ axes, axis=0), kind="stable")]
    return np.asarray(axes * [1.0, 1.0, np.sign(np.linalg.det(axes))])


def _volume(vertices: FloatArray, triangles: Triangles) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0) - vertices.mean(axis=0)
    return abs(float(np.einsum("ti,ti->", a, np.cross(b, c)))) / 6.0


def _area(vertices: FloatArray, triangles: Triangles) -> float:
    """Area of different triangles."""
    order, is_new = _distinct(np.sort(triangles, axis=1))
    a, b, c = np.moveaxis(vertices[triangles[order[is_new]]], 1, 0)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
