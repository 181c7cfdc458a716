# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The sampled closed loop: a reference, a law, and the robot's own dynamics.

The controller samples the state and computes an effort, which acts `delay` samples later for one
period, as in a real control loop.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import BPoly

from ..arrays import FloatArray, set_frozen
from ..exceptions import ControlError
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from .law import COMPUTED_TORQUE, ControlLaw


@dataclass(frozen=True)
class Sampling:
    """Timing of a control loop.

    Attributes
    ----------
    period : float
        Time between samples [s].
    delay : int
        Samples from measuring to acting.

    Raises
    ------
    ControlError
        If the period isn't positive or the delay negative.
    """

    period: float = 1e-3
    delay: int = 1

    def __post_init__(self) -> None:
        if not 1e-5 <= self.period <= 0.1:
            raise ControlError(f"a control period must be 0.00001 to 0.1 s, got {self.period}")
        if not 0 <= self.delay <= 100:
            raise ControlError(f"a delay must be 0 to 100 samples, got {self.delay}")


DEFAULT_SAMPLING = Sampling()


@dataclass(frozen=True, eq=False)
class Reference:
    """The desired motion at some instants, followed by rest at its end.

    Attributes
    ----------
    times : array, shape (n_steps,)
        [s].
    q, v, a : array, shape (n_steps, n_joints)
        Positions, velocities and accelerations.
    """

    times: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray

    @classmethod
    def of(cls, trajectory: Trajectory, times: FloatArray) -> Reference:
        """The controller's quintic interpolation of a trajectory at any times [s]."""
        values = np.stack(
            [trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1
        )
        # A copy: SciPy before 1.12 refuses breakpoints that are read-only.
        curve = BPoly.from_derivatives(trajectory.times.copy(), values)
        inside = np.clip(times, 0.0, trajectory.duration)
        return cls(times, *(np.asarray(curve(inside, nu), dtype=np.float64) for nu in range(3)))


@dataclass(frozen=True, eq=False)
class Simulation:
    """Result of a simulation of the closed loop.

    Attributes
    ----------
    errors : array, shape (n_samples, n_joints)
        q_d − q at the samples [rad or m].
    efforts : array, shape (n_samples, n_joints)
        Efforts that acted after each sample.
    saturated : int
        Samples at which an effort was cut to its limit.
    """

    errors: FloatArray
    efforts: FloatArray
    saturated: int


@dataclass(frozen=True, eq=False)
class ControlLoop:
    """A control law on a motion.

    Attributes
    ----------
    model : Robot
        The robot model of the controller.
    law : ControlLaw
        The law, of the same joints.
    trajectory : Trajectory
        The motion, of the same joints.
    effort_limits : array, shape (n_joints,)
        Efforts at which the drives saturate; infinite unless given.
    sampling : Sampling
        Timing.

    Raises
    ------
    ControlError
        If the joints differ, or a limit is NaN.
    """

    model: Robot
    law: ControlLaw
    trajectory: Trajectory
    effort_limits: FloatArray = field(default_factory=lambda: np.array(np.inf))
    sampling: Sampling = DEFAULT_SAMPLING

    def __post_init__(self) -> None:
        names, n = self.model.joint_names, self.model.n_joints
        if not names == self.law.joint_names == self.trajectory.joint_names:
            raise ControlError(
                f"the law is of {self.law.joint_names}, the model of {names} and the motion of "
                f"{self.trajectory.joint_names}"
            )
        limits = np.asarray(self.effort_limits, dtype=np.float64)
        if limits.shape not in ((), (n,)) or np.isnan(limits).any():
            raise ControlError(f"effort limits must be {n} numbers or one, got {limits}")
        set_frozen(self, effort_limits=np.broadcast_to(limits, (n,)))

    @cached_property
    def times(self) -> FloatArray:
        """Instants of control from the start to the end of the motion, shape (n_samples,) [s]."""
        n_steps = int(np.ceil(self.trajectory.duration / self.sampling.period))
        return np.asarray(np.arange(n_steps + 1) * self.sampling.period)

    @cached_property
    def reference(self) -> Reference:
        """The desired motion at these instants."""
        return Reference.of(self.trajectory, self.times)


def simulate(
    loop: ControlLoop, robot: Robot, start_error: FloatArray, start_velocity_error: FloatArray
) -> Simulation:
    """Simulate the closed loop with Pinocchio's forward dynamics.

    Parameters
    ----------
    loop : ControlLoop
        The law and the motion.
    robot : Robot
        The simulated robot, which may differ from the model of the controller.
    start_error, start_velocity_error : array, shape (n_joints,)
        q_d − q and its derivative at the start.

    Raises
    ------
    RobotError
        If a moving link of the robot or of the model has no valid inertia.
    """
    for one in (robot, loop.model):
        one.require_inertias("simulations")
    desired, limits = loop.reference, loop.effort_limits
    feedforward = loop.model.inverse_dynamics(desired.q, desired.v, desired.a)
    q, v = desired.q[0] - start_error, desired.v[0] - start_velocity_error
    # Before the start, the robot is at rest under the same law.
    pending = [_command(loop, feedforward, 0, q, v)] * loop.sampling.delay
    errors, efforts = np.empty_like(desired.q), np.empty_like(desired.q)
    saturated = 0
    for k in range(len(loop.times)):
        errors[k] = desired.q[k] - q
        pending.append(_command(loop, feedforward, k, q, v))
        command = pending.pop(0)
        efforts[k] = np.clip(command, -limits, limits)
        saturated += bool(np.any(efforts[k] != command))
        q, v = _integrate(robot, q, v, efforts[k], loop.sampling.period)
    return Simulation(errors, efforts, saturated)


def _command(
    loop: ControlLoop, feedforward: FloatArray, k: int, q: FloatArray, v: FloatArray
) -> FloatArray:
    """The effort of the law at one instant, shape (n_joints,)."""
    desired, law = loop.reference, loop.law
    correction = law.position_gains * (desired.q[k] - q) + law.velocity_gains * (desired.v[k] - v)
    if law.kind == COMPUTED_TORQUE:
        acceleration = desired.a[k] + correction
        return np.asarray(loop.model.inverse_dynamics(q[None], v[None], acceleration[None])[0])
    return np.asarray(feedforward[k] + correction)


def _integrate(
    robot: Robot, q: FloatArray, v: FloatArray, tau: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """One step of the classical Runge–Kutta method under a constant effort."""

    def rate(x: FloatArray) -> FloatArray:
        return np.array([x[1], robot.forward_dynamics(x[0], x[1], tau)])

    x = np.array([q, v])
    k1 = rate(x)
    k2 = rate(x + 0.5 * step * k1)
    k3 = rate(x + 0.5 * step * k2)
    k4 = rate(x + step * k3)
    x += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[0], x[1]
