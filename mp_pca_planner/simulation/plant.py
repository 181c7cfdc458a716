# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Rigid-body dynamics of an arm whose drives follow commanded positions.

Every drive is a PD loop with gravity compensation that follows its commands a few milliseconds
late, as those of industrial arms do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack

from ..arrays import FloatArray
from ..exceptions import SimulationError, require
from ..robot.model import Robot

PERIOD = 1e-3
"""Time of one step [s]."""


@dataclass(frozen=True, eq=False)
class Drives:
    """Gains of the drives, critically damped.

    Attributes
    ----------
    inertia : array, shape (n_joints,)
        Inertia of each drive behind its gear [kg·m² or kg].
    kp, kd : array, shape (n_joints,)
        Gains [N·m/rad, N·m·s/rad; N/m, N·s/m].
    effort : array, shape (n_joints,)
        Largest torque [N·m] or force [N].
    lag : float
        Delay with which commands are followed [s].
    """

    inertia: FloatArray
    kp: FloatArray
    kd: FloatArray
    effort: FloatArray
    lag: float = 0.003

    @classmethod
    def of(cls, robot: Robot, bandwidth: float = 100.0, inertia_share: float = 0.05) -> Drives:
        """Gains at the largest inertias of 64 random configurations.

        Parameters
        ----------
        robot : Robot
            The arm.
        bandwidth : float
            Bandwidth of the drives [rad/s].
        inertia_share : float
            Inertia of each drive and gear as a share of that of the heaviest joint: the wrist of
            a geared arm is far from weightless.
        """
        limits = robot.limits()
        low, high = np.clip(limits.lower, -np.pi, None), np.clip(limits.upper, None, np.pi)
        draws = np.random.default_rng(0).uniform(size=(64, robot.n_joints))
        zero = np.zeros(robot.n_joints)
        inertias = [
            np.diag(robot.motion_equation(low + (high - low) * draw, zero)[0]) for draw in draws
        ]
        own = np.max(inertias, axis=0)
        inertia = np.full(robot.n_joints, inertia_share * own.max())
        total = own + inertia
        return cls(inertia, bandwidth**2 * total, 2.0 * bandwidth * total, limits.effort)


class Plant:
    """An arm at rest that follows commanded positions.

    Parameters
    ----------
    robot : Robot
        The arm.
    start : array, shape (n_joints,)
        Its positions [rad or m].

    Attributes
    ----------
    drives : Drives
        The drives.
    q, v : array, shape (n_joints,)
        Positions [rad or m] and velocities [/s].
    """

    def __init__(self, robot: Robot, start: FloatArray) -> None:
        self.drives = Drives.of(robot)
        self.q, self.v = np.array(start), np.zeros(robot.n_joints)
        self._robot = robot
        self._commanded = self.q
        self._load(robot)

    def set_payload(self, mass: float) -> None:
        """Attach a mass [kg] to the end effector, which gravity compensation does not include."""
        self._load(self._robot.with_payload(mass))

    def step(self, command: FloatArray) -> None:
        """Move for one period towards commanded positions, shape (n_joints,)."""
        rate = (command - self._commanded) / PERIOD
        self._commanded = command
        self._move(command, rate, self._robot.gravity_efforts(self.q))

    def _load(self, robot: Robot) -> None:
        """Set the inertias of an arm."""
        raise NotImplementedError

    def _move(self, command: FloatArray, rate: FloatArray, gravity: FloatArray) -> None:
        """Move for one period towards commands that change at a rate [/s]."""
        raise NotImplementedError


class PinocchioPlant(Plant):
    """An arm computed by Pinocchio, integrated by the semi-implicit Euler method.

    The drives act on the state at the end of each step, which is stable for gains of any size.
    """

    def __init__(self, robot: Robot, start: FloatArray) -> None:
        super().__init__(robot, start)
        d = self.drives
        self._stiffness = PERIOD * d.kd + PERIOD**2 * d.kp
        self._inertia = np.diag(d.inertia)
        self._total = np.diag(d.inertia + self._stiffness)
        self._has_limits = bool(np.isfinite(d.effort).any())

    def _load(self, robot: Robot) -> None:
        self._loaded = robot

    def _move(self, command: FloatArray, rate: FloatArray, gravity: FloatArray) -> None:
        d, q, v = self.drives, self.q, self.v
        M, h = self._loaded.motion_equation(q, v)
        # The goal at the end of the step, without the part that depends on the velocity there.
        due = command - (d.lag - PERIOD) * rate
        tau = gravity + d.kp * (due - q) + d.kd * rate
        momentum = (M + self._inertia) @ v
        after = _solve(M + self._total, momentum + PERIOD * (tau - h))
        if self._has_limits:
            acting = tau - self._stiffness / PERIOD * after
            if (np.abs(acting) > d.effort).any():
                after = self._saturated(M, momentum - PERIOD * h, tau, acting)
        self.v = after
        self.q = q + PERIOD * after

    def _saturated(
        self, M: FloatArray, push: FloatArray, tau: FloatArray, acting: FloatArray
    ) -> FloatArray:
        """Velocities after a step in which some drives saturate."""
        d = self.drives
        full = np.zeros(len(tau), dtype=bool)
        for _ in range(len(tau)):
            over = np.abs(acting) > d.effort
            if not (over & ~full).any():
                break
            full |= over
            limited = np.where(full, np.clip(acting, -d.effort, d.effort), tau)
            diagonal = np.diag(d.inertia + np.where(full, 0.0, self._stiffness))
            after = _solve(M + diagonal, push + PERIOD * limited)
            acting = np.where(full, limited, tau - self._stiffness / PERIOD * after)
        return after


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a symmetric positive definite matrix of which the upper triangle is given."""
    _, solution, info = lapack.dposv(matrix, right)
    if info != 0:
        raise SimulationError(
            "the mass matrix of the robot is not positive definite: give every moving link of "
            "the robot description a valid inertial"
        )
    return np.asarray(solution)


class MujocoPlant(Plant):
    """An arm computed by MuJoCo.

    Raises
    ------
    MissingDependencyError
        If MuJoCo is not installed.
    """

    # The drives' torques are explicit, which is stable in shorter steps only.
    _n_substeps = 5

    def _load(self, robot: Robot) -> None:
        mujoco = _mujoco()
        pin_model, self._joints = robot.pinocchio_model()
        spec = mujoco.MjSpec()
        spec.option.timestep = PERIOD / self._n_substeps
        spec.option.gravity = pin_model.gravity.linear
        _add_links(spec, pin_model, mujoco)
        self._model = spec.compile()
        self._model.dof_armature[self._joints] = self.drives.inertia
        self._data = mujoco.MjData(self._model)
        self._data.qpos[self._joints], self._data.qvel[self._joints] = self.q, self.v

    def _move(self, command: FloatArray, rate: FloatArray, gravity: FloatArray) -> None:
        d, data, there, mujoco = self.drives, self._data, self._joints, _mujoco()
        due = command - d.lag * rate
        for _ in range(self._n_substeps):
            q, v = data.qpos[there], data.qvel[there]
            tau = gravity + d.kp * (due - q) + d.kd * (rate - v)
            data.qfrc_applied[there] = np.clip(tau, -d.effort, d.effort)
            mujoco.mj_step(self._model, data)
        self.q, self.v = data.qpos[there], data.qvel[there]


def _mujoco() -> Any:
    return require("mujoco", "sim", "the physics engine 'mujoco'")


def _add_links(spec: Any, model: Any, mujoco: Any) -> None:
    """Add a body for every joint of a Pinocchio model, in its order."""
    import pinocchio as pin

    least = 1e-9  # mass and inertia of a link [kg, kg·m²]
    bodies, data, neutral = [spec.worldbody], model.createData(), pin.neutral(model)
    for i in range(1, model.njoints):
        placement, inertia = model.jointPlacements[i], model.inertias[i]
        # MuJoCo rejects links without mass, which are usual between the joints of a shoulder.
        full = inertia.inertia + least * np.eye(3)
        body = bodies[model.parents[i]].add_body(
            pos=placement.translation,
            quat=np.roll(pin.Quaternion(placement.rotation).coeffs(), 1),
            mass=max(inertia.mass, least),
            ipos=inertia.lever,
            fullinertia=[*np.diag(full), full[0, 1], full[0, 2], full[1, 2]],
            explicitinertial=True,
        )
        bodies.append(body)
        column = model.joints[i].idx_v
        subspace = pin.computeJointJacobian(model, data, neutral, i)[:, column]
        turns = bool(subspace[3:].any())
        kind = mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE
        axis = subspace[3:] if turns else subspace[:3]
        body.add_joint(type=kind, axis=axis)
