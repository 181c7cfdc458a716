# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of a robot: their order, and models in which some of them are locked."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError
from ..lazy import LazyModule
from .urdf import Description

pin = LazyModule("pinocchio")

_NOT_A_LINK = " (joint)"


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
            If they have another shape.
        """
        values = [np.asarray(x, dtype=np.float64) for x in arrays]
        expected = (*values[0].shape[: n_dims - 1], len(self.to_pin))
        for x in values:
            if x.shape != expected or x.ndim != n_dims:
                shape = ", ".join([*["any"] * (n_dims - 1), str(expected[-1])])
                raise RobotError(
                    f"values of the joints must all have the shape ({shape}), got {x.shape}"
                )
        return [self.sorted(x) for x in values]

    def sorted(self, x: FloatArray) -> FloatArray:
        """Values of the user's joints, along the last axis, in Pinocchio's order."""
        return np.ascontiguousarray(x if self.is_same else x[..., self.from_pin])

    def restored(self, x: FloatArray) -> FloatArray:
        """Pinocchio's values, along the last axis, in the user's order."""
        return np.asarray(x if self.is_same else x[..., self.to_pin])

    def restored_matrix(self, x: FloatArray) -> FloatArray:
        """The same along both of the last axes."""
        return x if self.is_same else x[..., self.to_pin, :][..., self.to_pin]


def positions_with_mimics(
    locked: Mapping[str, float], joint_names: Sequence[str], description: Description
) -> dict[str, float]:
    """Given positions of locked joints, and those of joints that mimic these [rad or m].

    Raises
    ------
    RobotError
        If a position is no finite number.
    """
    given = {
        name: float(frozen_array(x, (), f"position of locked joint '{name}'", RobotError))
        for name, x in locked.items()
    }
    following = {
        name: multiplier * given[followed] + offset
        for name, (followed, multiplier, offset) in description.mimics.items()
        if followed in given and name not in joint_names
    }
    return {**following, **given}


def reduced_model(full: Any, joint_names: Sequence[str], locked: Mapping[str, float]) -> Any:
    """A model in which only some joints move.

    Pinocchio finds frames by name in it, and some joints have the name of a link: they get other
    names meanwhile.

    Parameters
    ----------
    full : pinocchio.Model
        The model of all joints.
    joint_names : sequence of str
        Joints that move.
    locked : mapping of str to float
        Positions [rad or m] of others; 0 (or the nearest limit) unless given.
    """
    reference = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
    for name, position in locked.items():
        reference[full.joints[full.getJointId(name)].idx_q] = position
    fixed = locked_joints(full, joint_names)
    if not fixed:
        return full
    links = {frame.name for frame in full.frames if frame.type == pin.FrameType.BODY}
    model = full.copy()
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name += _NOT_A_LINK
    for joint, name in enumerate(full.names):
        model.names[joint] = name + _NOT_A_LINK if name in links else name
    reduced = pin.buildReducedModel(model, fixed, reference)
    for joint, name in enumerate(list(reduced.names)):
        reduced.names[joint] = name.removesuffix(_NOT_A_LINK)
    return reduced


def locked_joints(full: Any, joint_names: Collection[str]) -> list[int]:
    """Pinocchio's numbers of the joints that don't move."""
    return [i for i, name in enumerate(full.names) if i > 0 and name not in joint_names]


def joints_of_links(full: Any, links: Collection[str]) -> list[int]:
    """Pinocchio's numbers of the joints that carry some links, in their order."""
    body = pin.FrameType.BODY
    ids = (full.getFrameId(name, body) for name in links if full.existFrame(name, body))
    return [full.frames[i].parentJoint for i in ids]
