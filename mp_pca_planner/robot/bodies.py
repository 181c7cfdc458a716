# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, as the distance library knows them: those of links and of obstacles."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RobotError, WorldError, unknown_name
from ..input_limits import INPUT_LIMITS
from .joints import joint_of
from .mesh_files import find_mesh, scaled
from .mesh_pieces import MeshPiece
from .urdf import Description, StatedShape
from .world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, World

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
_SOLIDS: WeakKeyDictionary[MeshPiece, Solid] = WeakKeyDictionary()


def solid_of(piece: MeshPiece) -> Solid:
    """A piece of a mesh for the distance library, the same one each time."""
    if piece not in _SOLIDS:
        _SOLIDS[piece] = _solid_of(piece)
    return _SOLIDS[piece]


def _solid_of(piece: MeshPiece) -> Solid:
    hull = _hull_of(piece)
    return Solid(hull if piece.is_convex else _surface_of(piece), hull, piece.is_convex)


# A robot is built anew for each change of a parameter or of the primitives, and Coal keeps the lock
# of the interpreter while it builds the tree of a mesh: robots with equal meshes share them.
_SURFACES: WeakValueDictionary[bytes, Any] = WeakValueDictionary()
_HULLS: WeakValueDictionary[bytes, Any] = WeakValueDictionary()


def link_solid(piece: MeshPiece) -> Solid:
    """A piece of the mesh of a link for the distance library.

    Equal pieces share the same objects while one of them is used.
    """
    content = hashlib.sha256(piece.vertices.tobytes() + piece.triangles.tobytes()).digest()
    hull, surface = _HULLS.get(content), _SURFACES.get(content)
    if hull is None:
        hull = _HULLS[content] = _hull_of(piece)
    if piece.is_convex:
        return Solid(hull, hull, True)
    if surface is None:
        surface = _SURFACES[content] = _surface_of(piece)
    return Solid(surface, hull, False)


def _hull_of(piece: MeshPiece) -> Any:
    points, faces = _Points(), coal.StdVec_Triangle()
    for corner in piece.corners:
        points.append(corner)
    # No list of each face: so many start a search for garbage, which stops all threads.
    for face in zip(*piece.faces.T.tolist(), strict=True):
        faces.append(coal.Triangle(*face))
    return coal.Convex(points, faces)


def _surface_of(piece: MeshPiece) -> Any:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(piece.triangles), len(piece.vertices))
    mesh.addVertices(piece.vertices)
    mesh.addTriangles(piece.triangles)
    mesh.endModel()
    return mesh


class LinkShapes:
    """The collision shapes of a URDF for the distance library.

    Parameters
    ----------
    description : Description
        The URDF.
    package_dirs : sequence of Path
        Folders of the packages that ``package://`` paths of meshes name.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    solids : tuple of Solid
        The shapes: several for the pieces of a large mesh.
    numbers : tuple of int
        For each of them, the number of the shape in the URDF that it is of.
    notes : tuple of str
        What is unusual about shapes, as sentences.

    Raises
    ------
    RobotError
        If a shape can't be used, a mesh can't be found or read, or there are too many.
    """

    def __init__(self, description: Description, package_dirs: Sequence[Path], source: str) -> None:
        for link, problem in description.lost_shapes.items():
            raise RobotError(f"{source}: <collision> of link '{link}': {problem}")
        count, most = sum(map(len, description.shapes.values())), INPUT_LIMITS.robot_shapes
        if count > most:
            raise RobotError(f"{source} has {count} collision shapes, at most {most} are accepted")
        self._links, self._places = list[str](), list[Any]()
        solids, numbers, notes, n_triangles = list[Solid](), list[int](), list[str](), 0
        every = ((link, one) for link, many in description.shapes.items() for one in many)
        for number, (link, stated) in enumerate(every):
            try:
                shape = _shape(stated, package_dirs)
            except WorldError as error:
                raise RobotError(f"{source}: <collision> of link '{link}': {error}") from None
            if isinstance(shape, Mesh):
                n_triangles += len(shape.triangles)
                if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
                    raise RobotError(
                        f"the collision meshes of the {source} have more than {most} triangles"
                    )
                found = [link_solid(piece) for piece in shape.pieces]
                notes += [f"link '{link}': {shape.note}"] if shape.note else []
            else:
                found = solids_of(shape)
            place = pin.SE3(pin.rpy.rpyToMatrix(*stated.origin[3:]), stated.origin[:3])
            solids += found
            numbers += [number] * len(found)
            self._links += [link] * len(found)
            self._places += [place] * len(found)
        self.solids, self.numbers = tuple(solids), tuple(numbers)
        self.notes = tuple(dict.fromkeys(notes))

    def __iter__(self) -> Iterator[tuple[str, Any, Solid]]:
        """The link, the placement on the link, and the shape of each one."""
        return zip(self._links, self._places, self.solids, strict=True)


def _shape(stated: StatedShape, package_dirs: Sequence[Path]) -> Shape:
    sizes = stated.sizes
    if stated.kind == "box":
        return Box(sizes)
    if stated.kind == "sphere":
        return Sphere(float(sizes[0]))
    if stated.kind == "cylinder":
        return Cylinder(float(sizes[0]), float(sizes[1]))
    found = find_mesh(stated.file, package_dirs)
    return Mesh(scaled(found.vertices, sizes), found.triangles)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Shapes fixed to the joints of a model.

    Attributes
    ----------
    model : pinocchio.Model
        The model.
    shapes, hulls : tuple of coal.CollisionGeometry
        The shapes, and the same with convex hulls in the place of meshes.
    names : tuple of str
        The link or obstacle that each shape belongs to.
    are_convex : array of bool, shape (n_shapes,)
        Whether the hull of each shape is the shape itself.
    joints : array of int, shape (n_shapes,)
        The joint of the model that each shape moves with; 0 for the base.
    origins : array, shape (n_shapes, 3)
        Origin of each shape in the frame of its joint [m].
    rotations : array, shape (n_shapes, 3, 3)
        Orientation of each shape, and of a box around it, in the frame of the joint.
    centres : array, shape (n_shapes, 3)
        Centre of that box and of a ball around the shape, in the frame of the joint [m].
    radii : array, shape (n_shapes,)
        Radius of that ball [m].
    halves : array, shape (n_shapes, 3)
        Half of the lengths of the edges of that box [m].
    """

    model: Any
    shapes: tuple[Any, ...]
    hulls: tuple[Any, ...]
    names: tuple[str, ...]
    are_convex: NDArray[np.bool_]
    joints: NDArray[np.intp]
    origins: FloatArray
    rotations: FloatArray
    centres: FloatArray
    radii: FloatArray
    halves: FloatArray

    @classmethod
    def of_links(cls, model: Any, geometry: Any, solids: Sequence[Solid]) -> Bodies:
        """The shapes of a robot's links, for each object of a geometry."""
        parts = [
            (model.frames[one.parentFrame].name, one.parentJoint, one.placement, solid)
            for one, solid in zip(geometry.geometryObjects, solids, strict=True)
        ]
        return cls._made(model, parts)

    def with_world(self, world: World) -> Bodies:
        """The same with the obstacles of a world.

        Raises
        ------
        WorldError
            If an obstacle is attached to an unknown link, or has the name of a link.
        """
        parts = []
        for obstacle in world:
            if obstacle.name in self.names:
                raise WorldError(f"obstacle '{obstacle.name}' has the name of a link: rename it")
            joint, frame = self._attachment(obstacle)
            for shape in obstacle.shapes:
                placement = frame * pin.XYZQUATToSE3(shape.pose)
                parts += [(obstacle.name, joint, placement, one) for one in solids_of(shape)]
        others, joined = vars(self._made(self.model, parts)), {}
        for key, own in vars(self).items():
            if isinstance(own, tuple):
                joined[key] = own + others[key]
            elif isinstance(own, np.ndarray):
                joined[key] = np.concatenate([own, others[key]])
        return replace(self, **joined)

    @classmethod
    def _made(cls, model: Any, parts: Sequence[tuple[str, int, Any, Solid]]) -> Bodies:
        """Bodies of shapes with their names, joints and placements."""
        solids = [solid for *_, solid in parts]
        for solid in solids:
            solid.shape.computeLocalAABB()
            solid.hull.computeLocalAABB()
        # That of a hull is larger, if the shape is a surface without volume.
        boxes = [solid.hull.aabb_local for solid in solids]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        origins = np.reshape([placement.translation for *_, placement, _ in parts], (-1, 3))
        rotations = np.reshape([placement.rotation for *_, placement, _ in parts], (-1, 3, 3))
        return cls(
            model,
            tuple(solid.shape for solid in solids),
            tuple(solid.hull for solid in solids),
            tuple(name for name, *_ in parts),
            np.array([solid.is_convex for solid in solids], dtype=bool),
            np.array([joint for _, joint, *_ in parts], dtype=np.intp),
            origins,
            rotations,
            origins + (rotations @ corners.mean(axis=1)[:, :, None])[..., 0],
            np.array([float(solid.hull.aabb_radius) for solid in solids]),
            0.5 * (corners[:, 1] - corners[:, 0]),
        )

    def _attachment(self, obstacle: Obstacle) -> tuple[int, Any]:
        """The joint that an obstacle moves with, and the placement of its frame there."""
        if not obstacle.frame:
            return 0, pin.SE3.Identity()
        links = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
        if obstacle.frame not in links:
            raise WorldError(
                f"obstacle '{obstacle.name}': {unknown_name('link', obstacle.frame, links)}"
            )
        frame = self.model.frames[self.model.getFrameId(obstacle.frame, pin.FrameType.BODY)]
        return joint_of(frame), frame.placement
