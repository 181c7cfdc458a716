# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Crocoddyl's FDDP and BoxFDDP on the same problems.

There the states at every step are the unknowns: semi-implicit Euler integration, J = ½∫‖τ‖²dt
as the running cost, the goal as a terminal cost, limits of positions and velocities as quadratic
barriers. BoxFDDP has the efforts as controls, with hard limits; FDDP has the accelerations, which
suits it better, and limits of the efforts are a barrier.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from .check import RigidArm
from .method import Answer, import_peer
from .problems import Problem, Scene
from .without_optimisation import minimum_jerk

_STEP = 0.01  # [s]
# Weights of the terminal cost and of the barriers, as multiples of the mean of ½‖τ‖² at the start:
# goals are missed by less than 0.1 mrad, and limits broken by about 0.5 %. With larger ones it
# takes more iterations.
_GOAL_WEIGHT = 1e4
_BARRIER_WEIGHT = 1e2
_WITHIN = 0.01
_MOST_ITERATIONS = 200


class DifferentialDynamicProgramming:
    """One of Crocoddyl's solvers, run until it is within 1 % of its own converged cost.

    An untimed run to convergence finds the number of iterations after which the cost stays
    within 1 % of the last one; the runs that are timed do as many. The faster one counts of one
    with as many threads as it takes by itself, which may get in each other's way, and one with a
    single thread.
    """

    slow = True

    def __init__(self, scene: Scene, max_time: float, *, box: bool) -> None:
        self._crocoddyl = import_peer("crocoddyl", "the peers 'fddp' and 'box_fddp'")
        self.name = "box_fddp" if box else "fddp"
        self.about = (
            f"Crocoddyl's {'BoxFDDP, efforts limited' if box else 'FDDP, efforts by a barrier'}, "
            f"steps of {1e3 * _STEP:g} ms, until within {_WITHIN:.0%} of its own converged cost"
        )
        self._box = box
        self._limits = scene.limits
        self._joints = scene.robot.joint_names
        self._arm = RigidArm(scene.urdf, self._joints)
        self._max_time = max_time
        self._enough: dict[Problem, int] = {}

    def solve(self, problem: Problem) -> Answer:
        """Solve one problem; the time to set it up is not counted."""
        enough = self._enough.get(problem)
        if enough is None:
            enough = self._enough[problem] = self._iterations(problem)
        if enough == 0:
            return Answer(None, float("nan"), status=f"not converged in {self._max_time:g} s")
        took = []
        for one_thread in (False, True):
            solver, states, efforts = self._set_up(problem)
            if one_thread:
                solver.problem.nthreads = 1
            began = time.perf_counter()
            solver.solve(states, efforts, enough, False)
            took.append(time.perf_counter() - began)
        return Answer(self._trajectory(solver.xs, problem), min(took), enough)

    def _iterations(self, problem: Problem) -> int:
        """Iterations after which the cost stays within 1 % of the converged one, 0 if never."""
        solver, states, efforts = self._set_up(problem)
        deadline = time.perf_counter() + self._max_time
        costs: list[float] = []

        class Watch(self._crocoddyl.CallbackAbstract):  # type: ignore[misc, name-defined]
            def __call__(self, running: Any) -> None:
                costs.append(running.cost if running.isFeasible else np.inf)
                if time.perf_counter() > deadline:
                    raise TimeoutError

        solver.setCallbacks([Watch()])
        try:
            solver.solve(states, efforts, _MOST_ITERATIONS, False)
        except TimeoutError:
            return 0
        if not costs or not np.isfinite(costs[-1]):
            return 0
        outside = np.flatnonzero(np.abs(np.array(costs) / costs[-1] - 1.0) > _WITHIN)
        return int(outside[-1]) + 2 if outside.size else 1

    def _set_up(self, problem: Problem) -> tuple[Any, list[FloatArray], list[FloatArray]]:
        """The solver, and the minimum-jerk motion with its efforts as a start."""
        crocoddyl, arm = self._crocoddyl, self._arm
        state = crocoddyl.StateMultibody(arm.model)
        n_steps = _n_steps(problem)
        q, v, a = minimum_jerk(problem, np.linspace(0.0, 1.0, n_steps + 1))
        guess = [np.r_[arm.configuration(x), arm.velocity(y)] for x, y in zip(q, v, strict=True)]
        tau = [arm.velocity(x) for x in arm.efforts(q, v, a)[:-1]]
        controls = tau if self._box else [arm.velocity(x) for x in a[:-1]]
        unit = 0.5 * float(np.mean(np.sum(np.square(tau), axis=1)))
        running = self._action(state, self._running_costs(state, unit), problem.duration / n_steps)
        ending = crocoddyl.CostModelSum(state)
        aim = crocoddyl.ResidualModelState(state, np.r_[arm.configuration(problem.goal), v[-1]])
        ending.addCost("goal", crocoddyl.CostModelResidual(state, aim), _GOAL_WEIGHT * unit)
        final = self._action(state, ending, 0.0)
        shooting = crocoddyl.ShootingProblem(guess[0], [running] * n_steps, final)
        kind = crocoddyl.SolverBoxFDDP if self._box else crocoddyl.SolverFDDP
        return kind(shooting), guess, controls

    def _running_costs(self, state: Any, unit: float) -> Any:
        crocoddyl, arm, limits = self._crocoddyl, self._arm, self._limits
        costs = crocoddyl.CostModelSum(state)
        effort = self._effort(state)
        costs.addCost("effort", crocoddyl.CostModelResidual(state, effort), 1.0)
        neutral = crocoddyl.ResidualModelState(state, state.zero())
        upper = np.r_[arm.velocity(limits.upper), arm.velocity(limits.velocity)]
        lower = np.r_[arm.velocity(limits.lower), -arm.velocity(limits.velocity)]
        self._bound(costs, "states", state, neutral, lower, upper, unit)
        if not self._box:
            bound = arm.velocity(limits.effort)
            self._bound(costs, "efforts", state, effort, -bound, bound, 1.0)
        return costs

    def _effort(self, state: Any) -> Any:
        """The efforts: of BoxFDDP the controls, of FDDP what its accelerations take."""
        crocoddyl = self._crocoddyl
        if self._box:
            return crocoddyl.ResidualModelControl(state, state.nv)
        actuation = crocoddyl.ActuationModelFull(state)
        return crocoddyl.ResidualModelJointEffort(state, actuation, np.zeros(state.nv), state.nv)

    def _bound(
        self,
        costs: Any,
        name: str,
        state: Any,
        residual: Any,
        lower: FloatArray,
        upper: FloatArray,
        unit: float,
    ) -> None:
        crocoddyl = self._crocoddyl
        bounds = crocoddyl.ActivationBounds(lower, upper)
        barrier = crocoddyl.ActivationModelQuadraticBarrier(bounds)
        cost = crocoddyl.CostModelResidual(state, barrier, residual)
        costs.addCost(name, cost, _BARRIER_WEIGHT * unit)

    def _action(self, state: Any, costs: Any, step: float) -> Any:
        crocoddyl = self._crocoddyl
        actuation = crocoddyl.ActuationModelFull(state)
        if self._box:
            dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
            # With Pinocchio 4 its other path, by `aba`, leaves gravity out (3.2.1).
            dynamics.armature = np.zeros(state.nv)
        else:
            dynamics = crocoddyl.DifferentialActionModelFreeInvDynamics(state, actuation, costs)
        action = crocoddyl.IntegratedActionModelEuler(dynamics, step)
        if self._box:
            bound = self._arm.velocity(self._limits.effort)
            action.u_lb, action.u_ub = -bound, bound
        return action

    def _trajectory(self, states: Any, problem: Problem) -> Trajectory:
        """Its positions with their differences, which have no Euler step's error."""
        arm = self._arm
        x = np.array(states)
        q = np.array([arm.angles(configuration) for configuration in x[:, : arm.model.nq]])
        # Cosine and sine know no turns: each step is the smallest one.
        q = np.where(arm.continuous, np.unwrap(np.vstack([problem.start, q]), axis=0)[1:], q)
        at_ends = x[[0, -1], arm.model.nq :][:, arm.velocity_index]
        times = np.linspace(0.0, problem.duration, len(q))
        v = np.gradient(q, times, axis=0)
        v[[0, -1]] = at_ends
        return Trajectory(self._joints, times, q, v, np.gradient(v, times, axis=0))


def _n_steps(problem: Problem) -> int:
    return int(np.ceil(problem.duration / _STEP))
