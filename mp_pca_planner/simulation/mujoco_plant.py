# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The same arm and drives as those of :mod:`.plant`, computed by MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError
from ..robot.model import Robot
from .plant import PERIOD, Drives

# The drives' torques are explicit, which is stable in shorter steps only.
_SUBSTEPS = 5
_LEAST = 1e-9  # mass and inertia of a link [kg, kg·m²]


class MujocoPlant:
    """An arm at rest, computed by MuJoCo.

    Parameters
    ----------
    robot : Robot
        The arm.
    start : array, shape (n_joints,)
        Its positions [rad or m].
    drives : Drives, optional
        The drives.

    Raises
    ------
    MissingDependencyError
        If MuJoCo is not installed.
    """

    def __init__(self, robot: Robot, start: FloatArray, drives: Drives | None = None) -> None:
        try:
            import mujoco
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                str(error.name), "sim", "the physics engine 'mujoco'"
            ) from error
        self._mujoco: Any = mujoco
        self._robot = robot
        self.drives = drives or Drives.of(robot)
        self.q, self.v = np.array(start), np.zeros(robot.n_joints)
        self._commanded = self.q
        self._load(robot)

    def set_payload(self, mass: float) -> None:
        """Attach a mass [kg] to the last link; gravity compensation doesn't know it."""
        self._load(self._robot.with_payload(mass))

    def step(self, command: FloatArray) -> None:
        """Move for one period towards commanded positions, shape (n_joints,)."""
        d, data, there = self.drives, self._data, self._joints
        rate = (command - self._commanded) / PERIOD
        self._commanded = command
        due, g = command - d.lag * rate, self._robot.gravity_efforts(self.q)
        for _ in range(_SUBSTEPS):
            q, v = data.qpos[there], data.qvel[there]
            tau = g + d.kp * (due - q) + d.kd * (rate - v)
            data.qfrc_applied[there] = np.clip(tau, -d.effort, d.effort)
            self._mujoco.mj_step(self._model, data)
        self.q, self.v = data.qpos[there], data.qvel[there]

    def _load(self, robot: Robot) -> None:
        pin_model, self._joints = robot.pinocchio_model()
        spec = self._mujoco.MjSpec()
        spec.option.timestep = PERIOD / _SUBSTEPS
        spec.option.gravity = pin_model.gravity.linear
        _add_links(spec, pin_model, self._mujoco)
        self._model = spec.compile()
        self._model.dof_armature[self._joints] = self.drives.inertia
        self._data = self._mujoco.MjData(self._model)
        self._data.qpos[self._joints], self._data.qvel[self._joints] = self.q, self.v


def _add_links(spec: Any, model: Any, mujoco: Any) -> None:
    """Add a body for every joint of a Pinocchio model, in its order."""
    import pinocchio as pin

    bodies, data, neutral = [spec.worldbody], model.createData(), pin.neutral(model)
    for i in range(1, model.njoints):
        placement, inertia = model.jointPlacements[i], model.inertias[i]
        # MuJoCo rejects links without mass, which are usual between the joints of a shoulder.
        full = inertia.inertia + _LEAST * np.eye(3)
        body = bodies[model.parents[i]].add_body(
            pos=placement.translation,
            quat=np.roll(pin.Quaternion(placement.rotation).coeffs(), 1),
            mass=max(inertia.mass, _LEAST),
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
