# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, as the distance library knows them: those of links and of obstacles."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray, set_frozen
from ..exceptions import RobotError, WorldError, unknown_name
from ..input_limits import INPUT_LIMITS
from .mesh_files import find_mesh, scaled
from .mesh_pieces import MeshPiece
from .urdf import Description, StatedShape
from .world import Box, Capsule, Cylinder, Mesh, Shape, Sphere, World

Solid = tuple[Any, Any, MeshPiece | None]
"""A shape for the distance library, its convex hull (the same object if it is convex), and the
piece of a mesh that both are made of."""


def solids_of(shape: Shape) -> list[Solid]:
    """The shape for the distance library: several for the pieces of a large mesh."""
    if isinstance(shape, Mesh):
        return [(x.hull if x.is_convex else x.surface, x.hull, x) for x in shape.pieces]
    if isinstance(shape, Box):
        body = coal.Box(*shape.size)
    elif isinstance(shape, Sphere):
        body = coal.Sphere(shape.radius)
    elif isinstance(shape, Capsule):
        body = coal.Capsule(shape.radius, shape.height)
    else:
        assert isinstance(shape, Cylinder)
        body = coal.Cylinder(shape.radius, shape.height)
    return [(body, body, None)]


# A robot is built anew for each change of a parameter or of the primitives, and Coal keeps the lock
# of the interpreter while it builds the tree of a mesh: robots with equal meshes share them.
_MESHES: WeakValueDictionary[bytes, MeshPiece] = WeakValueDictionary()


def shared(piece: MeshPiece) -> MeshPiece:
    """The piece of a mesh, or an equal one as long as that is used."""
    content = hashlib.sha256(piece.vertices.tobytes() + piece.triangles.tobytes()).digest()
    return _MESHES.setdefault(content, piece)


def _stated(stated: StatedShape, package_dirs: Sequence[Path]) -> Shape:
    """A collision shape of a link, at the origin."""
    sizes = stated.sizes
    if stated.kind == "box":
        return Box(sizes)
    if stated.kind == "sphere":
        return Sphere(float(sizes[0]))
    if stated.kind in ("cylinder", "capsule"):
        kind = Cylinder if stated.kind == "cylinder" else Capsule
        return kind(float(sizes[0]), float(sizes[1]))
    found = find_mesh(stated.file, package_dirs)
    mesh = Mesh(scaled(found.vertices, sizes), found.triangles)
    # Replaces the cached property.
    set_frozen(mesh, pieces=tuple(map(shared, mesh.pieces)))
    return mesh


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
    pieces : tuple of MeshPiece or None
        The piece of a mesh that each shape is made of.
    numbers : array of int, shape (n_shapes,)
        Pieces of the same mesh have the same number.
    notes : tuple of str
        What is unusual about shapes of links, as sentences.
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
    pieces: tuple[MeshPiece | None, ...]
    numbers: NDArray[np.intp]
    notes: tuple[str, ...] = ()

    @classmethod
    def of_links(
        cls, model: Any, description: Description, package_dirs: Sequence[Path], source: str
    ) -> Bodies:
        """The collision shapes of the links of a robot.

        Parameters
        ----------
        model : pinocchio.Model
            The model of the joints that move.
        description : Description
            The URDF.
        package_dirs : sequence of Path
            Folders of the packages that ``package://`` paths of meshes name.
        source : str
            Name of the description in messages.

        Raises
        ------
        RobotError
            If a shape can't be used, a mesh can't be found or read, or there are too many.
        """
        for link, problem in description.lost_shapes.items():
            raise RobotError(f"{source}: <collision> of link '{link}': {problem}")
        count, most = sum(map(len, description.shapes.values())), INPUT_LIMITS.robot_shapes
        if count > most:
            raise RobotError(f"{source} has {count} collision shapes, at most {most} are accepted")
        parts, notes, n_triangles = [], dict[str, None](), 0
        every = [(link, one) for link, many in description.shapes.items() for one in many]
        for link, stated in every:
            try:
                shape = _stated(stated, package_dirs)
            except WorldError as error:
                raise RobotError(f"{source}: <collision> of link '{link}': {error}") from None
            if isinstance(shape, Mesh):
                n_triangles += len(shape.triangles)
                if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
                    raise RobotError(
                        f"the collision meshes of the {source} have more than {most} triangles"
                    )
                if shape.note:
                    notes[f"link '{link}': {shape.note}"] = None
            place = pin.SE3(pin.rpy.rpyToMatrix(*stated.origin[3:]), stated.origin[:3])
            joint, frame = _attachment(model, link)
            parts.append((link, joint, frame * place, solids_of(shape)))
        return replace(cls._made(model, parts), notes=tuple(notes))

    def with_world(self, world: World) -> Bodies:
        """The same with the obstacles of a world.

        Raises
        ------
        WorldError
            If an obstacle is attached to an unknown link, or has the name of a link.
        """
        links = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
        parts = []
        for obstacle in world:
            name, link = obstacle.name, obstacle.frame
            if name in self.names:
                raise WorldError(f"obstacle '{name}' has the name of a link: rename it")
            if link and link not in links:
                raise WorldError(f"obstacle '{name}': {unknown_name('link', link, links)}")
            joint, frame = _attachment(self.model, link) if link else (0, pin.SE3.Identity())
            for shape in obstacle.shapes:
                placement = frame * pin.XYZQUATToSE3(shape.pose)
                parts.append((name, joint, placement, solids_of(shape)))
        others, joined = vars(self._made(self.model, parts)), {}
        for key, own in vars(self).items():
            if isinstance(own, tuple):
                joined[key] = own + others[key]
            elif isinstance(own, np.ndarray):
                joined[key] = np.concatenate([own, others[key]])
        return replace(self, **joined)

    @classmethod
    def _made(cls, model: Any, parts: Sequence[tuple[str, int, Any, list[Solid]]]) -> Bodies:
        """Bodies of shapes with their names, joints and placements."""
        every = [(k, part, solid) for k, part in enumerate(parts) for solid in part[3]]
        hulls = tuple(hull for *_, (_, hull, _) in every)
        for *_, (shape, hull, _) in every:
            shape.computeLocalAABB()
            hull.computeLocalAABB()
        # That of a hull is larger, if the shape is a surface without volume.
        boxes = [hull.aabb_local for hull in hulls]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        origins = np.reshape([part[2].translation for _, part, _ in every], (-1, 3))
        rotations = np.reshape([part[2].rotation for _, part, _ in every], (-1, 3, 3))
        return cls(
            model,
            tuple(shape for *_, (shape, _, _) in every),
            hulls,
            tuple(part[0] for _, part, _ in every),
            np.array([shape is hull for *_, (shape, hull, _) in every], dtype=bool),
            np.array([part[1] for _, part, _ in every], dtype=np.intp),
            origins,
            rotations,
            origins + (rotations @ corners.mean(axis=1)[:, :, None])[..., 0],
            np.array([float(hull.aabb_radius) for hull in hulls]),
            0.5 * (corners[:, 1] - corners[:, 0]),
            tuple(piece for *_, (_, _, piece) in every),
            np.array([k for k, *_ in every], dtype=np.intp),
        )


def _attachment(model: Any, link: str) -> tuple[int, Any]:
    """The joint that moves a link, and the placement of the link there."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return frame.parentJoint, frame.placement
