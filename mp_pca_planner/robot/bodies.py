# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, as the distance library knows them: those of links and of obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, RobotError, WorldError, unknown_name
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule
from .meshes import MeshSolid, find_mesh, scaled
from .urdf import Description, StatedShape, stated_shape
from .world import Box, Capsule, Cylinder, Mesh, Shape, Sphere, World

coal, pin = LazyModule("coal"), LazyModule("pinocchio")


class Body(NamedTuple):
    """A shape fixed to a joint.

    Attributes
    ----------
    name : str
        The link or obstacle that it belongs to.
    joint : int
        The joint of the model that it moves with; 0 for the base.
    place : pinocchio.SE3
        Its pose in the frame of the joint.
    shape, hull : coal.CollisionGeometry
        The shape, and its convex hull: the same object if it is convex.
    mesh : MeshSolid or None
        The mesh that both are made of.
    """

    name: str
    joint: int
    place: Any
    shape: Any
    hull: Any
    mesh: MeshSolid | None = None


def _body(name: str, joint: int, place: Any, shape: Shape) -> Body:
    """A shape for the distance library."""
    if isinstance(shape, Mesh):
        mesh = shape.solid
        surface = mesh.hull if mesh.is_convex else mesh.surface
        return Body(name, joint, place, surface, mesh.hull, mesh)
    if isinstance(shape, Box):
        body = coal.Box(*shape.size)
    elif isinstance(shape, Sphere):
        body = coal.Sphere(shape.radius)
    elif isinstance(shape, Capsule):
        body = coal.Capsule(shape.radius, shape.height)
    else:
        assert isinstance(shape, Cylinder)
        body = coal.Cylinder(shape.radius, shape.height)
    return Body(name, joint, place, body, body)


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


class Bodies:
    """Shapes fixed to the joints of a model, as arrays.

    Attributes
    ----------
    model : pinocchio.Model
        The model.
    parts : tuple of Body
        The shapes.
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

    def __init__(self, model: Any, parts: Iterable[Body]) -> None:
        self.model, self.parts = model, tuple(parts)
        for body in self.parts:
            for solid in (body.shape, body.hull):
                if solid.aabb_radius < 0.0:  # not known yet
                    solid.computeLocalAABB()
        self.names = tuple(body.name for body in self.parts)
        self.are_convex = np.array([body.shape is body.hull for body in self.parts], dtype=bool)
        self.joints = np.array([body.joint for body in self.parts], dtype=np.intp)
        self.origins = np.reshape([body.place.translation for body in self.parts], (-1, 3))
        self.rotations = np.reshape([body.place.rotation for body in self.parts], (-1, 3, 3))
        # The box of a hull is larger, if the shape is a surface without volume.
        boxes = [body.hull.aabb_local for body in self.parts]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        turned = self.rotations @ corners.mean(axis=1)[:, :, None]
        self.centres: FloatArray = self.origins + turned[..., 0]
        self.radii = np.array([float(body.hull.aabb_radius) for body in self.parts])
        self.halves: FloatArray = 0.5 * (corners[:, 1] - corners[:, 0])

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
        links = description.links.items()
        every = [(link, one) for link, x in links for one in x.findall("collision")]
        if len(every) > (most := INPUT_LIMITS.robot_shapes):
            raise RobotError(
                f"{source} has {len(every)} collision shapes, at most {most} are accepted"
            )
        parts = []
        for link, element in every:
            try:
                stated = stated_shape(element)
                shape = _shape(stated, package_dirs)
            except PlannerError as error:
                raise RobotError(f"{source}: <collision> of link '{link}': {error}") from None
            place = pin.SE3(pin.rpy.rpyToMatrix(*stated.origin[3:]), stated.origin[:3])
            joint, frame = _attachment(model, link)
            parts.append(_body(link, joint, frame * place, shape))
        return cls(model, parts)

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
                place = frame * pin.XYZQUATToSE3(shape.pose)
                parts.append(_body(name, joint, place, shape))
        return Bodies(self.model, [*self.parts, *parts])


def _attachment(model: Any, link: str) -> tuple[int, Any]:
    """The joint that moves a link, and the placement of the link there."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return frame.parentJoint, frame.placement
