# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, fixed to the joints of a model: those of links and of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import WorldError, unknown_name
from .inertias import joint_of
from .world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, World

try:
    import coal as coal
except ImportError:  # its name before release 3
    import hppfcl as coal

# Share of its convex hull's volume from which on a closed mesh is convex: files hold 6 digits. The
# hull in its place is on the safe side.
_CONVEX_SHARE = 1.0 - 1e-3


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
    def of_links(cls, model: Any, geometry: Any) -> Bodies:
        """The shapes of a robot's links."""
        parts = [
            (model.frames[one.parentFrame].name, one.parentJoint, one.placement, one.geometry)
            for one in geometry.geometryObjects
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
                parts.append((obstacle.name, joint, placement, _geometry_of(shape)))
        others, joined = vars(self._made(self.model, parts)), {}
        for key, own in vars(self).items():
            if isinstance(own, tuple):
                joined[key] = own + others[key]
            elif isinstance(own, np.ndarray):
                joined[key] = np.concatenate([own, others[key]])
        return replace(self, **joined)

    @classmethod
    def _made(cls, model: Any, parts: Sequence[tuple[str, int, Any, Any]]) -> Bodies:
        """Bodies of shapes with their names, joints and placements."""
        hulls = [_hull_of(shape) for *_, shape in parts]
        for *_, shape in parts:
            shape.computeLocalAABB()
        boxes = [shape.aabb_local for *_, shape in parts]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        origins = np.reshape([placement.translation for *_, placement, _ in parts], (-1, 3))
        rotations = np.reshape([placement.rotation for *_, placement, _ in parts], (-1, 3, 3))
        return cls(
            model,
            tuple(shape for *_, shape in parts),
            tuple(hull for hull, _ in hulls),
            tuple(name for name, *_ in parts),
            np.array([is_convex for _, is_convex in hulls], dtype=bool),
            np.array([joint for _, joint, *_ in parts], dtype=np.intp),
            origins,
            rotations,
            origins + (rotations @ corners.mean(axis=1)[:, :, None])[..., 0],
            np.array([float(shape.aabb_radius) for *_, shape in parts]),
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


def _geometry_of(shape: Shape) -> Any:
    """The shape for the distance library."""
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Capsule):
        return coal.Capsule(shape.radius, shape.height)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.height)
    assert isinstance(shape, Mesh)
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(shape.triangles), len(shape.vertices))
    mesh.addVertices(shape.vertices)
    mesh.addTriangles(shape.triangles)
    mesh.endModel()
    return mesh


def _hull_of(shape: Any) -> tuple[Any, bool]:
    """The convex hull of a mesh, or another shape itself; whether it is the shape itself."""
    if not hasattr(shape, "buildConvexHull"):
        return shape, True
    try:
        shape.buildConvexHull(True, "Qt")
    except (RuntimeError, ValueError):
        return shape, False  # it is flat, or the library was built without qhull
    hull = shape.convex
    return hull, bool(abs(shape.computeVolume()) >= _CONVEX_SHARE * hull.computeVolume())
