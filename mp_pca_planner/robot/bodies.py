# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes that may collide, fixed to the joints of a model: those of links and of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import WorldError, unknown_name
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
    shapes, hulls : pinocchio.GeometryModel
        The shapes, and the same with convex hulls in the place of meshes; without pairs.
    names : tuple of str
        The link or obstacle that each shape belongs to.
    are_convex : array of bool, shape (n_shapes,)
        Whether the hull of each shape is the shape itself.
    joints : array of int, shape (n_shapes,)
        The joint of the model that each shape moves with; 0 for the base.
    centres : array, shape (n_shapes, 3)
        Centre of a ball and of a box around each shape, in the frame of its joint [m].
    radii : array, shape (n_shapes,)
        Radius of that ball [m].
    rotations : array, shape (n_shapes, 3, 3)
        Orientation of that box in the frame of the joint.
    halves : array, shape (n_shapes, 3)
        Half of the lengths of its edges [m].
    """

    model: Any
    shapes: Any
    hulls: Any
    names: tuple[str, ...]
    are_convex: NDArray[np.bool_]
    joints: NDArray[np.intp]
    centres: FloatArray
    radii: FloatArray
    rotations: FloatArray
    halves: FloatArray

    @classmethod
    def of_links(cls, model: Any, geometry: Any) -> Bodies:
        """The shapes of a robot's links."""
        shapes = geometry.copy()
        shapes.removeAllCollisionPairs()
        hulls, convex = shapes.copy(), []
        for part, hull in zip(shapes.geometryObjects, hulls.geometryObjects, strict=True):
            convex.append(_use_hull(part, hull))
        names = [model.frames[part.parentFrame].name for part in shapes.geometryObjects]
        return cls._made(model, shapes, hulls, names, convex)

    def with_world(self, world: World) -> Bodies:
        """The same with the obstacles of a world.

        Raises
        ------
        WorldError
            If an obstacle is attached to an unknown link, or has the name of a link.
        """
        shapes, hulls, names = self.shapes.copy(), self.hulls.copy(), [*self.names]
        convex = self.are_convex.tolist()
        for obstacle in world:
            if obstacle.name in self.names:
                raise WorldError(f"obstacle '{obstacle.name}' has the name of a link: rename it")
            joint, placement = self._attachment(obstacle)
            for shape in obstacle.shapes:
                part = pin.GeometryObject(
                    f"{len(names)} {obstacle.name}",
                    parent_joint=joint,
                    placement=placement * pin.XYZQUATToSE3(shape.pose),
                    collision_geometry=_geometry_of(shape),
                )
                hull = type(part)(part)
                convex.append(_use_hull(part, hull))
                shapes.addGeometryObject(part)
                hulls.addGeometryObject(hull)
                names.append(obstacle.name)
        return self._made(self.model, shapes, hulls, names, convex)

    @classmethod
    def _made(
        cls, model: Any, shapes: Any, hulls: Any, names: Sequence[str], convex: Sequence[bool]
    ) -> Bodies:
        parts = list(shapes.geometryObjects)
        for part in parts:
            part.geometry.computeLocalAABB()
        boxes = [part.geometry.aabb_local for part in parts]
        corners = np.array([(box.min_, box.max_) for box in boxes]).reshape(-1, 2, 3)
        centres = [
            part.placement.act(centre)
            for part, centre in zip(parts, corners.mean(axis=1), strict=True)
        ]
        halves = 0.5 * (corners[:, 1] - corners[:, 0])
        return cls(
            model,
            shapes,
            hulls,
            tuple(names),
            np.array(convex, dtype=bool),
            np.array([part.parentJoint for part in parts], dtype=np.intp),
            np.reshape(centres, (-1, 3)),
            np.array([float(part.geometry.aabb_radius) for part in parts]),
            np.array([part.placement.rotation for part in parts]).reshape(-1, 3, 3),
            halves,
        )

    @cached_property
    def moved(self) -> FloatArray:
        """1 for each joint that moves a shape, else 0; shape (n_shapes, n_joints)."""
        rows = np.zeros((self.model.njoints, self.model.nv))
        for joint, row in enumerate(rows):
            row[[self.model.joints[other].idx_v for other in _chain(self.model, joint)]] = 1.0
        return rows[self.joints]

    @cached_property
    def levers(self) -> FloatArray:
        """Largest speed of a shape by each joint that moves it, shape (n_shapes, n_joints).

        For a joint that turns, the longest path from it along the links to a point of the shape
        [m]; for one that slides, 1.
        """
        rows, reaches = np.zeros((len(self.names), self.model.nv)), self.radii.copy()
        reaches += np.linalg.norm(self.centres, axis=1)
        for shape in np.flatnonzero(self.joints).tolist():
            reach = float(reaches[shape])
            for joint in _chain(self.model, int(self.joints[shape])):
                slides = _slide(self.model, joint)
                rows[shape, self.model.joints[joint].idx_v] = 1.0 if slides else reach
                placement = self.model.jointPlacements[joint].translation
                reach += float(np.linalg.norm(placement)) + slides
        return rows

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
        joint = getattr(frame, "parentJoint", None)
        return frame.parent if joint is None else joint, frame.placement


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


def _use_hull(part: Any, hull: Any) -> bool:
    """Replace a mesh by its convex hull; return whether the hull is the shape itself."""
    shape = part.geometry
    if not hasattr(shape, "buildConvexHull"):
        return True
    try:
        shape.buildConvexHull(True, "Qt")
    except (RuntimeError, ValueError):
        return False  # it is flat, or the library was built without qhull
    hull.geometry = shape.convex
    return bool(abs(shape.computeVolume()) >= _CONVEX_SHARE * shape.convex.computeVolume())


def _chain(model: Any, joint: int) -> list[int]:
    """The joints from one to the base."""
    return [other for other in reversed(list(model.supports[joint])) if other > 0]


def _slide(model: Any, joint: int) -> float:
    """Range of a joint that slides [m], 0 for one that turns."""
    if not model.joints[joint].shortname().startswith("JointModelP"):
        return 0.0
    index = model.joints[joint].idx_q
    ends = model.lowerPositionLimit[index], model.upperPositionLimit[index]
    return float(np.abs(ends).max())
