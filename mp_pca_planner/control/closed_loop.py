# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The sampled closed loop: a reference, a law, and the robot's own dynamics.

The controller samples the state and computes an effort, which acts `delay` samples later for one
period, as in a real control loop. Robots that differ from the model verify an error bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, set_frozen
from ..motion.interpolation import interpolate_at, segment_ends
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from .law import COMPUTED_TORQUE, ControlLaw


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Largest errors of a model and of a start.

    Attributes
    ----------
    inertia : float
        Relative error of the mass and of each principal moment of inertia of each link, all
        independent of each other.
    position : float
        Largest error of each joint at the start [rad or m].
    friction : array, shape (n_joints,), or float
        Largest Coulomb friction of each joint [N·m or N].
    """

    inertia: float = 0.05
    position: float = 0.001
    friction: FloatArray | float = 0.0

    def sample(
        self, robot: Robot, rng: np.random.Generator, *, extreme: bool = False
    ) -> tuple[Robot, FloatArray, FloatArray]:
        """One robot within the errors: (robot, start error, friction).

        Parameters
        ----------
        robot : Robot
            The nominal one.
        rng : Generator
            Source of random numbers.
        extreme : bool
            Whether every error has its largest magnitude.
        """

        def draw(*size: int) -> FloatArray:
            values = rng.uniform(-1.0, 1.0, size)
            return np.where(values < 0.0, -1.0, 1.0) if extreme else values

        n, factors = robot.n_joints, 1.0 + self.inertia * draw(len(robot.link_inertias), 4)
        true = robot.with_link_inertias(factors)
        return true, self.position * draw(n), self.friction * 0.5 * (1.0 + draw(n))


# Speed at which friction reaches three quarters of its size [rad/s or m/s].
_SLOW = 0.01


@dataclass(frozen=True, eq=False)
class ControlLoop:
    """A control law on a motion.

    Attributes
    ----------
    model : Robot
        The robot model of the controller; its damping and friction are left out.
    law : ControlLaw
        The law, of the same joints.
    trajectory : Trajectory
        The motion, of the same joints.
    effort_limits : array, shape (n_joints,)
        Efforts at which the drives saturate; infinite unless given.
    period : float
        Time between samples [s].
    delay : int
        Samples from measuring to acting.
    """

    model: Robot
    law: ControlLaw
    trajectory: Trajectory
    effort_limits: FloatArray = field(default_factory=lambda: np.array(np.inf))
    period: float = 1e-3
    delay: int = 1

    def __post_init__(self) -> None:
        no_drag = {name: {"damping": 0.0, "friction": 0.0} for name in self.model.joint_names}
        set_frozen(self, model=self.model.with_drives(no_drag))
        set_frozen(self, effort_limits=np.broadcast_to(self.effort_limits, (self.model.n_joints,)))

    @cached_property
    def times(self) -> FloatArray:
        """Instants of control from the start to the end of the motion, shape (n_samples,) [s]."""
        n_steps = int(np.ceil(self.trajectory.duration / self.period))
        return np.asarray(np.arange(n_steps + 1) * self.period)

    @cached_property
    def reference(self) -> FloatArray:
        """The desired motion at these instants, see :meth:`reference_at`."""
        return self.reference_at(self.times)

    def reference_at(self, times: FloatArray) -> FloatArray:
        """Positions, velocities and accelerations of the motion, and of the rest at its end.

        Their shape is (3, n_times, n_joints).
        """
        inside, motion = np.clip(times, 0.0, self.trajectory.duration), self.trajectory
        ends = segment_ends(motion.times, *motion.states)
        return np.array(interpolate_at(inside, motion.times, ends))


def simulate(
    loop: ControlLoop,
    robot: Robot,
    start_error: FloatArray,
    friction: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Simulate the closed loop with Pinocchio's forward dynamics.

    Parameters
    ----------
    loop : ControlLoop
        The law and the motion.
    robot : Robot
        The simulated robot, which may differ from the model of the controller.
    start_error : array, shape (n_joints,)
        q_d − q at the start.
    friction : array, shape (n_joints,), or float
        Coulomb friction of each joint [N·m or N]. It is smooth near rest, where a jump could not be
        integrated.

    Returns
    -------
    errors : array, shape (n_samples, n_joints)
        q_d − q at the samples [rad or m].
    efforts : array, shape (n_samples, n_joints)
        Efforts within their limits that acted after each sample.

    Raises
    ------
    RobotError
        If a moving link of the robot or of the model has no valid inertia.
    """
    for some_robot in (robot, loop.model):
        some_robot.require_inertias("simulations")
    desired, limits, period = loop.reference, loop.effort_limits, loop.period
    feedforward = loop.model.inverse_dynamics(*desired)
    q, v = desired[0, 0] - start_error, desired[1, 0]
    # Before the start, the robot is at rest under the same law.
    pending = [_command(loop, feedforward, 0, q, v)] * loop.delay
    errors, efforts = np.empty_like(desired[0]), np.empty_like(desired[0])
    # Friction that changes more within a step than inertia allows would be unstable.
    drag, (mass, _) = np.broadcast_to(friction, (robot.n_joints,)), robot.motion_equation(q, v)
    slow = np.maximum(_SLOW, 2.0 * period * drag * np.linalg.inv(mass).diagonal())
    for k in range(len(loop.times)):
        errors[k] = desired[0, k] - q
        pending.append(_command(loop, feedforward, k, q, v))
        efforts[k] = np.clip(pending.pop(0), -limits, limits)
        q, v = _integrate(robot, q, v, efforts[k], period, drag, slow)
    return errors, efforts


def _command(
    loop: ControlLoop, feedforward: FloatArray, k: int, q: FloatArray, v: FloatArray
) -> FloatArray:
    """The effort of the law at one instant, shape (n_joints,)."""
    (q_d, v_d, a_d), law = loop.reference[:, k], loop.law
    correction = law.position_gains * (q_d - q) + law.velocity_gains * (v_d - v)
    if law.kind == COMPUTED_TORQUE:
        acceleration = a_d + correction
        return np.asarray(loop.model.inverse_dynamics(q[None], v[None], acceleration[None])[0])
    return np.asarray(feedforward[k] + correction)


def _integrate(
    robot: Robot,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray,
    step: float,
    friction: FloatArray,
    slow: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """One step of the classical Runge–Kutta method under a constant effort and friction."""

    def rate(x: FloatArray) -> FloatArray:
        driving = tau - friction * np.tanh(x[1] / slow)
        return np.array([x[1], robot.forward_dynamics(x[0], x[1], driving)])

    x = np.array([q, v])
    k1 = rate(x)
    k2 = rate(x + 0.5 * step * k1)
    k3 = rate(x + 0.5 * step * k2)
    k4 = rate(x + step * k3)
    x += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[0], x[1]


class Verification(NamedTuple):
    """Result of perturbed simulations of a closed loop.

    Attributes
    ----------
    errors : array, shape (n_trials, n_joints)
        Largest |q_d − q| of each simulation [rad or m].
    bound_held : int
        Simulations in which no error exceeded its bound; 0 without a bound.
    saturated : int
        Simulations in which an effort was cut to its limit.
    """

    errors: FloatArray
    bound_held: int
    saturated: int


def verify(
    loop: ControlLoop,
    errors: ErrorModel,
    error_bound: FloatArray | None,
    n_trials: int,
    *,
    seed: int = 0,
) -> Verification:
    """Simulate the loop with robots that differ from the controller's model.

    Parameters
    ----------
    loop : ControlLoop
        The law and the motion.
    errors : ErrorModel
        Every second simulation draws from within these errors, the others have each of them at
        its largest magnitude.
    error_bound : array, shape (n_samples, n_joints), or None
        The bound on |q_d − q| to verify.
    n_trials : int
        Simulations.
    seed : int
        Seed of the errors.
    """
    rng = np.random.default_rng(seed)
    worst = np.empty((n_trials, loop.model.n_joints))
    held = saturated = 0
    for trial in range(n_trials):
        error, efforts = simulate(loop, *errors.sample(loop.model, rng, extreme=trial % 2 == 0))
        magnitude = np.abs(error)
        worst[trial] = magnitude.max(axis=0)
        held += error_bound is not None and bool(np.all(magnitude <= error_bound))
        saturated += bool(np.any(np.abs(efforts) >= loop.effort_limits))
    return Verification(worst, held, saturated)
