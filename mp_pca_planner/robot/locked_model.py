# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The model of some joints of a robot with the others locked, and its collision geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import frozen_array
from ..exceptions import RobotError
from .inertias import joint_of
from .link_shapes import LinkShapes

_NOT_A_LINK = " (joint)"


class LockedModel:
    """A model of all movable joints, with the positions of the locked ones.

    Parameters
    ----------
    full : pinocchio.Model
        The model of all movable joints.
    joint_names : sequence of str
        Joints that move.
    locked : mapping of str to float
        Positions [rad or m] of others; 0 (or the nearest limit) unless given.

    Raises
    ------
    RobotError
        If a position is no finite number.
    """

    def __init__(self, full: Any, joint_names: Sequence[str], locked: Mapping[str, float]) -> None:
        self._full = full
        low, high = full.lowerPositionLimit, full.upperPositionLimit
        self._reference = np.clip(pin.neutral(full), low, high)
        for name, value in locked.items():
            position = frozen_array(value, (), f"position of locked joint '{name}'", RobotError)
            self._reference[full.joints[full.getJointId(name)].idx_q] = position
        names = enumerate(full.names)
        self._locked = [i for i, name in names if i > 0 and name not in joint_names]

    def reduced(self, geometries: list[Any]) -> tuple[Any, list[Any]]:
        """The model without locked joints, and geometries of its links.

        Pinocchio finds frames by name there, and some joints have the name of a link: they get
        other names meanwhile.
        """
        full = self._full
        if not self._locked:
            return full, geometries
        links = {frame.name for frame in full.frames if frame.type == pin.FrameType.BODY}
        model = full.copy()
        for frame in model.frames:
            if frame.type != pin.FrameType.BODY and frame.name in links:
                frame.name += _NOT_A_LINK
        for joint, name in enumerate(full.names):
            model.names[joint] = name + _NOT_A_LINK if name in links else name
        reduced, geometries = pin.buildReducedModel(
            model, geometries, self._locked, self._reference
        )
        for joint, name in enumerate(list(reduced.names)):
            reduced.names[joint] = name.removesuffix(_NOT_A_LINK)
        return reduced, geometries

    def collision_geometry(self, shapes: LinkShapes) -> tuple[Any, Any]:
        """The reduced model, and the collision geometry of its links with all distant pairs."""
        full, whole = self._full, pin.GeometryModel()
        for k, (link, placement, solid) in enumerate(shapes):
            frame = full.frames[full.getFrameId(link, pin.FrameType.BODY)]
            part = pin.GeometryObject(
                f"{link}_{k}",
                parent_joint=joint_of(frame),
                placement=frame.placement * placement,
                collision_geometry=solid.shape,
            )
            part.parentFrame = full.getFrameId(link, pin.FrameType.BODY)
            whole.addGeometryObject(part)
        above, objects = full.parents, whole.geometryObjects
        for first, second in combinations(range(whole.ngeoms), 2):
            a, b = objects[first].parentJoint, objects[second].parentJoint
            if a not in (b, above[b]) and b != above[a]:
                whole.addCollisionPair(pin.CollisionPair(first, second))
        model, (geometry,) = self.reduced([whole])
        return model, geometry
