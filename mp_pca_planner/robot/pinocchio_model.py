# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A Pinocchio model with the joints in the user's order."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial
from typing import Any, Self

import numpy as np
import pinocchio as pin

from ..arrays import MAX_SIZE, FloatArray, frozen_array
from ..exceptions import RobotError, shown, unknown_name
from .inertias import joint_of


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

    def sorted(self, x: FloatArray) -> FloatArray:
        """Values of the user's joints, along the last axis, in Pinocchio's order."""
        return np.ascontiguousarray(x if self.is_same else x[..., self.from_pin])

    def restored(self, x: FloatArray) -> FloatArray:
        """Pinocchio's values, along the last axis, in the user's order."""
        return np.asarray(x if self.is_same else x[..., self.to_pin])

    def restored_matrix(self, x: FloatArray) -> FloatArray:
        """The same along both of the last axes."""
        return x if self.is_same else x[..., self.to_pin, :][..., self.to_pin]


def _depth(model: Any, link: Any) -> int:
    """Number of joints that move a link."""
    joint, depth = joint_of(link), 0
    while joint > 0:
        joint, depth = int(model.parents[joint]), depth + 1
    return depth


class PinocchioModel:
    """A model, its working memory, and the order of its joints.

    Parameters
    ----------
    model : pinocchio.Model
        A model whose joints are `joint_names`, in any order.
    joint_names : sequence of str
        The joints in the order of every array.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    joint_names : tuple of str
        The joints, n_joints of them.
    frame_names : tuple of str
        The links.
    end_effector : str
        The link that most joints move, the last one of several.
    """

    _working_memory: tuple[str, ...] = ("_data",)
    """Attributes that are not pickled, because `_use` makes them of the model."""

    def __init__(self, model: Any, joint_names: Sequence[str], source: str) -> None:
        self.joint_names = tuple(joint_names)
        self._source = source
        self._order = JointOrder(model, joint_names)
        links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
        self.frame_names = tuple(link.name for link in links)
        self.end_effector = max(reversed(links), key=partial(_depth, model)).name
        self._use(model)

    def _use(self, model: Any) -> None:
        """Compute with another model of the same joints and frames."""
        self._model = model
        self._data = model.createData()
        body = pin.FrameType.BODY
        self._ids = {name: model.getFrameId(name, body) for name in self.frame_names}

    def __getstate__(self) -> dict[str, Any]:
        return {name: x for name, x in vars(self).items() if name not in self._working_memory}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._use(state["_model"])

    def _with_model(self, model: Any) -> Self:
        other = copy.copy(self)
        other._use(model)
        return other

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self.joint_names)

    def _in_order(self, *arrays: FloatArray, n_dims: int) -> list[FloatArray]:
        """Values of the user's joints in Pinocchio's order, all of the shape of the first.

        Pinocchio itself checks neither shapes nor types.
        """
        expected: tuple[int | None, ...] = (*(None,) * (n_dims - 1), self.n_joints)
        found: list[FloatArray] = []
        for x in arrays:
            # The innermost loop of planning has arrays of floats.
            is_array = isinstance(x, np.ndarray) and x.dtype == np.float64 and x.ndim == n_dims
            is_usual = is_array and x.shape[-1] == self.n_joints and x.size <= MAX_SIZE
            if not is_usual or (found and x.shape != expected):
                x = frozen_array(x, expected, "values of the joints", RobotError)
            expected = x.shape
            found.append(self._order.sorted(x))
        return found

    def _frame_ids(self, frames: Sequence[str]) -> list[int]:
        if isinstance(frames, str) or not isinstance(frames, Sequence):
            raise RobotError(f"frames must be a list of names of links, got {shown(frames)}")
        for name in frames:
            if not isinstance(name, str) or name not in self._ids:
                raise RobotError(f"{self._source}: {unknown_name('link', name, self.frame_names)}")
        return [self._ids[name] for name in frames]
