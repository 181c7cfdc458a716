# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot model (block 1 of [P] Fig. 1): a URDF, a choice of joints, and their dynamics."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, check_number, frozen_array, unique_names
from ..exceptions import RobotError, quote_names, unknown_name
from ..files import read_text, reading
from ..lazy import LazyModule
from .bodies import Bodies
from .examples import EXAMPLE_ROBOTS, example_file
from .inertias import effort_slopes, inertia_flaws, scaled_inertias
from .joints import JointOrder, positions_with_mimics, reduced_model
from .limits import DRIVE_KEYS, JointLimits, Overrides, given_limits, merge_limits
from .urdf import read_description

pin = LazyModule("pinocchio")

FRICTION_SPEED = 0.02
"""Velocity v₀ at which smoothed Coulomb friction reaches three quarters of its size [/s]."""


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
        Positions [rad or m] of locked joints; 0 (or the nearest limit) unless given. Those of
        joints that mimic one of these follow from it.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    name : str
        The robot's name in its description.
    joint_names : tuple of str
        The joints that move.
    n_joints : int
        Their number.
    continuous : array of bool, shape (n_joints,)
        Whether each joint turns without end.
    prismatic_joints : tuple of str
        The joints of `joint_names` that are measured in metres.
    locked_positions : mapping of str to float
        The known positions of locked joints [rad or m]; others count as 0.
    movable_joints : tuple of str
        All movable joints of the description, in the order of the kinematic tree.
    armature, damping, friction : array, shape (n_joints,)
        Drives of the joints, see :meth:`with_drives`; 0 where they are not known.
    drives : mapping
        The same of all movable joints, among their limits.
    frame_names, end_effector : tuple of str, str
        The links, and the last one of those that most joints move.
    urdf : str
        The robot description.
    description : Description
        What it states of all joints and links.
    path : Path or None
        The file that the description was read from.

    Raises
    ------
    RobotError
        If the description is no URDF, or a joint is unknown or can't move.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> robot = mp.Robot.from_file(mp.config_file("human_arm.urdf"))
    >>> robot
    Robot 'human_arm': shoulder1, shoulder2, shoulder3, elbow
    >>> robot.frame_positions([[0.0, 0.0, 0.0, 0.0]], ["wrist"]).round(2).tolist()
    [[[-0.02, -0.17, -0.57]]]
    """

    def __init__(
        self,
        urdf: str,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
        source: str = "robot description",
    ) -> None:
        self._source, self.urdf, self._given_locks = source, urdf, dict(locked or {})
        self.path: Path | None = None
        self.description = description = read_description(urdf, source)
        self.name = description.name
        movable = (name for name in description.model.names if name in description.types)
        self.movable_joints = tuple(movable)
        driven = [name for name in self.movable_joints if name not in description.mimics]
        names = driven if joint_names is None else joint_names
        names = _movable(names, self.movable_joints, source)
        if both := sorted(set(locked or ()) & set(names)):
            raise RobotError(f"{quote_names(both)} can't be locked and move at the same time")
        if locked:
            _movable(tuple(locked), self.movable_joints, source)
        self.locked_positions: Mapping[str, float] = positions_with_mimics(
            self._given_locks, names, description
        )
        model = reduced_model(description.model, names, self.locked_positions)
        self._inertia_flaws, unknown = inertia_flaws(model, description)
        for joint in unknown:  # efforts that can't be computed become NaN, not 0
            model.inertias[joint] = pin.Inertia(np.nan, np.zeros(3), np.zeros((3, 3)))
        self.joint_names, self.n_joints = names, len(names)
        self._order = JointOrder(model, names)
        links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
        self.frame_names = tuple(link.name for link in links)
        # The number of joints that move a link is that of those that support its own.
        depths = [len(model.supports[link.parentJoint]) for link in reversed(links)]
        self.end_effector = links[-1 - int(np.argmax(depths))].name
        types = description.types
        self.continuous = np.array([types[name] == "continuous" for name in names])
        self.continuous.setflags(write=False)
        self.prismatic_joints = tuple(name for name in names if types[name] == "prismatic")
        self.drives: Overrides = description.limits
        self._use(model)

    def _use(self, model: Any) -> None:
        """Compute with another model of the same joints and frames."""
        drives = [self.drives.get(name, {}) for name in self.joint_names]
        self.armature, self.damping, self.friction = (
            frozen_array([drive.get(key, 0.0) for drive in drives], (None,), key, RobotError)
            for key in DRIVE_KEYS
        )
        self._has_drag = bool(self.damping.any() or self.friction.any())
        model.armature = self._order.sorted(self.armature)
        self._model, body = model, pin.FrameType.BODY
        self._ids = {name: model.getFrameId(name, body) for name in self.frame_names}
        self._data = data = model.createData()
        # Views of the results, made once: making them takes as long as the call itself.
        self._results = (data.dtau_dq, data.dtau_dv, data.M, data.tau)
        self._pool: Any = pin.ModelPool(model, 1) if hasattr(pin, "rneaInParallel") else None
        self._slopes: Callable[..., FloatArray] | None = None

    def _with_model(self, model: Any) -> Robot:
        other = copy.copy(self)
        other._use(model)
        return other

    def __repr__(self) -> str:
        return f"Robot '{self.name}': {', '.join(self.joint_names)}"

    @classmethod
    def example(cls, name: str) -> Robot:
        """A robot to try the package with.

        Parameters
        ----------
        name : str
            `human_arm`, or with the extra 'example' `panda`, `ur3`, `ur5`, `ur10`, `kinova`,
            `xarm7`, `z1`, `so100` or `so101`.

        Raises
        ------
        RobotError
            If there is no example of that name.
        MissingDependencyError
            If example-robot-data is not installed.

        Examples
        --------
        >>> import mp_pca_planner as mp
        >>> mp.Robot.example("human_arm").joint_names
        ('shoulder1', 'shoulder2', 'shoulder3', 'elbow')
        """
        return cls.from_file(*example_file(name))

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
    ) -> Robot:
        """Read the robot description from a URDF file (see the class)."""
        path = Path(path)
        with reading(f"the URDF file {str(path)!r}", RobotError):
            if str(path) in EXAMPLE_ROBOTS and not path.exists():
                raise RobotError(
                    f"there is no URDF file '{path}': `mp-pca demo {path} --files` writes that of "
                    f"the example, and Robot.example('{path}') is it in Python"
                )
            urdf = read_text(path)
        robot = cls(urdf, joint_names, locked=locked, source=f"URDF file '{path}'")
        robot.path = path
        return robot

    @property
    def position_unit(self) -> str:
        """Unit of positions for messages: ``rad``, or ``rad or m`` where joints are prismatic."""
        return "rad or m" if self.prismatic_joints else "rad"

    @property
    def described_joints(self) -> tuple[str, ...]:
        """The joints that move, in the order of the robot description."""
        return tuple(name for name in self.movable_joints if name in self.joint_names)

    def locked_at(self, positions: Mapping[str, float]) -> Robot:
        """The robot with other positions of the joints that do not move [rad or m]."""
        return self._read_again(self.joint_names, positions)

    def limits(self, *overrides: Overrides | str | Path) -> JointLimits:
        """Limits of the joints: those of the URDF, replaced by mappings or limits files in turn.

        Parameters
        ----------
        overrides : mapping or path
            Limits by joint and key, or files like MoveIt's joint_limits.yaml.

        Raises
        ------
        LimitsError
            If an override can't be used, or a limit is invalid, such as a velocity limit of 0.
        """
        layers = (given_limits(layer, self.movable_joints) for layer in overrides)
        return JointLimits(
            self.joint_names,
            merge_limits(self.description.limits, *layers),
            source=f"limits of the {self._source}",
        )

    def position_ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest position of each joint that the URDF states [rad or m], by name."""
        ranges, stated = {}, self.description.limits
        for name in self.joint_names:
            ends = ("min_position", -np.inf), ("max_position", np.inf)
            low, high = (stated[name].get(key, usual) for key, usual in ends)
            if low < high:
                ranges[name] = low, high
        return ranges

    def with_joints(self, joint_names: Sequence[str]) -> Robot:
        """The robot with these joints moving; itself, if they are its own in this order.

        Raises
        ------
        RobotError
            If a joint is unknown or can't move.
        """
        joint_names = unique_names(joint_names, "joints of the robot", RobotError)
        if joint_names == self.joint_names:
            return self
        locks = {name: x for name, x in self._given_locks.items() if name not in joint_names}
        return self._read_again(joint_names, locks)

    def _read_again(self, joint_names: Sequence[str], locked: Mapping[str, float]) -> Robot:
        """The robot with other joints moving, or others locked."""
        robot = Robot(self.urdf, joint_names, locked=locked, source=self._source)
        robot.path, robot.drives = self.path, self.drives
        robot._use(robot._model)
        return robot

    def require_inertias(self, purpose: str, instead: str = "") -> None:
        """Reject a robot whose efforts can't be computed.

        Parameters
        ----------
        purpose : str
            The feature that needs the efforts, in the plural, for the message.
        instead : str
            An alternative to correcting the description, for the message.

        Raises
        ------
        RobotError
            If a moving link has no valid inertia.
        """
        if not self._inertia_flaws:
            return
        alternative = f", or {instead}" if instead else ""
        raise RobotError(
            f"{self._source}: {purpose} need the inertia of every moving link, but these have no "
            f"valid one: {quote_names(self._inertia_flaws)}; give each an <inertial> with a "
            "positive mass and a positive definite inertia tensor, of which no principal moment "
            f"exceeds the sum of the others{alternative}"
        )

    def pinocchio_model(self) -> tuple[Any, NDArray[np.intp]]:
        """Pinocchio's model of the joints that move, and the index of each joint in its vectors."""
        return self._model.copy(), self._order.to_pin

    def with_payload(self, mass: float) -> Robot:
        """The same robot with a point mass [kg] at the end effector.

        Raises
        ------
        RobotError
            If the mass is no number of at least 0.
        """
        (frame_id,) = self._frame_ids([self.end_effector])
        check_number(mass, "the mass of a payload [kg]", RobotError, 0.0, 1e9)
        model = self._model.copy()
        carrier = model.frames[frame_id]
        joint = carrier.parentJoint
        if joint > 0 and mass != 0.0:
            point = pin.Inertia(float(mass), carrier.placement.translation, np.zeros((3, 3)))
            model.inertias[joint] = model.inertias[joint] + point
        return self._with_model(model)

    @cached_property
    def link_inertias(self) -> Mapping[str, Any]:
        """Inertias of the links that the joints move, in the frames of the links."""
        frames = [self._model.frames[i] for i in self._ids.values()]
        moved = {frame.name for frame in frames if frame.parentJoint > 0}
        return {name: x for name, x in self.description.inertias.items() if name in moved}

    def with_drives(self, *overrides: Overrides | str | Path) -> Robot:
        """The same robot with other drives, which its efforts include.

        Parameters
        ----------
        overrides : mapping or path
            Values of joints by name: `armature`, the inertia of the rotor times the squared gear
            ratio [kg·m² or kg]; `damping`, viscous [N·m·s/rad or N·s/m]; `friction`, Coulomb's
            [N·m or N]. Damping and friction of the robot description hold unless given. Limits in
            the same mapping or limits file are for :meth:`limits`.

        Raises
        ------
        LimitsError
            If a file can't be read, a joint is unknown, or a value is no number of at least 0.

        Examples
        --------
        >>> import mp_pca_planner as mp
        >>> robot = mp.Robot.from_file(mp.config_file("human_arm.urdf"))
        >>> robot.with_drives({"elbow": {"armature": 0.01, "friction": 0.2}}).effort_parts
        'rigid bodies, rotor inertia, Coulomb friction (smoothed by tanh(v / 0.02 per s))'
        """
        layers = (given_limits(layer, self.movable_joints) for layer in overrides)
        other = copy.copy(self)
        other.drives = merge_limits(self.drives, *layers)
        other._use(self._model.copy())
        return other

    def with_link_inertias(self, factors: FloatArray) -> Robot:
        """The robot of the description with other masses and moments of inertia, without a payload.

        Parameters
        ----------
        factors : array, shape (n_links, 4)
            Factors of the mass and of the three principal moments of inertia about the centre of
            mass of each link of `link_inertias`.
        """
        return self._with_model(scaled_inertias(self._model, self.link_inertias, factors))

    def link_bodies(self, package_dirs: Sequence[Path]) -> Bodies:
        """The collision shapes of the links.

        Parameters
        ----------
        package_dirs : sequence of Path
            Folders of the packages that ``package://`` paths of meshes name.

        Raises
        ------
        RobotError
            If a shape can't be used, or a mesh can't be found or read.
        """
        return Bodies.of_links(self._model, self.description, package_dirs, self._source)

    # Dynamics

    @property
    def effort_parts(self) -> str:
        """The parts of the efforts that are known, for reports."""
        words = {
            "rotor inertia": self.armature,
            "viscous damping": self.damping,
            f"Coulomb friction (smoothed by tanh(v / {FRICTION_SPEED:g} per s))": self.friction,
        }
        return ", ".join(["rigid bodies", *(word for word, x in words.items() if x.any())])

    def drag(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Efforts of damping and of Coulomb friction at velocities, shapes as those of `v`.

        Friction is smoothed to f tanh(v / v₀) with v₀ = `FRICTION_SPEED`.
        """
        return self.damping * v, self.friction * np.tanh(v / FRICTION_SPEED)

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of the drives in a motion: of rigid bodies, rotors, damping and friction.

        They are NaN where the inertia of a moving link is not known.

        Parameters
        ----------
        q, v, a : array, shape (n_steps, n_joints)
            Positions [rad or m], velocities [/s] and accelerations [/s²].

        Returns
        -------
        tau : array, shape (n_steps, n_joints)
            Joint torques [N·m] or forces [N].
        """
        velocities = v
        q, v, a = self._order.checked(q, v, a, n_dims=2)
        if self._pool is not None:
            tau = np.empty(q.shape)
            pin.rneaInParallel(1, self._pool, q.T, v.T, a.T, tau.T)
        else:  # Pinocchio built without OpenMP
            rows = [pin.rnea(self._model, self._data, *x) for x in zip(q, v, a, strict=True)]
            tau = np.array(rows).reshape(q.shape)
        tau = self._order.restored(tau)
        return tau + sum(self.drag(velocities)) if self._has_drag else tau

    def effort_slopes(
        self, q: FloatArray, v: FloatArray, a: FloatArray, jerk: FloatArray
    ) -> FloatArray:
        """Upper bounds of the rates of change of efforts, see :func:`.effort_slopes`.

        Parameters
        ----------
        q, v, a, jerk : array, shape (n_steps, n_joints)
            Largest magnitudes of positions [rad or m] and their derivatives in each of several
            intervals.

        Returns
        -------
        slopes : array, shape (n_steps, n_joints)
            Bounds of the magnitude of dτ/dt [N·m/s or N/s].
        """
        if self._slopes is None:
            self._slopes = effort_slopes(self._model)
        # The slope of smoothed friction is at most f / v₀.
        drive = self.armature * jerk + (self.damping + self.friction / FRICTION_SPEED) * a
        q, v, a, jerk = self._order.checked(q, v, a, jerk, n_dims=2)
        return self._order.restored(self._slopes(q, v, a, jerk)) + drive

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
        n, velocities = self.n_joints, v
        q, v, a = self._order.checked(q, v, a, n_dims=2)
        tau = np.empty((len(q), n))
        dtau = np.empty((len(q), 3, n, n))  # filled block by block: the innermost loop of planning
        model, data, derivatives = self._model, self._data, pin.computeRNEADerivatives
        by_q, by_v, by_a, efforts = self._results
        for q_k, v_k, a_k, dtau_k, tau_k in zip(q, v, a, dtau, tau, strict=True):
            derivatives(model, data, q_k, v_k, a_k)
            dtau_k[0], dtau_k[1], dtau_k[2] = by_q, by_v, by_a
            tau_k[:] = efforts
        tau, dtau = self._order.restored(tau), self._order.restored_matrix(dtau)
        if self._has_drag:
            viscous, coulomb = self.drag(velocities)
            tau = tau + viscous + coulomb
            joints = np.arange(n)
            by_speed = self.friction * (1.0 - np.tanh(velocities / FRICTION_SPEED) ** 2)
            dtau[:, 1, joints, joints] += self.damping + by_speed / FRICTION_SPEED
        return tau, dtau.transpose(0, 2, 1, 3).reshape(len(q), n, 3 * n)

    def motion_equation(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mass matrix and bias efforts of one state: τ = M q̈ + h.

        Parameters
        ----------
        q, v : array, shape (n_joints,)
            Positions [rad or m] and velocities [/s].

        Returns
        -------
        M : array, shape (n_joints, n_joints)
            The mass matrix; only its upper triangle is sure to be filled.
        h : array, shape (n_joints,)
            Efforts of gravity, centrifugal and Coriolis forces, without damping and friction.
        """
        model, data, order = self._model, self._data, self._order
        q, v = self._order.checked(q, v, n_dims=1)
        M, h = pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)
        if not order.is_same:
            M = order.restored_matrix(np.triu(M) + np.triu(M, 1).T)
        return M, order.restored(h)

    def forward_dynamics(self, q: FloatArray, v: FloatArray, tau: FloatArray) -> FloatArray:
        """Accelerations [/s²] of one state under efforts, all of shape (n_joints,).

        By Featherstone's articulated-body algorithm.
        """
        tau = tau - sum(self.drag(v)) if self._has_drag else tau
        q, v, tau = self._order.checked(q, v, tau, n_dims=1)
        return self._order.restored(pin.aba(self._model, self._data, q, v, tau))

    # Kinematics

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
        return self.attached_poses(q, frames, np.zeros((len(frames), 6)))[..., :3]

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
        (q,) = self._order.checked(q, n_dims=2)
        places = [pin.SE3(pin.rpy.rpyToMatrix(origin[3:]), origin[:3]) for origin in origins]
        poses = np.empty((len(q), len(ids), 7))
        for k, configuration in enumerate(q):
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
        pin.computeJointJacobians(model, data, *self._order.checked(q, n_dims=1))
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
        carriers = [self._model.frames[i] for i in self._frame_ids(frames)]
        places = [
            (frame.parentJoint, frame.placement * pin.SE3(np.eye(3), offset))
            for frame, offset in zip(carriers, offsets, strict=True)
        ]
        return AttachedPoints(self._model, places, self._order)

    def _frame_ids(self, frames: Sequence[str]) -> list[int]:
        for name in frames:
            if name not in self._ids:
                raise RobotError(f"{self._source}: {unknown_name('link', name, self.frame_names)}")
        return [self._ids[name] for name in frames]


class AttachedPoints:
    """Points fixed to frames of a robot, made by :meth:`Robot.attach_points`."""

    def __init__(self, model: Any, places: Sequence[tuple[int, Any]], order: JointOrder) -> None:
        self._model, self._data = model, model.createData()
        self._places, self._order = places, order

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
        model, data, aligned = self._model, self._data, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        (q,) = self._order.checked(q, n_dims=2)
        points = np.empty((len(q), len(self._places), 3))
        jacobians = np.empty((*points.shape, self.n_joints))
        for q_k, points_k, jacobians_k in zip(q, points, jacobians, strict=True):
            pin.computeJointJacobians(model, data, q_k)
            for i, (joint, place) in enumerate(self._places):
                points_k[i] = data.oMi[joint].act(place.translation)
                jacobians_k[i] = pin.getFrameJacobian(model, data, joint, place, aligned)[:3]
        return points, self._order.restored(jacobians)


def _movable(names: Sequence[str], movable: Sequence[str], source: str) -> tuple[str, ...]:
    """The names of joints, if they differ and can move."""
    for name in unique_names(names, f"joints of the {source}", RobotError):
        if name not in movable:
            raise RobotError(f"{source}: {unknown_name('movable joint', name, movable)}")
    return tuple(names)
