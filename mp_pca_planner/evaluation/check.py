# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee of the benchmark: what a motion costs and whether it keeps the limits.

It shares no code with the planner, its solver and its validator: Pinocchio's `rnea` on a model
of its own, SciPy's polynomials between the points of a trajectory, a grid of 0.5 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.integrate import trapezoid
from scipy.interpolate import BPoly

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.limits import JointLimits
from .problems import Problem

PERIOD = 5e-4
"""Longest step of the grid [s]."""

LIMIT_TOLERANCE = 1e-6
"""Relative excess over a limit that a feasible motion may have."""

POSITION_TOLERANCE = 1e-3
"""By how much a feasible motion may miss its start and goal [rad or m]."""

VELOCITY_TOLERANCE = 1e-2
"""How fast a feasible motion from rest to rest may be at its ends [rad/s or m/s]."""

# From this share of a limit on, somewhere between the ends, a limit counts as active.
_ACTIVE = 0.998
_ENDS = 0.05
_N_PHASES = 101


@dataclass(frozen=True)
class Verdict:
    """What the referee finds of one motion.

    Attributes
    ----------
    duration : float
        Duration [s].
    effort_cost : float
        J = ½∫‖τ‖²dt [N²·m²·s], [P] eq. (6), by the trapezoidal rule on the grid.
    limit_violation : float
        Largest relative excess over a limit; for positions the distance outside, as a share of
        the range (of 1 rad or m if that is infinite).
    worst_limit : str
        Which limit that is ('' if all hold).
    limits_active : bool
        Whether the motion reaches 99.8 % of a limit away from its ends.
    end_error : float
        By how much it misses start or goal [rad or m].
    end_velocity : float
        Largest velocity at its ends [rad/s or m/s].
    demo_distance_deg : float
        RMS difference from the held-out demonstration with these ends over joints and 101
        phases [deg]; NaN if the problem has none.
    """

    duration: float
    effort_cost: float
    limit_violation: float
    worst_limit: str
    limits_active: bool
    end_error: float
    end_velocity: float
    demo_distance_deg: float

    @property
    def feasible(self) -> bool:
        """Whether it keeps the limits and goes from rest at the start to rest at the goal."""
        return (
            self.limit_violation <= LIMIT_TOLERANCE
            and self.end_error <= POSITION_TOLERANCE
            and self.end_velocity <= VELOCITY_TOLERANCE
        )


class RigidArm:
    """A Pinocchio model of some joints of a URDF, the others locked; for the referee and peers.

    Parameters
    ----------
    urdf : str or Path
        The URDF file.
    joint_names : sequence of str
        The n_joints joints that move, in the order of every array here.

    Attributes
    ----------
    model : pinocchio.Model
        The model; joints that turn without end are a cosine and a sine in its configurations.
    velocity_index : array of int, shape (n_joints,)
        Where the joints are in Pinocchio's velocities.
    continuous : array of bool, shape (n_joints,)
        Which joints turn without end.
    """

    def __init__(self, urdf: str | Path, joint_names: Sequence[str]) -> None:
        full = pin.buildModelFromUrdf(str(urdf))
        others = [i for i, name in enumerate(full.names) if i > 0 and name not in joint_names]
        rest = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
        self.model = pin.buildReducedModel(full, others, rest) if others else full
        self._data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in joint_names]
        self.velocity_index = np.array([joint.idx_v for joint in joints])
        self._position_index = [(joint.idx_q, joint.nq) for joint in joints]
        self.continuous = np.array([joint.nq == 2 for joint in joints])

    def configuration(self, angles: FloatArray) -> FloatArray:
        """Pinocchio's configuration of joint positions, shape (nq,)."""
        q = np.empty(self.model.nq)
        for angle, (index, size) in zip(angles, self._position_index, strict=True):
            q[index : index + size] = angle if size == 1 else (np.cos(angle), np.sin(angle))
        return q

    def angles(self, configuration: FloatArray) -> FloatArray:
        """Joint positions of one of Pinocchio's configurations, up to whole turns."""
        return np.array(
            [
                configuration[index]
                if size == 1
                else np.arctan2(configuration[index + 1], configuration[index])
                for index, size in self._position_index
            ]
        )

    def velocity(self, v: FloatArray) -> FloatArray:
        """Pinocchio's vector of joint velocities (or accelerations), shape (nv,)."""
        result = np.empty(self.model.nv)
        result[self.velocity_index] = v
        return result

    def efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of a motion, all of shape (n_steps, n_joints)."""
        return np.array(
            [
                pin.rnea(
                    self.model,
                    self._data,
                    self.configuration(q_k),
                    self.velocity(v_k),
                    self.velocity(a_k),
                )[self.velocity_index]
                for q_k, v_k, a_k in zip(q, v, a, strict=True)
            ]
        )


def judge(trajectory: Trajectory, problem: Problem, arm: RigidArm, limits: JointLimits) -> Verdict:
    """Look at a motion as a controller executes it: quintic polynomials between its points."""
    curve = BPoly.from_derivatives(
        trajectory.times.copy(),  # older releases of SciPy refuse read-only arrays
        np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1),
    )
    times = np.linspace(0.0, trajectory.duration, int(np.ceil(trajectory.duration / PERIOD)) + 1)
    q, v, a, jerk = (curve(times) if k == 0 else curve.derivative(k)(times) for k in range(4))
    tau = arm.efforts(q, v, a)
    excess, worst, active = _against_limits(times, (q, v, a, jerk, tau), limits)
    ends = np.array([problem.start, problem.goal])
    return Verdict(
        duration=trajectory.duration,
        effort_cost=float(trapezoid(0.5 * np.sum(tau**2, axis=1), times)),
        limit_violation=excess,
        worst_limit=worst,
        limits_active=active,
        end_error=float(np.abs(q[[0, -1]] - ends).max()),
        end_velocity=float(np.abs(v[[0, -1]]).max()),
        demo_distance_deg=_distance(curve, trajectory.duration, problem),
    )


def _against_limits(
    times: FloatArray, states: tuple[FloatArray, ...], limits: JointLimits
) -> tuple[float, str, bool]:
    """Largest relative excess, where that is, and whether a limit is active."""
    q, v, a, jerk, tau = states
    width = limits.upper - limits.lower
    width = np.where(np.isfinite(width), width, 1.0)
    excesses = {
        "position": np.maximum(limits.lower - q, q - limits.upper) / width,
        "velocity": np.abs(v) / limits.velocity - 1.0,
        "acceleration": np.abs(a) / limits.acceleration - 1.0,
        "jerk": np.abs(jerk) / limits.jerk - 1.0,
        "effort": np.abs(tau) / limits.effort - 1.0,
    }
    inside = (times > _ENDS * times[-1]) & (times < (1.0 - _ENDS) * times[-1])
    active = any(excess[inside].max() > _ACTIVE - 1.0 for excess in excesses.values())
    quantity = max(excesses, key=lambda name: float(excesses[name].max()))
    step, joint = np.unravel_index(excesses[quantity].argmax(), q.shape)
    worst = float(excesses[quantity][step, joint])
    if worst <= 0.0:
        return 0.0, "", active
    where = f"{quantity} of joint '{limits.joint_names[joint]}' at {times[step]:.3f} s"
    return worst, where, active


def _distance(curve: BPoly, duration: float, problem: Problem) -> float:
    if problem.demonstration is None:
        return float("nan")
    phases = np.linspace(0.0, 1.0, _N_PHASES)
    shown = problem.demonstration.time_normalised(_N_PHASES)
    return float(np.rad2deg(np.sqrt(np.mean((curve(phases * duration) - shown) ** 2))))
