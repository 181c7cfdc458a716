# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Rigid-body dynamics of an arm whose drives follow commanded positions.

Every drive is a PD loop with gravity compensation that follows its commands a few milliseconds
late, as those of industrial arms do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import lapack

from ..arrays import FloatArray
from ..exceptions import PlannerError, require
from ..robot.model import Robot

PERIOD = 1e-3
"""Time of one step [s]."""


class Plant:
    """An arm at rest that follows commanded positions, computed by Pinocchio.

    The motion is integrated by the semi-implicit Euler method. The drives are critically damped.
    They act on the state at the end of each step, which is stable for gains of any size.

    Parameters
    ----------
    robot : Robot
        The arm.
    start : array, shape (n_joints,)
        Its positions [rad or m].

    Attributes
    ----------
    inertia : array, shape (n_joints,)
        Inertia of each drive behind its gear [kg·m² or kg].
    kp, kd : array, shape (n_joints,)
        Gains of the drives [N·m/rad, N·m·s/rad; N/m, N·s/m].
    effort : array, shape (n_joints,)
        Their largest torque [N·m] or force [N].
    q, v : array, shape (n_joints,)
        Positions [rad or m] and velocities [/s].
    """

    bandwidth = 100.0
    """Bandwidth of the drives [rad/s]."""

    lag = 0.003
    """Delay with which drives follow commands [s]."""

    inertia_share = 0.05
    """Inertia of each drive and gear as a share of that of the heaviest joint: the wrist of a
    geared arm is far from weightless."""

    def __init__(self, robot: Robot, start: FloatArray) -> None:
        own, limits = _largest_inertias(robot), robot.limits()
        self.inertia = np.full(robot.n_joints, self.inertia_share * own.max())
        total = own + self.inertia
        self.kp, self.kd = self.bandwidth**2 * total, 2.0 * self.bandwidth * total
        self.effort = limits.effort
        self._stiffness = PERIOD * self.kd + PERIOD**2 * self.kp
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
        self._loaded = robot

    def _move(self, command: FloatArray, rate: FloatArray, gravity: FloatArray) -> None:
        """Move for one period towards commands that change at a rate [/s]."""
        M, h = self._loaded.motion_equation(self.q, self.v)
        # The goal at the end of the step, without the part that depends on the velocity there.
        due = command - (self.lag - PERIOD) * rate
        tau = gravity + self.kp * (due - self.q) + self.kd * rate
        momentum = (M + np.diag(self.inertia)) @ self.v
        after = _solve(M + np.diag(self.inertia + self._stiffness), momentum + PERIOD * (tau - h))
        acting = tau - self._stiffness / PERIOD * after
        if (np.abs(acting) > self.effort).any():
            after = self._saturated(M, momentum - PERIOD * h, tau, acting)
        self.v = after
        self.q = self.q + PERIOD * after

    def _saturated(
        self, M: FloatArray, push: FloatArray, tau: FloatArray, acting: FloatArray
    ) -> FloatArray:
        """Velocities after a step in which some drives saturate."""
        full = np.zeros(len(tau), dtype=bool)
        for _ in range(len(tau)):
            over = np.abs(acting) > self.effort
            if not (over & ~full).any():
                break
            full |= over
            limited = np.where(full, np.clip(acting, -self.effort, self.effort), tau)
            diagonal = np.diag(self.inertia + np.where(full, 0.0, self._stiffness))
            after = _solve(M + diagonal, push + PERIOD * limited)
            acting = np.where(full, limited, tau - self._stiffness / PERIOD * after)
        return after


def _largest_inertias(robot: Robot) -> FloatArray:
    """The largest inertia of each joint in 64 random configurations [kg·m² or kg]."""
    limits, zero = robot.limits(), np.zeros(robot.n_joints)
    low, high = np.clip(limits.lower, -np.pi, None), np.clip(limits.upper, None, np.pi)
    draws = low + (high - low) * np.random.default_rng(0).uniform(size=(64, robot.n_joints))
    inertias = [np.diag(robot.motion_equation(q, zero)[0]) for q in draws]
    return np.asarray(np.max(inertias, axis=0))


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a symmetric positive definite matrix of which the upper triangle is given."""
    _, solution, info = lapack.dposv(matrix, right)
    if info != 0:
        raise PlannerError(
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
        self._model.dof_armature[self._joints] = self.inertia
        self._data = mujoco.MjData(self._model)
        self._data.qpos[self._joints], self._data.qvel[self._joints] = self.q, self.v

    def _move(self, command: FloatArray, rate: FloatArray, gravity: FloatArray) -> None:
        data, there, mujoco = self._data, self._joints, _mujoco()
        due = command - self.lag * rate
        for _ in range(self._n_substeps):
            q, v = data.qpos[there], data.qvel[there]
            tau = gravity + self.kp * (due - q) + self.kd * (rate - v)
            data.qfrc_applied[there] = np.clip(tau, -self.effort, self.effort)
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
