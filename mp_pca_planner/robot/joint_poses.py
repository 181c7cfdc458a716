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
    order : array of int, shape (n_joints,)
        For each joint of the model's configurations, its index in configurations here.

    Attributes
    ----------
    order : array of int, shape (n_joints,)
        As given.
    axes : array, shape (n_joints + 1, 3)
        Axis of each joint in its own frame; 0 for the base.
    turns : array of bool, shape (n_joints + 1,)
        Whether each joint turns about its axis; otherwise it slides along it.
    joints : array of int, shape (n_joints,)
        For each coordinate of a configuration, the joint's number, from 0 without the base.
    moves : array, shape (n_joints + 1, n_joints)
        1 for each coordinate that moves a joint, else 0.
    """

    def __init__(self, model: Any, order: NDArray[np.intp]) -> None:
        self.order, n, placements = order, model.njoints, model.jointPlacements
        self._parents = [int(parent) for parent in model.parents]
        columns = [model.joints[j].idx_v for j in range(1, n)]
        self._columns = [0, *order[columns].tolist()]
        self.joints = np.argsort(self._columns[1:])
        self.moves = np.zeros((n, n - 1))
        for j in range(1, n):
            self.moves[j] = self.moves[self._parents[j]]
            self.moves[j, self._columns[j]] = 1.0
        self._offsets = np.array([placements[j].translation for j in range(n)])
        fixed = np.array([placements[j].rotation for j in range(n)])
        self.axes, self.turns = _axes(model, columns)
        ends = np.abs([model.lowerPositionLimit, model.upperPositionLimit])
        slides = np.append(0.0, ends.max(axis=0)[columns])
        self._lengths = np.linalg.norm(self._offsets, axis=1) + np.where(self.turns, 0.0, slides)
        cross = np.cross(self.axes[:, None], np.eye(3)).transpose(0, 2, 1)
        # Rodrigues: R(q) = I + sin q · K + (1 − cos q) · K², after the fixed placement.
        self._by_sine, square = fixed @ cross, fixed @ cross @ cross
        self._by_sine[~self.turns] = square[~self.turns] = 0.0
        self._constant, self._by_cosine = fixed + square, -square
        self._slide = np.where(self.turns[:, None], 0.0, (fixed @ self.axes[:, :, None])[:, :, 0])

    def levers(self, joint: int, reach: float) -> FloatArray:
        """Largest speeds of a point by the joints that move it, shape (n_joints,).

        For a joint that turns, the longest path from it along the links to the point [m]; for one
        that slides, 1.

        Parameters
        ----------
        joint : int
            The joint that the point moves with; 0 for the base.
        reach : float
            Its distance from the origin of that joint [m].
        """
        row = np.zeros(len(self.joints))
        while joint > 0:
            row[self._columns[joint]] = reach if self.turns[joint] else 1.0
            reach += float(self._lengths[joint])
            joint = self._parents[joint]
        return row

    def poses(self, q: FloatArray) -> JointPoses:
        """Poses in some configurations, shape (n_configurations, n_joints)."""
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


def _axes(model: Any, columns: list[int]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Axes of the joints, and whether they turn."""
    data, axes = model.createData(), np.zeros((model.njoints, 3))
    jacobians = pin.computeJointJacobians(model, data, np.zeros(model.nq))
    turns = np.zeros(model.njoints, dtype=bool)
    for j, column in enumerate(jacobians.T[columns], start=1):
        turns[j] = bool(np.any(column[3:]))
        axes[j] = data.oMi[j].rotation.T @ (column[3:] if turns[j] else column[:3])
    return axes, turns
