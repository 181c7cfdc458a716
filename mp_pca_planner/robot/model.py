# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot model (block 1 of [P] Fig. 1): a URDF, a choice of joints, and their dynamics.

Pinocchio computes everything; this module fixes which joints are meant and in which
order, translates its errors, and runs it over whole motions.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import RobotError, quote_names, unknown_name
from ..files import read_text, reading
from .inertias import inertia_flaws, joint_of
from .limits import JointLimits, Overrides, merge_limits
from .link_inertias import LinkInertias
from .urdf import read_description

_NOT_A_LINK = " (joint)"


class Robot:
    """Rigid-body model of some joints of a robot, the others locked.

    Parameters
    ----------
    urdf : str
        The robot description, XML text.
    joint_names : sequence of str, optional
        The joints that move, in the order of every array of this class. All movable
        joints but those that mimic others, in the order of the kinematic tree, unless given.
    locked : mapping, optional
        Positions [rad or m] of joints that don't move; 0 (or the nearest limit) unless given.
    source : str
        How messages call the description.

    Attributes
    ----------
    name : str
        The robot's name in its description.
    joint_names : tuple of str
        The joints, n_joints of them.
    continuous : array of bool, shape (n_joints,)
        Which joints turn without end.
    prismatic_joints : tuple of str
        Those of `joint_names` that are measured in metres.
    movable_joints : tuple of str
        All movable joints of the description, in the order of the kinematic tree.
    frame_names : tuple of str
        Links, the frames that can be asked for.

    Raises
    ------
    RobotError
        If the description is no URDF, or a joint is unknown or can't move.
    """

    def __init__(
        self,
        urdf: str,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
        source: str = "robot description",
    ) -> None:
        found = read_description(urdf, source)
        self._source, self.name, self._urdf_limits = source, found.name, found.limits
        try:
            full = pin.buildModelFromXML(found.xml)
        except (ValueError, RuntimeError) as error:
            raise RobotError(f"{source} is refused by Pinocchio: {error}") from None
        self.movable_joints = tuple(name for name in full.names if name in found.types)
        driven = [name for name in self.movable_joints if name not in found.mimics]
        self.joint_names = self._checked(driven if joint_names is None else joint_names)
        self._full, self._description = full, found
        model = self._lock_others(full, dict(locked or {}))
        self._inertia_flaws, unknown = inertia_flaws(model, found)
        for joint in unknown:  # what can't be computed shall not look like 0
            model.inertias[joint] = pin.Inertia(np.nan, np.zeros(3), np.zeros((3, 3)))
        self._use(model)
        kinds = [found.types[name] for name in self.joint_names]
        self.continuous = np.array([kind == "continuous" for kind in kinds])
        self.continuous.setflags(write=False)
        self.prismatic_joints = tuple(
            name for name, kind in zip(self.joint_names, kinds, strict=True) if kind == "prismatic"
        )
        self.frame_names = tuple(f.name for f in self._model.frames if f.type == pin.FrameType.BODY)
        # Position of each of our joints in Pinocchio's vectors, and the other way round.
        self._to_pin = np.array(
            [self._model.joints[self._model.getJointId(n)].idx_v for n in self.joint_names]
        )
        self._from_pin = np.argsort(self._to_pin)
        self._in_order = bool(np.array_equal(self._to_pin, np.arange(self.n_joints)))
        self._mirror_mass_matrix = not self._mass_matrix_is_whole()

    def _use(self, model: Any) -> None:
        """Take a model, with data and results of its own."""
        self._model = model
        self._data = model.createData()
        # Views of what computeRNEADerivatives fills in, made once: making them takes as long
        # as the call itself.
        data = self._data
        self._results = (data.dtau_dq, data.dtau_dv, data.M, data.tau)
        self._pool: Any = pin.ModelPool(model, 1) if hasattr(pin, "rneaInParallel") else None

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
    ) -> Robot:
        """Read the robot description from a URDF file (see the class)."""
        with reading(f"the URDF file '{path}'", RobotError):
            urdf = read_text(path)
        return cls(urdf, joint_names, locked=locked, source=f"URDF file '{path}'")

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self.joint_names)

    @property
    def described_joints(self) -> tuple[str, ...]:
        """The joints that move, in the order of the robot description."""
        return tuple(name for name in self.movable_joints if name in self.joint_names)

    def limits(self, *overrides: Overrides) -> JointLimits:
        """Limits of the joints: the URDF's, with the overrides laid over them in turn.

        Raises
        ------
        LimitsError
            If what results is no usable limit, for example a velocity limit of 0.
        """
        return JointLimits(
            self.joint_names,
            merge_limits(self._urdf_limits, *overrides),
            source=f"limits of the {self._source}",
        )

    def require_inertias(self, purpose: str, instead: str = "") -> None:
        """Refuse a robot for something that takes the efforts of its joints.

        Parameters
        ----------
        purpose : str
            What takes efforts, in the plural.
        instead : str
            What can be done about it but to correct the description.

        Raises
        ------
        RobotError
            If a moving link has no valid inertia.
        """
        if not self._inertia_flaws:
            return
        links: dict[str, list[str]] = {}
        for link, flaw in self._inertia_flaws.items():
            links.setdefault(flaw, []).append(link)
        wrong = ", ".join(f"{quote_names(names)} ({flaw})" for flaw, names in links.items())
        remedy = f", or {instead}" if instead else ""
        raise RobotError(
            f"{self._source}: {purpose} need the inertia of every moving link, but these have no "
            f"valid one: {wrong}; give each an <inertial> with a positive mass and a positive "
            "definite inertia tensor, of which no principal moment exceeds the sum of the others"
            + remedy
        )

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of a motion, NaN where the inertia of a moving link is not known.

        Parameters
        ----------
        q, v, a : array, shape (n_steps, n_joints)
            Positions [rad or m], velocities [/s] and accelerations [/s²].

        Returns
        -------
        tau : array, shape (n_steps, n_joints)
            Joint torques [N·m] or forces [N].
        """
        q, v, a = (self._arranged(x) for x in (q, v, a))
        if self._pool is not None:
            tau = np.empty(q.shape)
            pin.rneaInParallel(1, self._pool, q.T, v.T, a.T, tau.T)
        else:  # Pinocchio built without OpenMP
            rows = [pin.rnea(self._model, self._data, *x) for x in zip(q, v, a, strict=True)]
            tau = np.array(rows).reshape(q.shape)
        return tau if self._in_order else tau[:, self._to_pin]

    def known_efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray | None:
        """The same, or None if some of them are not known."""
        tau = self.inverse_dynamics(q, v, a)
        return None if np.isnan(tau).any() else tau

    def inverse_dynamics_derivatives(
        self, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Efforts of a motion and their derivatives.

        Parameters
        ----------
        q, v, a : array, shape (n_steps, n_joints)
            Positions [rad or m], velocities [/s] and accelerations [/s²].

        Returns
        -------
        tau : array, shape (n_steps, n_joints)
            Joint torques [N·m] or forces [N].
        dtau : array, shape (n_steps, n_joints, 3 n_joints)
            ∂τ/∂q, ∂τ/∂q̇ and ∂τ/∂q̈ (the mass matrix) side by side.
        """
        n = self.n_joints
        q, v, a = (self._arranged(x) for x in (q, v, a))
        tau = np.empty((len(q), n))
        dtau = np.empty((len(q), 3, n, n))  # filled block by block: the innermost loop of planning
        model, data, derivatives = self._model, self._data, pin.computeRNEADerivatives
        by_q, by_v, by_a, efforts = self._results
        for q_k, v_k, a_k, dtau_k, tau_k in zip(q, v, a, dtau, tau, strict=True):
            derivatives(model, data, q_k, v_k, a_k)
            dtau_k[0], dtau_k[1], dtau_k[2] = by_q, by_v, by_a
            tau_k[:] = efforts
        if self._mirror_mass_matrix:
            upper = np.triu(dtau[:, 2])
            dtau[:, 2] = upper + np.triu(upper, 1).transpose(0, 2, 1)
        if not self._in_order:
            tau = tau[:, self._to_pin]
            dtau = dtau[:, :, self._to_pin][..., self._to_pin]
        return tau, dtau.transpose(0, 2, 1, 3).reshape(len(q), n, 3 * n)

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Joint-space mass matrix [kg·m²] of one configuration, shape (n_joints, n_joints)."""
        zero = np.zeros((1, self.n_joints))
        _, dtau = self.inverse_dynamics_derivatives(np.reshape(q, (1, -1)), zero, zero)
        return dtau[0, :, 2 * self.n_joints :]

    def pinocchio_model(self) -> tuple[Any, NDArray[np.intp]]:
        """Pinocchio's model of the joints that move, and where each joint is in its vectors."""
        return self._model.copy(), self._to_pin

    def motion_equation(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mass matrix and bias efforts of one state: τ = M q̈ + h, the fast way.

        Parameters
        ----------
        q, v : array, shape (n_joints,)
            Positions [rad or m] and velocities [/s].

        Returns
        -------
        M : array, shape (n_joints, n_joints)
            The mass matrix; only its upper triangle is sure to be filled.
        h : array, shape (n_joints,)
            Efforts that gravity, centrifugal and Coriolis forces ask for.
        """
        model, data, back, there = self._model, self._data, self._from_pin, self._to_pin
        if self._in_order:
            return pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)
        M = np.triu(pin.crba(model, data, q[back]))
        M = M + np.triu(M, 1).T
        return M[np.ix_(there, there)], pin.nonLinearEffects(model, data, q[back], v[back])[there]

    def gravity_efforts(self, q: FloatArray) -> FloatArray:
        """Efforts that hold the robot still in one configuration, shape (n_joints,)."""
        if self._in_order:
            return np.asarray(pin.computeGeneralizedGravity(self._model, self._data, q))
        g = pin.computeGeneralizedGravity(self._model, self._data, q[self._from_pin])
        return np.asarray(g[self._to_pin])

    def forward_dynamics(self, q: FloatArray, v: FloatArray, tau: FloatArray) -> FloatArray:
        """Accelerations [/s²] of one state under efforts, all of shape (n_joints,).

        By Featherstone's articulated-body algorithm.
        """
        if self._in_order:
            return np.asarray(pin.aba(self._model, self._data, q, v, tau))
        back = self._from_pin
        a = pin.aba(self._model, self._data, q[back], v[back], tau[back])
        return np.asarray(a[self._to_pin])

    def with_inertias(
        self, scales: FloatArray, payload: float = 0.0, frame: str | None = None
    ) -> Robot:
        """The same robot with other inertias.

        Parameters
        ----------
        scales : array, shape (n_joints,)
            Factor of the mass and the inertia of what each joint carries up to the next ones.
        payload : float
            Mass of a point added at the origin of a frame [kg].
        frame : str, optional
            The frame (link); the last one unless given.

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        (frame_id,) = self._frame_ids([self.frame_names[-1] if frame is None else frame])
        model = self._model.copy()
        for joint, scale in enumerate(np.asarray(scales)[self._from_pin], start=1):
            inertia = model.inertias[joint]
            model.inertias[joint] = pin.Inertia(
                inertia.mass * scale, inertia.lever, inertia.inertia * scale
            )
        carrier = model.frames[frame_id]
        joint = joint_of(carrier)
        point = pin.Inertia(payload, carrier.placement.translation, np.zeros((3, 3)))
        if joint > 0 and payload != 0.0:
            model.inertias[joint] = model.inertias[joint] + point
        other = copy.copy(self)
        other._use(model)
        return other

    @cached_property
    def link_inertias(self) -> LinkInertias:
        """Masses and principal moments of inertia of the links that the joints move."""
        return LinkInertias.of(self._description.xml, self._model)

    def with_link_inertias(self, factors: FloatArray) -> Robot:
        """The same robot with other links.

        Parameters
        ----------
        factors : array, shape (n_links, 4)
            Of the mass and of the three principal moments of inertia about the centre of mass,
            of each link of `link_inertias`.
        """
        model = self._model.copy()
        self.link_inertias.change(model, factors)
        other = copy.copy(self)
        other.__dict__.pop("link_inertias", None)
        other._use(model)
        return other

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
            If there is no such frame.
        """
        ids = self._frame_ids(frames)
        points = np.empty((len(q), len(ids), 3))
        for k, configuration in enumerate(self._arranged(q)):
            pin.framesForwardKinematics(self._model, self._data, configuration)
            for i, frame in enumerate(ids):
                points[k, i] = self._data.oMf[frame].translation
        return points

    def pose_error(
        self,
        frame: str,
        q: FloatArray,
        position: FloatArray,
        orientation: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """How far a frame is from a pose, and how that changes with the joints.

        Parameters
        ----------
        frame : str
            Name of the frame (link).
        q : array, shape (n_joints,)
            Joint positions [rad or m].
        position : array, shape (3,)
            Where its origin should be in the base frame [m].
        orientation : array, shape (4,), optional
            Its orientation, a unit quaternion (x, y, z, w); any unless given.

        Returns
        -------
        error : array, shape (3,) or (6,)
            Distance along the axes of the base frame [m], then the rotation vector from the
            wanted to the actual orientation [rad].
        jacobian : array, shape (3 or 6, n_joints)
            Its derivative by the joint positions.

        Raises
        ------
        RobotError
            If there is no such frame.
        """
        model, data, frame_id = self._model, self._data, self._frame_ids([frame])[0]
        pin.computeJointJacobians(model, data, self._arranged(np.reshape(q, (1, -1)))[0])
        placement = pin.updateFramePlacement(model, data, frame_id)
        aligned = pin.getFrameJacobian(
            model, data, frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        error, jacobian = placement.translation - position, aligned[:3]
        if orientation is not None:
            wanted = pin.Quaternion(*np.roll(orientation, 1)).toRotationMatrix()
            turned = wanted.T @ placement.rotation
            own_axes = placement.rotation.T @ aligned[3:]
            error = np.concatenate([error, pin.log3(turned)])
            jacobian = np.concatenate([jacobian, pin.Jlog3(turned) @ own_axes])
        return error, np.array(jacobian[:, self._to_pin])

    def attach_points(self, frames: Sequence[str], offsets: FloatArray) -> AttachedPoints:
        """Fix points to frames, to ask where they are and how they move with the joints.

        Parameters
        ----------
        frames : sequence of str
            Names of the frames (links), one for each of n_points points.
        offsets : array, shape (n_points, 3)
            Where the points are in their frames [m].

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
        return AttachedPoints(model, ids, self._to_pin, self._from_pin)

    def collision_geometry(self, package_dirs: Sequence[Path]) -> tuple[Any, Any, NDArray[np.intp]]:
        """Pinocchio's model, the collision geometry of the links, and the order of the joints.

        Parameters
        ----------
        package_dirs : sequence of Path
            Folders in which packages of ``package://`` paths of meshes are.

        Returns
        -------
        model : pinocchio.Model
            The model of the joints that move.
        geometry : pinocchio.GeometryModel
            Its collision geometry, with the pairs of links that are no neighbours: more than one
            joint is between them, locked ones included.
        order : array of int, shape (n_joints,)
            For each joint of the model, which of `joint_names` it is.

        Raises
        ------
        RobotError
            If a shape can't be used, or a mesh can't be found or read.
        """
        for link, problem in self._description.lost_shapes.items():
            raise RobotError(f"{self._source}: <collision> of link '{link}': {problem}")
        folders = [str(folder) for folder in package_dirs]
        kind = pin.GeometryType.COLLISION
        try:
            whole = pin.buildGeomFromUrdfString(
                self._full, self._description.xml, kind, package_dirs=folders
            )
        except (ValueError, RuntimeError) as error:
            looked_in = f"is looked for in {quote_names(folders)}" if folders else "has to be given"
            raise RobotError(
                f"the collision geometry of the {self._source} can't be read: "
                f"{str(error).rstrip('.')}; the folder in which such a package is {looked_in} "
                "(package_dirs)"
            ) from None
        above, objects = self._full.parents, whole.geometryObjects
        for first, second in combinations(range(whole.ngeoms), 2):
            a, b = objects[first].parentJoint, objects[second].parentJoint
            if a not in (b, above[b]) and b != above[a]:
                whole.addCollisionPair(pin.CollisionPair(first, second))
        model, (geometry,) = _reduced(self._full, [whole], self._others, self._reference)
        return model, geometry, self._from_pin

    def _checked(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        names = unique_names(joint_names, f"joints of the {self._source}", RobotError)
        for name in names:
            if name not in self.movable_joints:
                raise RobotError(
                    f"{self._source}: {unknown_name('movable joint', name, self.movable_joints)}"
                )
        return names

    def _frame_ids(self, frames: Sequence[str]) -> list[int]:
        for name in frames:
            if name not in self.frame_names:
                raise RobotError(f"{self._source}: {unknown_name('link', name, self.frame_names)}")
        return [self._model.getFrameId(name, pin.FrameType.BODY) for name in frames]

    def _arranged(self, x: FloatArray) -> FloatArray:
        return np.ascontiguousarray(x if self._in_order else x[:, self._from_pin])

    def _lock_others(self, full: Any, locked: dict[str, float]) -> Any:
        both = sorted(set(locked) & set(self.joint_names))
        if both:
            raise RobotError(f"{quote_names(both)} can't be locked and move at the same time")
        reference = pin.neutral(full)
        for name in self.movable_joints:
            joint = full.joints[full.getJointId(name)]
            low, high = full.lowerPositionLimit[joint.idx_q], full.upperPositionLimit[joint.idx_q]
            reference[joint.idx_q] = np.clip(0.0, low, high)
        for name, value in locked.items():
            if name not in self.movable_joints:
                raise RobotError(
                    f"{self._source}: {unknown_name('movable joint', name, self.movable_joints)}"
                )
            position = frozen_array(value, (), f"position of locked joint '{name}'", RobotError)
            reference[full.joints[full.getJointId(name)].idx_q] = position
        others = [i for i, name in enumerate(full.names) if i > 0 and name not in self.joint_names]
        self._others, self._reference = others, reference
        return _reduced(full, [], others, reference)[0]

    def _mass_matrix_is_whole(self) -> bool:
        """Whether Pinocchio fills both triangles of M (releases before 3.0 fill the upper one)."""
        q = np.linspace(0.3, 0.7, self.n_joints)
        zero = np.zeros(self.n_joints)
        pin.computeRNEADerivatives(self._model, self._data, q, zero, zero)
        return bool(np.allclose(self._data.M, self._data.M.T))


class AttachedPoints:
    """Points fixed to frames of a robot, made by :meth:`Robot.attach_points`."""

    def __init__(self, model: Any, ids: Sequence[int], to_pin: Any, from_pin: Any) -> None:
        self._model = model
        self._data = model.createData()
        self._ids = list(ids)
        self._to_pin = to_pin
        self._from_pin = from_pin

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self._to_pin)

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
        for q_k, points_k, jacobians_k in zip(q[:, self._from_pin], points, jacobians, strict=True):
            pin.computeJointJacobians(model, data, q_k)
            pin.updateFramePlacements(model, data)
            for i, frame in enumerate(ids):
                points_k[i] = data.oMf[frame].translation
                jacobians_k[i] = pin.getFrameJacobian(
                    model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
                )[:3]
        return points, jacobians[..., self._to_pin]


def _reduced(full: Any, geometries: list[Any], locked: list[int], reference: Any) -> Any:
    """The model without locked joints, and geometries of its links.

    Pinocchio finds frames by name there, and some joints are called as a link: they get other names
    meanwhile.
    """
    if not locked:
        return full, geometries
    links = {frame.name for frame in full.frames if frame.type == pin.FrameType.BODY}
    model = full.copy()
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name += _NOT_A_LINK
    for joint, name in enumerate(full.names):
        model.names[joint] = name + _NOT_A_LINK if name in links else name
    reduced, geometries = pin.buildReducedModel(model, geometries, locked, reference)
    for joint, name in enumerate(list(reduced.names)):
        reduced.names[joint] = name.removesuffix(_NOT_A_LINK)
    return reduced, geometries
