# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planners of others on the same problems: Crocoddyl; among obstacles OMPL with TOPP-RA."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from methods import Method, PeerResult, minimum_jerk
from support.motion_referee import RigidArm
from support.problems import Problem, Scene

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import require
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.search.detours import sampled_path

# Weights of costs are multiples of the mean of ½‖τ‖² of the minimum-jerk motion. With these, goal
# errors are below 0.1 mrad and limit violations about 0.5 %; larger ones take more iterations.
_GOAL_WEIGHT = 1e4
_BARRIER_WEIGHT = 1e2
# Longest time step [s].
_STEP = 0.01
# Relative difference from the converged cost that ends a timed run.
_CONVERGENCE = 0.01
# Iterations after which a run has converged.
_MAX_ITERATIONS = 200


def crocoddyl_method(scene: Scene, max_time: float) -> Method:
    """Crocoddyl's FDDP, run until it is within 1 % of its own converged cost.

    The states at every step are the unknowns: semi-implicit Euler integration, J = ½∫‖τ‖²dt as the
    running cost, the goal as a terminal cost, limits of positions and velocities as quadratic
    barriers. The controls are the accelerations, which converges better than efforts as controls;
    the limits of the efforts are a barrier, too.

    A run to convergence without a clock finds the number of iterations after which the cost stays
    within 1 % of the last one; the timed runs do as many. Threads may slow each other down.
    Therefore the faster of two runs counts: one with the solver's default number of threads, and
    one with a single thread.
    """
    shooting = _Shooting(scene)
    iterations: dict[Problem, int] = {}

    def solve(problem: Problem) -> PeerResult:
        """Solve one problem; the time to set it up is not counted."""
        if problem not in iterations:
            iterations[problem] = _iterations_needed(shooting, problem, max_time)
        if iterations[problem] == 0:
            return PeerResult(None, float("nan"), status=f"not converged in {max_time:g} s")
        took = []
        for one_thread in (False, True):
            solver, states, controls = shooting.set_up(problem)
            if one_thread:
                solver.problem.nthreads = 1
            began = time.perf_counter()
            solver.solve(states, controls, iterations[problem], False)
            took.append(time.perf_counter() - began)
        motion = shooting.trajectory(solver.xs, problem)
        return PeerResult(motion, min(took), iterations[problem])

    about = (
        f"Crocoddyl's FDDP, efforts by a barrier, steps of {1e3 * _STEP:g} ms, until within "
        f"{_CONVERGENCE:.0%} of its own converged cost"
    )
    return Method("fddp", about, solve, slow=True)


def _iterations_needed(shooting: _Shooting, problem: Problem, max_time: float) -> int:
    """Iterations after which the cost stays within 1 % of the converged one, 0 if never."""
    solver, states, controls = shooting.set_up(problem)
    deadline = time.perf_counter() + max_time
    costs: list[float] = []

    class Recorder(shooting.crocoddyl.CallbackAbstract):  # type: ignore[misc, name-defined]
        def __call__(self, running: Any) -> None:
            costs.append(running.cost if running.isFeasible else np.inf)
            if time.perf_counter() > deadline:
                raise TimeoutError

    solver.setCallbacks([Recorder()])
    try:
        solver.solve(states, controls, _MAX_ITERATIONS, False)
    except TimeoutError:
        return 0
    if not costs or not np.isfinite(costs[-1]):
        return 0
    outside = np.flatnonzero(np.abs(np.array(costs) / costs[-1] - 1.0) > _CONVERGENCE)
    return int(outside[-1]) + 2 if outside.size else 1


class _Shooting:
    """Problems of one scene as Crocoddyl's shooting problems."""

    def __init__(self, scene: Scene) -> None:
        self.crocoddyl = require("crocoddyl", "peers", "the peer 'fddp'")
        self._limits = scene.limits
        self._joints = scene.robot.joint_names
        self._arm = RigidArm(scene.urdf, self._joints)
        self._state = self.crocoddyl.StateMultibody(self._arm.model)
        self._actuation = self.crocoddyl.ActuationModelFull(self._state)

    def set_up(self, problem: Problem) -> tuple[Any, list[FloatArray], list[FloatArray]]:
        """The solver, and the minimum-jerk motion with its controls as a start."""
        crocoddyl, arm = self.crocoddyl, self._arm
        n_steps = int(np.ceil(problem.duration / _STEP))
        q, v, a = minimum_jerk(problem, np.linspace(0.0, 1.0, n_steps + 1))
        guess = [np.r_[arm.configuration(x), arm.velocity(y)] for x, y in zip(q, v, strict=True)]
        tau = [arm.velocity(x) for x in arm.efforts(q, v, a)[:-1]]
        controls = [arm.velocity(x) for x in a[:-1]]
        unit = 0.5 * float(np.mean(np.sum(np.square(tau), axis=1)))
        running = self._action(self._running_costs(unit), problem.duration / n_steps)
        ending = crocoddyl.CostModelSum(self._state)
        target = np.r_[arm.configuration(problem.goal), v[-1]]
        residual = crocoddyl.ResidualModelState(self._state, target)
        goal = crocoddyl.CostModelResidual(self._state, residual)
        ending.addCost("goal", goal, _GOAL_WEIGHT * unit)
        final = self._action(ending, 0.0)
        shooting = crocoddyl.ShootingProblem(guess[0], [running] * n_steps, final)
        return crocoddyl.SolverFDDP(shooting), guess, controls

    def _running_costs(self, unit: float) -> Any:
        """J, and barriers for the limits."""
        crocoddyl, state, arm, limits = self.crocoddyl, self._state, self._arm, self._limits
        effort = crocoddyl.ResidualModelJointEffort(
            state, self._actuation, np.zeros(state.nv), state.nv
        )
        costs = crocoddyl.CostModelSum(state)
        costs.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1.0)
        lower = np.r_[arm.velocity(limits.lower), -arm.velocity(limits.velocity)]
        upper = np.r_[arm.velocity(limits.upper), arm.velocity(limits.velocity)]
        of_states = crocoddyl.ResidualModelState(state, state.zero())
        weight = _BARRIER_WEIGHT
        costs.addCost("states", self._barrier(of_states, lower, upper), weight * unit)
        bound = arm.velocity(limits.effort)
        costs.addCost("efforts", self._barrier(effort, -bound, bound), weight)
        return costs

    def _barrier(self, residual: Any, lower: FloatArray, upper: FloatArray) -> Any:
        crocoddyl = self.crocoddyl
        bounds = crocoddyl.ActivationBounds(lower, upper)
        barrier = crocoddyl.ActivationModelQuadraticBarrier(bounds)
        return crocoddyl.CostModelResidual(self._state, barrier, residual)

    def _action(self, costs: Any, step: float) -> Any:
        """One step of the dynamics with its costs."""
        crocoddyl = self.crocoddyl
        parts = self._state, self._actuation, costs
        dynamics = crocoddyl.DifferentialActionModelFreeInvDynamics(*parts)
        return crocoddyl.IntegratedActionModelEuler(dynamics, step)

    def trajectory(self, states: Any, problem: Problem) -> Trajectory:
        """Positions and their finite differences, which avoid the error of an Euler step."""
        arm = self._arm
        x = np.array(states)
        q = np.array([arm.angles(configuration) for configuration in x[:, : arm.model.nq]])
        # A cosine and a sine do not count full turns, so each step is the smallest possible.
        q = np.where(arm.continuous, np.unwrap(np.vstack([problem.start, q]), axis=0)[1:], q)
        times = np.linspace(0.0, problem.duration, len(q))
        v = np.gradient(q, times, axis=0)
        v[[0, -1]] = x[[0, -1], arm.model.nq :][:, arm.velocity_index]
        return Trajectory(self._joints, times, q, v, np.gradient(v, times, axis=0))


def ompl_method(scene: Scene, max_time: float) -> Method:
    """RRT-Connect of OMPL with shortcuts and smoothing, then TOPP-RA."""
    collision, limits = scene.collision, scene.limits
    assert collision is not None

    def search(problem: Problem) -> tuple[FloatArray | None, float]:
        """Search a path with the planner's own distances."""
        began = time.perf_counter()
        path = sampled_path(
            collision.collides,
            (limits.lower, limits.upper),
            (problem.start, problem.goal),
            lambda: time.perf_counter() - began > max_time,
            step=0.05,
            smooths=True,
        )
        return path, time.perf_counter() - began

    about = (
        "RRT-Connect of OMPL, shortcuts and smoothing, then TOPP-RA within the limits of "
        "velocities and accelerations"
    )
    return _along_paths("ompl_toppra", about, scene, search)


def _along_paths(
    name: str,
    about: str,
    scene: Scene,
    search: Callable[[Problem], tuple[FloatArray | None, float]],
) -> Method:
    """A search that returns a path and the time it took, then TOPP-RA.

    TOPP-RA keeps velocities and accelerations; jerks and efforts are not kept.
    """
    toppra = require("toppra", "peers", f"the peer '{name}'")
    limits, both, bounds = scene.limits, np.array([-1.0, 1.0]), toppra.constraint
    constraints = [bounds.JointVelocityConstraint(np.outer(limits.velocity, both))]
    if np.isfinite(limits.acceleration).all():
        bound = np.outer(limits.acceleration, both)
        constraints.append(bounds.JointAccelerationConstraint(bound))

    def timed(path: FloatArray) -> Any:
        """The time-optimal motion along a path; None if there is none."""
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        path, lengths = path[np.append(True, lengths > 1e-6)], lengths[lengths > 1e-6]
        spline = toppra.SplineInterpolator(np.append(0.0, np.cumsum(lengths)), path)
        return toppra.algorithm.TOPPRA(constraints, spline).compute_trajectory()

    def solve(problem: Problem) -> PeerResult:
        """Find a path, and the shortest motion along it."""
        path, searched = search(problem)
        began = time.perf_counter()
        motion = None if path is None else timed(path)
        took = searched + time.perf_counter() - began
        if motion is None:
            what = "no path was found" if path is None else "the path could not be parametrised"
            return PeerResult(None, took, status=what, path_time=searched)
        # At most 10 ms apart.
        times = np.linspace(0.0, motion.duration, int(np.ceil(motion.duration / 0.01)) + 1)
        states = [motion(times, order) for order in range(3)]
        trajectory = Trajectory(limits.joint_names, times, *states)
        return PeerResult(trajectory, took, path_time=searched)

    return Method(name, about, solve)
