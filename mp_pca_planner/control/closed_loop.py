# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The sampled closed loop: a reference, a law, and the robot's own dynamics.

The controller samples the state, computes an effort, and that effort acts `delay` samples later
until the next one comes, as in a real control loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly

from ..arrays import FloatArray
from ..exceptions import ControlError
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from .law import COMPUTED_TORQUE, ControlLaw


@dataclass(frozen=True)
class Sampling:
    """How a control loop is timed.

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
    """What the robot shall do: a motion, and rest at its end.

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
    """What a closed loop did.

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


def sample_times(trajectory: Trajectory, sampling: Sampling) -> FloatArray:
    """The instants of control from the start to the end of a motion, shape (n_samples,) [s]."""
    n_steps = int(np.ceil(trajectory.duration / sampling.period))
    return np.asarray(np.arange(n_steps + 1) * sampling.period)


def simulate(
    robot: Robot,
    model: Robot,
    law: ControlLaw,
    trajectory: Trajectory,
    *,
    start_error: FloatArray,
    start_velocity_error: FloatArray,
    effort_limits: FloatArray,
    sampling: Sampling = DEFAULT_SAMPLING,
) -> Simulation:
    """Simulate the closed loop with Pinocchio's forward dynamics.

    Parameters
    ----------
    robot : Robot
        What moves.
    model : Robot
        What the controller believes.
    law : ControlLaw
        Its law.
    trajectory : Trajectory
        The motion.
    start_error, start_velocity_error : array, shape (n_joints,)
        q_d − q and its derivative at the start.
    effort_limits : array, shape (n_joints,)
        Where efforts saturate.
    sampling : Sampling
        The timing.

    Raises
    ------
    RobotError
        If a moving link of one of them has no valid inertia.
    """
    for one in (robot, model):
        one.require_inertias("simulations")
    times = sample_times(trajectory, sampling)
    desired = Reference.of(trajectory, times)
    feedforward = model.inverse_dynamics(desired.q, desired.v, desired.a)
    q, v = desired.q[0] - start_error, desired.v[0] - start_velocity_error
    # Before the start the robot waited where it is, and was controlled already.
    pending = [_command(model, law, desired, feedforward, 0, q, v)] * sampling.delay
    errors, efforts = np.empty_like(desired.q), np.empty_like(desired.q)
    saturated = 0
    for k in range(len(times)):
        errors[k] = desired.q[k] - q
        pending.append(_command(model, law, desired, feedforward, k, q, v))
        wanted = pending.pop(0)
        tau = np.clip(wanted, -effort_limits, effort_limits)
        saturated += bool(np.any(tau != wanted))
        efforts[k] = tau
        q, v = _integrate(robot, q, v, tau, sampling.period)
    return Simulation(errors, efforts, saturated)


def _command(
    model: Robot,
    law: ControlLaw,
    desired: Reference,
    feedforward: FloatArray,
    k: int,
    q: FloatArray,
    v: FloatArray,
) -> FloatArray:
    correction = law.position_gains * (desired.q[k] - q) + law.velocity_gains * (desired.v[k] - v)
    if law.kind == COMPUTED_TORQUE:
        acceleration = desired.a[k] + correction
        return np.asarray(model.inverse_dynamics(q[None], v[None], acceleration[None])[0])
    return np.asarray(feedforward[k] + correction)


def _integrate(
    robot: Robot, q: FloatArray, v: FloatArray, tau: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """One step of the classical Runge–Kutta method under a constant effort."""
    a1 = robot.forward_dynamics(q, v, tau)
    v2 = v + 0.5 * step * a1
    a2 = robot.forward_dynamics(q + 0.5 * step * v, v2, tau)
    v3 = v + 0.5 * step * a2
    a3 = robot.forward_dynamics(q + 0.5 * step * v2, v3, tau)
    v4 = v + step * a3
    a4 = robot.forward_dynamics(q + step * v3, v4, tau)
    return (
        np.asarray(q + step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)),
        np.asarray(v + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)),
    )
