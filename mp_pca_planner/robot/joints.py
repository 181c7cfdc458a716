# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The joints of a robot: their order, and the model of those that move with the others locked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import MAX_SIZE, FloatArray, frozen_array
from ..exceptions import RobotError
from .urdf import Description

_NOT_A_LINK = " (joint)"


def joint_of(frame: Any) -> int:
    """The joint that moves a frame; releases of Pinocchio name the attribute differently."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)


class JointOrder:
    """Conversion between the order of the user's joints and that of Pinocchio's vectors.

    Attributes
    ----------
    to_pin : array of int, shape (n_joints,)
        Index of each of the user's joints in Pinocchio's vectors.
    from_pin : array of int, shape (n_joints,)
        The inverse permutation.
    is_same : bool
        Whether both orders are the same.
    """

    def __init__(self, model: Any, joint_names: Sequence[str]) -> None:
        self.to_pin = np.array([model.joints[model.getJointId(n)].idx_v for n in joint_names])
        self.from_pin = np.argsort(self.to_pin)
        self.is_same = bool(np.array_equal(self.to_pin, np.arange(len(joint_names))))

    def checked(self, *arrays: FloatArray, n_dims: int) -> list[FloatArray]:
        """Values of the user's joints in Pinocchio's order, all of the shape of the first.

        Pinocchio itself checks neither shapes nor types.

        Raises
        ------
        RobotError
            If the values are not numbers, or have another shape.
        """
        n_joints = len(self.to_pin)
        expected: tuple[int | None, ...] = (*(None,) * (n_dims - 1), n_joints)
        found: list[FloatArray] = []
        for x in arrays:
            # The innermost loop of planning has arrays of floats.
            is_array = isinstance(x, np.ndarray) and x.dtype == np.float64 and x.ndim == n_dims
            is_usual = is_array and x.shape[-1] == n_joints and x.size <= MAX_SIZE
            if not is_usual or (found and x.shape != expected):
                x = frozen_array(x, expected, "values of the joints", RobotError)
            expected = x.shape
            found.append(self.sorted(x))
        return found

    def sorted(self, x: FloatArray) -> FloatArray:
        """Values of the user's joints, along the last axis, in Pinocchio's order."""
        return np.ascontiguousarray(x if self.is_same else x[..., self.from_pin])

    def restored(self, x: FloatArray) -> FloatArray:
        """Pinocchio's values, along the last axis, in the user's order."""
        return np.asarray(x if self.is_same else x[..., self.to_pin])

    def restored_matrix(self, x: FloatArray) -> FloatArray:
        """The same along both of the last axes."""
        return x if self.is_same else x[..., self.to_pin, :][..., self.to_pin]


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
    description : Description
        Names the joints that mimic others, whose positions follow from those, and the links with
        collision shapes.

    Attributes
    ----------
    known : mapping of str to float
        The positions that were given, and those of joints that mimic these [rad or m].

    Raises
    ------
    RobotError
        If a position is no finite number.
    """

    def __init__(
        self,
        full: Any,
        joint_names: Sequence[str],
        locked: Mapping[str, float],
        description: Description,
    ) -> None:
        self._full = full
        self._colliding = {*description.shapes, *description.lost_shapes}
        low, high = full.lowerPositionLimit, full.upperPositionLimit
        self._reference = np.clip(pin.neutral(full), low, high)
        names = enumerate(full.names)
        self._locked = [i for i, name in names if i > 0 and name not in joint_names]
        given = {
            name: float(frozen_array(x, (), f"position of locked joint '{name}'", RobotError))
            for name, x in locked.items()
        }
        following = {
            name: mimic.multiplier * given[mimic.joint] + mimic.offset
            for name, mimic in description.mimics.items()
            if mimic.joint in given and name not in joint_names
        }
        self.known: Mapping[str, float] = {**following, **given}
        for name, position in self.known.items():
            self._reference[full.joints[full.getJointId(name)].idx_q] = position

    def relevant(self, *, pairs: bool, links: Collection[str]) -> tuple[str, ...]:
        """The locked joints whose positions make a difference, see `Robot.relevant_joints`."""
        model = self._full
        moving = {i for i in range(1, model.njoints) if i not in self._locked}
        shapes, needed = (
            {joint_of(f) for f in model.frames if f.type == pin.FrameType.BODY and f.name in some}
            for some in (self._colliding, links)
        )
        found = []
        for joint in self._locked:
            carried, carriers = set(model.subtrees[joint]), set(model.supports[joint])
            is_carried = bool(moving & carriers)
            has_mass = any(model.inertias[i].mass > 0.0 for i in carried)
            if (
                (carried & (moving | needed))
                or (is_carried and has_mass)
                or ((is_carried or pairs) and carried & shapes)
            ):
                found.append(model.names[joint])
        return tuple(found)

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

    def collision_geometry(self, shapes: Iterable[tuple[str, Any, Any]]) -> tuple[Any, Any]:
        """The reduced model, and the collision geometry of its links with all distant pairs.

        The shapes are those of :class:`.LinkShapes`.
        """
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
