# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""SciPy's SLSQP on B-splines, a standard optimiser on the baseline of [P].

The same B-splines with 6 control points per joint as the planner's, the same J, and the same
limits at evenly spaced phases, written without the planner's compiler. Gradients come from SciPy's
finite differences, or from Pinocchio.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import minimize

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from .method import SOLVED, Method, PeerResult
from .problems import Problem, Scene
from .without_optimisation import minimum_jerk, sample_times

_N_CONTROL_POINTS, _DEGREE = 6, 5
_N_PHASES = 41


def slsqp_method(scene: Scene, max_time: float, *, differences: bool) -> Method:
    """SLSQP, started from the minimum-jerk motion."""

    def solve(problem: Problem) -> PeerResult:
        """Solve one problem."""
        program = SplineProgram(scene, problem)
        began = time.perf_counter()

        def stop_late(_: FloatArray) -> None:
            """Raise an error when the time limit is exceeded."""
            if time.perf_counter() > began + max_time:
                raise TimeoutError

        exact = {} if differences else {"jac": program.slack_rows}
        try:
            found = minimize(
                program.cost,
                np.zeros(program.n_weights),
                jac=None if differences else program.gradient,
                constraints=[{"type": "ineq", "fun": program.slack, **exact}],
                method="SLSQP",
                callback=stop_late,
                options={"maxiter": 200, "ftol": 1e-6},
            )
        except TimeoutError:
            took = time.perf_counter() - began
            return PeerResult(None, took, status=f"not converged in {max_time:g} s")
        took = time.perf_counter() - began
        status = SOLVED if found.success else str(found.message)
        return PeerResult(program.trajectory(found.x), took, int(found.nit), status)

    kind = "finite differences" if differences else "analytic gradients"
    about = (
        f"SciPy's SLSQP on B-splines, {_N_CONTROL_POINTS} control points per joint, {kind}, limits "
        f"at {_N_PHASES} phases"
    )
    name = "slsqp_differences" if differences else "slsqp_gradients"
    return Method(name, about, solve, slow=True)


class SplineProgram:
    """One problem as functions of the free control points.

    Positions, velocities, accelerations and efforts between the ends are limited. Distances to
    limits are given as shares of half the width of the range.

    Attributes
    ----------
    n_weights : int
        Number of unknowns.
    """

    def __init__(self, scene: Scene, problem: Problem) -> None:
        self._robot, self._problem = scene.robot, problem
        n_functions = _N_CONTROL_POINTS + 6
        breaks = np.linspace(0.0, 1.0, n_functions - _DEGREE + 1)
        knots = np.concatenate([np.zeros(_DEGREE), breaks, np.ones(_DEGREE)])
        # The three first and three last control points express rest at the ends.
        self._splines = BSpline(knots, np.eye(n_functions)[:, 3:-3], _DEGREE)
        self.n_weights = _N_CONTROL_POINTS * scene.robot.n_joints
        phases = np.linspace(0.0, 1.0, _N_PHASES)
        self._fixed = np.array(minimum_jerk(problem, phases))
        self._functions = self._values(phases)
        self._shares = np.full(_N_PHASES, problem.duration / (_N_PHASES - 1))
        self._shares[[0, -1]] /= 2.0
        self._unit = 1.0
        self._unit = max(self.cost(np.zeros(self.n_weights)), 1e-12)
        limits = scene.limits
        upper = np.array([limits.upper, limits.velocity, limits.acceleration, limits.effort])
        lower = np.array([limits.lower, *-upper[1:]])
        self._is_limited = np.isfinite(upper) & np.isfinite(lower)
        lower, upper = lower[self._is_limited], upper[self._is_limited]
        self._middles, self._half_widths = (upper + lower) / 2.0, (upper - lower) / 2.0

    def _values(self, phases: FloatArray) -> FloatArray:
        """The splines and two derivatives by time, shape (3, n_phases, n_control_points)."""
        return np.array(
            [self._splines(phases, nu=order) / self._problem.duration**order for order in range(3)]
        )

    def _states(self, weights: FloatArray) -> FloatArray:
        points = weights.reshape(_N_CONTROL_POINTS, -1)
        return np.asarray(self._fixed + self._functions @ points)

    def cost(self, weights: FloatArray) -> float:
        """J as a share of the minimum-jerk motion's."""
        tau = self._robot.inverse_dynamics(*self._states(weights))
        return float(0.5 * self._shares @ np.sum(tau**2, axis=1)) / self._unit

    def gradient(self, weights: FloatArray) -> FloatArray:
        """Its derivative by the weights."""
        tau, rows = self._effort_rows(weights)
        return np.asarray(np.einsum("k,kj,kjw->w", self._shares, tau, rows) / self._unit)

    def _effort_rows(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Efforts and their derivatives, shape (n_phases, n_joints, n_weights)."""
        tau, dtau = self._robot.inverse_dynamics_derivatives(*self._states(weights))
        n = self._robot.n_joints
        parts = dtau.reshape(len(tau), n, 3, n)
        rows = np.einsum("kjdi,dkc->kjci", parts, self._functions)
        return tau, rows.reshape(len(tau), n, self.n_weights)

    def slack(self, weights: FloatArray) -> FloatArray:
        """Distances to the upper and the lower limits, shape (n_bounds,)."""
        states = self._states(weights)
        values = np.array([*states, self._robot.inverse_dynamics(*states)])[:, 1:-1]
        limited = values.transpose(0, 2, 1)[self._is_limited]
        shares = (limited - self._middles[:, None]) / self._half_widths[:, None]
        return np.concatenate([1.0 - shares.ravel(), 1.0 + shares.ravel()])

    def slack_rows(self, weights: FloatArray) -> FloatArray:
        """Its derivatives by the weights, shape (n_bounds, n_weights)."""
        n = self._robot.n_joints
        linear = np.einsum("dkc,ji->dkjci", self._functions, np.eye(n))
        _, efforts = self._effort_rows(weights)
        rows = np.array([*linear.reshape(3, _N_PHASES, n, -1), efforts])[:, 1:-1]
        limited = rows.transpose(0, 2, 1, 3)[self._is_limited] / self._half_widths[:, None, None]
        shares = limited.reshape(-1, self.n_weights)
        return np.concatenate([-shares, shares])

    def trajectory(self, weights: FloatArray) -> Trajectory:
        """The motion, sampled."""
        times = sample_times(self._problem.duration)
        phases = times / self._problem.duration
        states = np.array(minimum_jerk(self._problem, phases))
        states = states + self._values(phases) @ weights.reshape(_N_CONTROL_POINTS, -1)
        return Trajectory(self._robot.joint_names, times, *states)
