# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Standard optimisers on the baseline of [P], B-splines: SciPy's SLSQP, and Drake.

SLSQP gets the same B-splines with 6 control points per joint as the planner, the same J, and the
same limits at evenly spaced phases, written without the planner's compiler. Gradients come from
SciPy's finite differences, or from Pinocchio. Drake's KinematicTrajectoryOptimization has no cost
of efforts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ..arrays import FloatArray
from ..exceptions import require
from ..motion.trajectory import Trajectory
from ..primitives.basis import BSplineBasis
from .method import SOLVED, Method, PeerResult
from .problems import Problem, Scene
from .without_optimisation import minimum_jerk, sample_times


@dataclass(frozen=True)
class SplineOptions:
    """The B-splines, and where SLSQP looks at limits.

    Attributes
    ----------
    n_control_points : int
        Free control points of each joint ([P] Section 4); six more are fixed by the ends.
    degree : int
        Degree of the splines.
    n_phases : int
        Phases at which SLSQP keeps the limits.
    """

    n_control_points: int = 6
    degree: int = 5
    n_phases: int = 41


_OPTIONS = SplineOptions()


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
        f"SciPy's SLSQP on B-splines, {_OPTIONS.n_control_points} control points per joint, "
        f"{kind}, limits at {_OPTIONS.n_phases} phases"
    )
    name = "slsqp_differences" if differences else "slsqp_gradients"
    return Method(name, about, solve, slow=True)


def drake_method(scene: Scene, _: float) -> Method:
    """B-splines of the least path energy within kinematic limits; it has no cost of efforts."""
    planning = require("pydrake.planning", "drake", "the peer 'drake'")
    solvers = require("pydrake.solvers", "drake", "the peer 'drake'")
    joints, limits = scene.robot.joint_names, scene.limits
    zero = np.zeros(len(joints))

    def solve(problem: Problem) -> PeerResult:
        """Solve one problem."""
        began = time.perf_counter()
        program = planning.KinematicTrajectoryOptimization(
            len(joints), _OPTIONS.n_control_points + 6, _OPTIONS.degree + 1, problem.duration
        )
        program.AddDurationConstraint(problem.duration, problem.duration)
        for phase, end in ((0.0, problem.start), (1.0, problem.goal)):
            program.AddPathPositionConstraint(end, end, phase)
            program.AddPathVelocityConstraint(zero, zero, phase)
            program.AddPathAccelerationConstraint(zero, zero, phase)
        program.AddPositionBounds(limits.lower, limits.upper)
        program.AddVelocityBounds(-limits.velocity, limits.velocity)
        if np.isfinite(limits.acceleration).any():
            program.AddAccelerationBounds(-limits.acceleration, limits.acceleration)
        program.AddPathEnergyCost(1.0)
        result = solvers.Solve(program.prog())
        took = time.perf_counter() - began
        if not result.is_success():
            return PeerResult(None, took, status=str(result.get_solution_result()))
        motion = program.ReconstructTrajectory(result)
        times = sample_times(problem.duration)
        # Drake's end time may differ from the duration by a rounding error.
        inside = np.clip(times, motion.start_time(), motion.end_time())
        states = [
            np.array([motion.EvalDerivative(t, order).ravel() for t in inside])
            for order in range(3)
        ]
        return PeerResult(Trajectory(joints, times, *states), took)

    about = (
        "Drake's KinematicTrajectoryOptimization, B-splines with 6 free control points per joint, "
        "least path energy within position, velocity and acceleration limits; no efforts"
    )
    return Method("drake", about, solve)


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
        n_joints = scene.robot.n_joints
        self._basis = BSplineBasis(n_joints, _OPTIONS.n_control_points, _OPTIONS.degree)
        self.n_weights = self._basis.n_weights
        phases = np.linspace(0.0, 1.0, _OPTIONS.n_phases)
        self._fixed = np.array(minimum_jerk(problem, phases))
        self._functions = self._values(phases)
        self._shares = np.full(_OPTIONS.n_phases, problem.duration / (_OPTIONS.n_phases - 1))
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
        """Derivatives of the states by the weights, shape (3, n_phases, n_joints, n_weights)."""
        rates = self._problem.duration ** -np.arange(3.0)
        return np.asarray(self._basis.tables(phases, 2)[..., 1:] * rates[:, None, None, None])

    def _states(self, weights: FloatArray) -> FloatArray:
        return np.asarray(self._fixed + self._functions @ weights)

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
        states = self._functions.transpose(1, 0, 2, 3).reshape(len(tau), -1, self.n_weights)
        return tau, dtau @ states

    def slack(self, weights: FloatArray) -> FloatArray:
        """Distances to the upper and the lower limits, shape (n_bounds,)."""
        states = self._states(weights)
        values = np.array([*states, self._robot.inverse_dynamics(*states)])[:, 1:-1]
        limited = values.transpose(0, 2, 1)[self._is_limited]
        shares = (limited - self._middles[:, None]) / self._half_widths[:, None]
        return np.concatenate([1.0 - shares.ravel(), 1.0 + shares.ravel()])

    def slack_rows(self, weights: FloatArray) -> FloatArray:
        """Its derivatives by the weights, shape (n_bounds, n_weights)."""
        _, efforts = self._effort_rows(weights)
        rows = np.array([*self._functions, efforts])[:, 1:-1]
        limited = rows.transpose(0, 2, 1, 3)[self._is_limited] / self._half_widths[:, None, None]
        shares = limited.reshape(-1, self.n_weights)
        return np.concatenate([-shares, shares])

    def trajectory(self, weights: FloatArray) -> Trajectory:
        """The motion, sampled."""
        times = sample_times(self._problem.duration)
        phases = times / self._problem.duration
        states = np.array(minimum_jerk(self._problem, phases))
        return Trajectory(
            self._robot.joint_names, times, *(states + self._values(phases) @ weights)
        )
