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
from .solids import Solid, coal, solids_of
from .world import Obstacle, World

__all__ = ["Bodies", "coal"]


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
