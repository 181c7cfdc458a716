# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, as the distance library knows them: those of links and of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import PlannerError, RobotError, WorldError, unknown_name
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule
from .meshes import MeshSolid, find_mesh, scaled
from .urdf import Description, StatedShape, stated_shape
from .world import Box, Capsule, Cylinder, Mesh, Shape, Sphere, World

coal, pin = LazyModule("coal"), LazyModule("pinocchio")

Solid = tuple[Any, Any, MeshSolid | None]
"""A shape for the distance library, its convex hull (the same object if it is convex), and the
mesh that both are made of."""


def solid_of_shape(shape: Shape) -> Solid:
    """The shape for the distance library."""
    if isinstance(shape, Mesh):
        mesh = shape.solid
        return mesh.hull if mesh.is_convex else mesh.surface, mesh.hull, mesh
    if isinstance(shape, Box):
        body = coal.Box(*shape.size)
    elif isinstance(shape, Sphere):
        body = coal.Sphere(shape.radius)
    elif isinstance(shape, Capsule):
        body = coal.Capsule(shape.radius, shape.height)
    else:
        assert isinstance(shape, Cylinder)
        body = coal.Cylinder(shape.radius, shape.height)
    return body, body, None


def primitive_of(stated: StatedShape) -> Shape:
    """A box, sphere, cylinder or capsule of a link, at the origin."""
    if stated.kind == "box":
        return Box(stated.sizes)
    if stated.kind == "sphere":
        return Sphere(float(stated.sizes[0]))
    return {"cylinder": Cylinder, "capsule": Capsule}[stated.kind](*stated.sizes.tolist())


def _shape(stated: StatedShape, package_dirs: Sequence[Path]) -> Shape:
    """A collision shape of a link, at the origin."""
    if stated.kind != "mesh":
        return primitive_of(stated)
    found = find_mesh(stated.file, package_dirs)
    return Mesh(scaled(found.vertices, stated.sizes), found.triangles)


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
    meshes : tuple of MeshSolid or None
        The mesh that each shape is made of.
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
    meshes: tuple[MeshSolid | None, ...]

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
        every = [(link, one) for link, many in description.collisions.items() for one in many]
        if len(every) > (most := INPUT_LIMITS.robot_shapes):
            raise RobotError(
                f"{source} has {len(every)} collision shapes, at most {most} are accepted"
            )
        parts = []
        for link, element in every:
            try:
                stated = stated_shape(element)
                solid = solid_of_shape(_shape(stated, package_dirs))
            except PlannerError as error:
                raise RobotError(f"{source}: <collision> of link '{link}': {error}") from None
            place = pin.SE3(pin.rpy.rpyToMatrix(*stated.origin[3:]), stated.origin[:3])
            joint, frame = _attachment(model, link)
            parts.append((link, joint, frame * place, solid))
        return cls._made(model, parts)

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
                parts.append((name, joint, placement, solid_of_shape(shape)))
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
        solids = [part[3] for part in parts]
        for shape, hull, _ in solids:
            shape.computeLocalAABB()
            hull.computeLocalAABB()
        # That of a hull is larger, if the shape is a surface without volume.
        boxes = [hull.aabb_local for _, hull, _ in solids]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        origins = np.reshape([part[2].translation for part in parts], (-1, 3))
        rotations = np.reshape([part[2].rotation for part in parts], (-1, 3, 3))
        return cls(
            model,
            tuple(shape for shape, _, _ in solids),
            tuple(hull for _, hull, _ in solids),
            tuple(part[0] for part in parts),
            np.array([shape is hull for shape, hull, _ in solids], dtype=bool),
            np.array([part[1] for part in parts], dtype=np.intp),
            origins,
            rotations,
            origins + (rotations @ corners.mean(axis=1)[:, :, None])[..., 0],
            np.array([float(hull.aabb_radius) for _, hull, _ in solids]),
            0.5 * (corners[:, 1] - corners[:, 0]),
            tuple(mesh for _, _, mesh in solids),
        )


def _attachment(model: Any, link: str) -> tuple[int, Any]:
    """The joint that moves a link, and the placement of the link there."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return frame.parentJoint, frame.placement
