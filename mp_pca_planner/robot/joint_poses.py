# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Poses of all joints of a model in many configurations at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray


@dataclass(frozen=True, eq=False)
class JointPoses:
    """Poses of the joints of a model in some configurations, in the base frame.

    Attributes
    ----------
    rotations : array, shape (n_configurations, n_joints + 1, 3, 3)
        Their orientations; the first is that of the base.
    positions : array, shape (n_configurations, n_joints + 1, 3)
        Their origins [m].
    """

    rotations: FloatArray
    positions: FloatArray


class JointTree:
    """The joints of a model, each with one degree of freedom.

    Parameters
    ----------
    model : pinocchio.Model
        The model.

    Attributes
    ----------
    axes : array, shape (n_joints + 1, 3)
        Axis of each joint in its own frame; 0 for the base.
    turns : array of bool, shape (n_joints + 1,)
        Whether each joint turns about its axis; otherwise it slides along it.
    order : array of int, shape (n_joints,)
        For each coordinate of a configuration, the joint's number, from 0 without the base.
    """

    def __init__(self, model: Any) -> None:
        n = model.njoints
        self._parents = [int(parent) for parent in model.parents]
        self._columns = [0, *(model.joints[j].idx_v for j in range(1, n))]
        self.order = np.argsort(self._columns[1:])
        placements = model.jointPlacements
        self._offsets = np.array([placements[j].translation for j in range(n)])
        fixed = np.array([placements[j].rotation for j in range(n)])
        self.axes, self.turns = self._axes(model)
        cross = np.cross(self.axes[:, None], np.eye(3)).transpose(0, 2, 1)
        # Rodrigues: R(q) = I + sin q · K + (1 − cos q) · K², after the fixed placement.
        self._by_sine, square = fixed @ cross, fixed @ cross @ cross
        self._by_sine[~self.turns] = square[~self.turns] = 0.0
        self._constant, self._by_cosine = fixed + square, -square
        self._slide = np.where(self.turns[:, None], 0.0, (fixed @ self.axes[:, :, None])[:, :, 0])

    def _axes(self, model: Any) -> tuple[FloatArray, NDArray[np.bool_]]:
        data, axes = model.createData(), np.zeros((model.njoints, 3))
        columns = pin.computeJointJacobians(model, data, np.zeros(model.nq))
        turns = np.zeros(model.njoints, dtype=bool)
        for j in range(1, model.njoints):
            column = columns[:, self._columns[j]]
            turns[j] = bool(np.any(column[3:]))
            axes[j] = data.oMi[j].rotation.T @ (column[3:] if turns[j] else column[:3])
        return axes, turns

    def poses(self, q: FloatArray) -> JointPoses:
        """Poses in configurations, shape (n_configurations, n_joints), in the model's order."""
        angles = q[:, self._columns, None]
        local = self._constant + self._by_sine * np.sin(angles)[..., None]
        local += self._by_cosine * np.cos(angles)[..., None]
        shifts = self._offsets + self._slide * angles
        rotations, positions = np.empty_like(local), np.empty_like(shifts)
        rotations[:, 0], positions[:, 0] = np.eye(3), 0.0
        for j, parent in list(enumerate(self._parents))[1:]:
            np.matmul(rotations[:, parent], local[:, j], out=rotations[:, j])
            moved = (rotations[:, parent] @ shifts[:, j, :, None])[..., 0]
            positions[:, j] = positions[:, parent] + moved
        return JointPoses(rotations, positions)
