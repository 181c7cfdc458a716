# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinematics of a robot: positions of its frames, and their Jacobians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from .inertias import joint_of
from .pinocchio_model import JointOrder, PinocchioModel


class Kinematics(PinocchioModel):
    """Positions, pose errors and attached points of the links."""

    def frame_positions(self, q: FloatArray, frames: Sequence[str]) -> FloatArray:
        """Positions of frames in the base frame along a motion.

        Parameters
        ----------
        q : array, shape (n_steps, n_joints)
            Joint positions [rad or m].
        frames : sequence of str
            Names of n_frames frames (links).

        Returns
        -------
        points : array, shape (n_steps, n_frames, 3)
            Origins of the frames [m].

        Raises
        ------
        RobotError
            If there is no such frame, or the positions have another shape.
        """
        ids = self._frame_ids(frames)
        (q,) = self._in_order(q, n_dims=2)
        points = np.empty((len(q), len(ids), 3))
        for k, configuration in enumerate(q):
            pin.framesForwardKinematics(self._model, self._data, configuration)
            for i, frame in enumerate(ids):
                points[k, i] = self._data.oMf[frame].translation
        return points

    def chain_positions(self, q: FloatArray, frame: str) -> FloatArray:
        """Positions of the joints from the base to a frame, and of the frame, along a motion.

        Parameters
        ----------
        q : array, shape (n_steps, n_joints)
            Joint positions [rad or m].
        frame : str
            Name of the frame (link).

        Returns
        -------
        points : array, shape (n_steps, n_points, 3)
            Origin of the base, of each moving joint up to the frame, and of the frame [m].

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        (end,) = self._frame_ids([frame])
        joints = [joint_of(self._model.frames[end])]
        while joints[-1] > 0:
            joints.append(int(self._model.parents[joints[-1]]))
        (q,) = self._in_order(q, n_dims=2)
        points = np.empty((len(q), len(joints) + 1, 3))
        for k, configuration in enumerate(q):
            pin.framesForwardKinematics(self._model, self._data, configuration)
            for i, joint in enumerate(reversed(joints)):
                points[k, i] = self._data.oMi[joint].translation
            points[k, -1] = self._data.oMf[end].translation
        return points

    def attached_poses(
        self, q: FloatArray, frames: Sequence[str], origins: FloatArray
    ) -> FloatArray:
        """Poses in the base frame of what is attached to frames, along a motion.

        Parameters
        ----------
        q : array, shape (n_steps, n_joints)
            Joint positions [rad or m].
        frames : sequence of str
            Names of the frames (links), one for each of n_bodies bodies.
        origins : array, shape (n_bodies, 6)
            Places on them as a URDF states them: x, y, z [m], roll, pitch, yaw [rad].

        Returns
        -------
        poses : array, shape (n_steps, n_bodies, 7)
            Positions [m] and unit quaternions (x, y, z, w).

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        ids = self._frame_ids(frames)
        places = [pin.SE3(pin.rpy.rpyToMatrix(origin[3:]), origin[:3]) for origin in origins]
        poses = np.empty((len(q), len(ids), 7))
        for k, configuration in enumerate(self._order.sorted(q)):
            pin.framesForwardKinematics(self._model, self._data, configuration)
            for i, (frame, place) in enumerate(zip(ids, places, strict=True)):
                poses[k, i] = pin.SE3ToXYZQUAT(self._data.oMf[frame] * place)
        return poses

    def pose_error(
        self, frame: str, q: FloatArray, position: FloatArray, orientation: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Distance of a frame from a pose, and its derivative by the joints.

        Parameters
        ----------
        frame : str
            Name of the frame (link).
        q : array, shape (n_joints,)
            Joint positions [rad or m].
        position : array, shape (3,)
            Target position of its origin in the base frame [m].
        orientation : array, shape (4,), optional
            Its orientation, a unit quaternion (x, y, z, w); any unless given.

        Returns
        -------
        error : array, shape (3,) or (6,)
            Distance along the axes of the base frame [m], then the rotation vector from the
            expected to the actual orientation [rad].
        jacobian : array, shape (3 or 6, n_joints)
            Its derivative by the joint positions.

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        model, data, frame_id = self._model, self._data, self._frame_ids([frame])[0]
        pin.computeJointJacobians(model, data, self._order.sorted(np.reshape(q, -1)))
        placement = pin.updateFramePlacement(model, data, frame_id)
        aligned = pin.getFrameJacobian(
            model, data, frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        error, jacobian = placement.translation - position, aligned[:3]
        if orientation is not None:
            x, y, z, w = orientation
            expected = pin.Quaternion(w, x, y, z).toRotationMatrix()
            turned = expected.T @ placement.rotation
            own_axes = placement.rotation.T @ aligned[3:]
            error = np.concatenate([error, pin.log3(turned)])
            jacobian = np.concatenate([jacobian, pin.Jlog3(turned) @ own_axes])
        return error, np.array(self._order.restored(jacobian))

    def attach_points(self, frames: Sequence[str], offsets: FloatArray) -> AttachedPoints:
        """Fix points to frames; the result computes their positions and Jacobians.

        Parameters
        ----------
        frames : sequence of str
            Names of the frames (links), one for each of n_points points.
        offsets : array, shape (n_points, 3)
            Positions of the points in their frames [m].

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        model = self._model.copy()
        ids = []
        for i, (frame_id, offset) in enumerate(zip(self._frame_ids(frames), offsets, strict=True)):
            frame = model.frames[frame_id]
            placement = frame.placement * pin.SE3(np.eye(3), np.asarray(offset))
            kind = pin.FrameType.OP_FRAME
            ids.append(
                model.addFrame(pin.Frame(f"point {i}", joint_of(frame), frame_id, placement, kind))
            )
        return AttachedPoints(model, ids, self._order)


class AttachedPoints:
    """Points fixed to frames of a robot, made by :meth:`Kinematics.attach_points`."""

    def __init__(self, model: Any, ids: Sequence[int], order: JointOrder) -> None:
        self._model, self._data = model, model.createData()
        self._ids, self._order = list(ids), order

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return int(self._model.nv)

    def positions_and_jacobians(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions of the points in the base frame, and their derivatives by the joints.

        Parameters
        ----------
        q : array, shape (n_steps, n_joints)
            Joint positions [rad or m].

        Returns
        -------
        points : array, shape (n_steps, n_points, 3)
            Positions [m].
        jacobians : array, shape (n_steps, n_points, 3, n_joints)
            ∂points/∂q [m/rad, or 1].
        """
        model, data, ids = self._model, self._data, self._ids
        points = np.empty((len(q), len(ids), 3))
        jacobians = np.empty((len(q), len(ids), 3, self.n_joints))
        for q_k, points_k, jacobians_k in zip(
            self._order.sorted(q), points, jacobians, strict=True
        ):
            pin.computeJointJacobians(model, data, q_k)
            pin.updateFramePlacements(model, data)
            for i, frame in enumerate(ids):
                points_k[i] = data.oMf[frame].translation
                jacobians_k[i] = pin.getFrameJacobian(
                    model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
                )[:3]
        return points, self._order.restored(jacobians)
