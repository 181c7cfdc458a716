# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""SciPy's SLSQP on B-splines: what the users of [P] had.

The same B-splines with 6 control points per joint as the planner's, the same J, and the same
limits at evenly spaced phases, written down without its compiler. Gradients are left to SciPy's
finite differences, or taken from Pinocchio.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import minimize

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .method import SOLVED, Answer
from .problems import Problem, Scene
from .without_optimisation import minimum_jerk

_N_CONTROL_POINTS, _DEGREE = 6, 5
_N_PHASES = 41
_TOLERANCE = 1e-6
_MOST_ITERATIONS = 200
_PERIOD = 0.01  # [s]


class SequentialLeastSquares:
    """SLSQP from the minimum-jerk motion on."""

    slow = True

    def __init__(self, scene: Scene, max_time: float, *, differences: bool) -> None:
        self.name = "slsqp_differences" if differences else "slsqp_gradients"
        self.about = (
            f"SciPy's SLSQP on B-splines, {_N_CONTROL_POINTS} control points per joint, "
            f"{'finite differences' if differences else 'analytic gradients'}, limits at "
            f"{_N_PHASES} phases"
        )
        self._scene = scene
        self._differences = differences
        self._max_time = max_time

    def solve(self, problem: Problem) -> Answer:
        """Solve one problem."""
        program = _Program(self._scene.robot, self._scene.limits, problem)
        began = time.perf_counter()
        deadline = began + self._max_time

        def watch(_: FloatArray) -> None:
            if time.perf_counter() > deadline:
                raise TimeoutError

        constraint = {"type": "ineq", "fun": program.slack}
        if not self._differences:
            constraint["jac"] = program.slack_jacobian
        try:
            found = minimize(
                program.cost,
                np.zeros(program.n_weights),
                jac=None if self._differences else program.gradient,
                constraints=[constraint],
                method="SLSQP",
                callback=watch,
                options={"maxiter": _MOST_ITERATIONS, "ftol": _TOLERANCE},
            )
        except TimeoutError:
            took = time.perf_counter() - began
            return Answer(None, took, status=f"not converged in {self._max_time:g} s")
        took = time.perf_counter() - began
        status = SOLVED if found.success else str(found.message)
        return Answer(program.trajectory(found.x), took, int(found.nit), status)


class _Bound(NamedTuple):
    """Limits of one quantity: its number, the joints that have one, their middle and half width."""

    quantity: int
    joints: NDArray[np.intp]
    middle: FloatArray
    half: FloatArray


class _Program:
    """One problem as functions of the free control points."""

    def __init__(self, robot: Robot, limits: JointLimits, problem: Problem) -> None:
        self._robot, self._limits, self._problem = robot, limits, problem
        n_functions = _N_CONTROL_POINTS + 6
        breaks = np.linspace(0.0, 1.0, n_functions - _DEGREE + 1)
        knots = np.concatenate([np.zeros(_DEGREE), breaks, np.ones(_DEGREE)])
        # The three first and last control points are those of rest at the ends.
        self._splines = BSpline(knots, np.eye(n_functions)[:, 3:-3], _DEGREE)
        self.n_weights = _N_CONTROL_POINTS * robot.n_joints
        phases = np.linspace(0.0, 1.0, _N_PHASES)
        self._fixed = np.array(minimum_jerk(problem, phases))
        self._functions = self._values(phases)
        self._shares = np.full(_N_PHASES, problem.duration / (_N_PHASES - 1))
        self._shares[[0, -1]] /= 2.0
        self._scale = max(float(self._effort(np.zeros(self.n_weights))), 1e-12)
        self._bounds = self._bounded()

    def _values(self, phases: FloatArray) -> FloatArray:
        """The splines and two derivatives by time, shape (3, n_phases, n_control_points)."""
        return np.array(
            [self._splines(phases, nu=order) / self._problem.duration**order for order in range(3)]
        )

    def _states(self, weights: FloatArray) -> FloatArray:
        points = weights.reshape(_N_CONTROL_POINTS, -1)
        return np.asarray(self._fixed + self._functions @ points)

    def _effort(self, weights: FloatArray) -> float:
        tau = self._robot.inverse_dynamics(*self._states(weights))
        return float(0.5 * self._shares @ np.sum(tau**2, axis=1))

    def cost(self, weights: FloatArray) -> float:
        """J as a share of the minimum-jerk motion's."""
        return self._effort(weights) / self._scale

    def gradient(self, weights: FloatArray) -> FloatArray:
        """Its derivative by the weights."""
        tau, by_weight = self._effort_derivatives(weights)
        return np.asarray(np.einsum("k,kj,kjw->w", self._shares, tau, by_weight) / self._scale)

    def _effort_derivatives(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        tau, dtau = self._robot.inverse_dynamics_derivatives(*self._states(weights))
        n = self._robot.n_joints
        parts = dtau.reshape(len(tau), n, 3, n)
        by_weight = np.einsum("kjdi,dkc->kjci", parts, self._functions)
        return tau, by_weight.reshape(len(tau), n, self.n_weights)

    def _bounded(self) -> list[_Bound]:
        """The limits that are finite."""
        limits = self._limits
        bounds = []
        for quantity, upper in enumerate(
            (limits.upper, limits.velocity, limits.acceleration, limits.effort)
        ):
            lower = limits.lower if quantity == 0 else -upper
            joints = np.flatnonzero(np.isfinite(upper) & np.isfinite(lower))
            middle = (upper[joints] + lower[joints]) / 2.0
            bounds.append(_Bound(quantity, joints, middle, (upper[joints] - lower[joints]) / 2.0))
        return bounds

    def slack(self, weights: FloatArray) -> FloatArray:
        """What is left to the limits between the ends, as shares of them."""
        states = self._states(weights)
        values = [*states, self._robot.inverse_dynamics(*states)]
        shares = [
            (values[quantity][1:-1, joints] - middle) / half
            for quantity, joints, middle, half in self._bounds
        ]
        whole = np.concatenate([share.ravel() for share in shares])
        return np.concatenate([1.0 - whole, 1.0 + whole])

    def slack_jacobian(self, weights: FloatArray) -> FloatArray:
        """Its derivative by the weights."""
        _, by_weight = self._effort_derivatives(weights)
        n = self._robot.n_joints
        linear = np.einsum("dkc,ji->dkjci", self._functions, np.eye(n))
        linear = linear.reshape(3, _N_PHASES, n, self.n_weights)
        rows = []
        for quantity, joints, _, half in self._bounds:
            values = by_weight if quantity == 3 else linear[quantity]
            rows.append((values[1:-1, joints] / half[:, None]).reshape(-1, self.n_weights))
        by_weights = np.concatenate(rows)
        return np.concatenate([-by_weights, by_weights])

    def trajectory(self, weights: FloatArray) -> Trajectory:
        """The motion, sampled."""
        duration = self._problem.duration
        phases = np.linspace(0.0, 1.0, int(np.ceil(duration / _PERIOD)) + 1)
        states = np.array(minimum_jerk(self._problem, phases))
        states = states + self._values(phases) @ weights.reshape(_N_CONTROL_POINTS, -1)
        return Trajectory(self._robot.joint_names, phases * duration, *states)
