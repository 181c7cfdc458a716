# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes as the distance library knows them."""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary, WeakValueDictionary

from .mesh_pieces import Piece
from .shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere

try:
    import coal as coal
except ImportError:  # its name before release 3
    import hppfcl as coal

_Points = getattr(coal, "StdVec_Vec3s", None) or coal.StdVec_Vec3f  # before release 3


class Solid(NamedTuple):
    """A shape for the distance library.

    Attributes
    ----------
    shape, hull : coal.CollisionGeometry
        The shape, and its convex hull.
    is_convex : bool
        Whether both are the same.
    """

    shape: Any
    hull: Any
    is_convex: bool


def solids_of(shape: Shape) -> list[Solid]:
    """The shape for the distance library: several for the pieces of a large mesh."""
    if isinstance(shape, Mesh):
        return [solid_of(piece) for piece in shape.pieces]
    if isinstance(shape, Box):
        body = coal.Box(*shape.size)
    elif isinstance(shape, Sphere):
        body = coal.Sphere(shape.radius)
    elif isinstance(shape, Capsule):
        body = coal.Capsule(shape.radius, shape.height)
    else:
        assert isinstance(shape, Cylinder)
        body = coal.Cylinder(shape.radius, shape.height)
    return [Solid(body, body, True)]


# Worlds with the same mesh share them: they are never changed.
_SOLIDS: WeakKeyDictionary[Piece, Solid] = WeakKeyDictionary()


def solid_of(piece: Piece) -> Solid:
    """A piece of a mesh for the distance library, the same one each time."""
    if piece not in _SOLIDS:
        _SOLIDS[piece] = _solid_of(piece)
    return _SOLIDS[piece]


def _solid_of(piece: Piece) -> Solid:
    hull = _hull_of(piece)
    return Solid(hull if piece.is_convex else _surface_of(piece), hull, piece.is_convex)


# A robot is built anew for each change of a parameter or of the primitives, and Coal keeps the lock
# of the interpreter while it builds the tree of a mesh: robots with equal meshes share them.
_SURFACES: WeakValueDictionary[bytes, Any] = WeakValueDictionary()
_HULLS: WeakValueDictionary[bytes, Any] = WeakValueDictionary()


def link_solid(piece: Piece) -> Solid:
    """The mesh of a link for the distance library, always with its triangles.

    Equal meshes share the same objects while one of them is used.
    """
    content = hashlib.sha256(piece.vertices.tobytes() + piece.triangles.tobytes()).digest()
    surface, hull = _SURFACES.get(content), _HULLS.get(content)
    if surface is None:
        surface = _SURFACES[content] = _surface_of(piece)
    if hull is None:
        hull = _HULLS[content] = _hull_of(piece)
    return Solid(surface, hull, piece.is_convex)


def _hull_of(piece: Piece) -> Any:
    points, faces = _Points(), coal.StdVec_Triangle()
    for corner in piece.corners:
        points.append(corner)
    for face in piece.faces.tolist():
        faces.append(coal.Triangle(*face))
    return coal.Convex(points, faces)


def _surface_of(piece: Piece) -> Any:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(piece.triangles), len(piece.vertices))
    mesh.addVertices(piece.vertices)
    mesh.addTriangles(piece.triangles)
    mesh.endModel()
    return mesh
