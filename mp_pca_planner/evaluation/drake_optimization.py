# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Drake's KinematicTrajectoryOptimization on the same problems."""

from __future__ import annotations

import time

import numpy as np

from ..motion.trajectory import Trajectory
from .method import Answer, import_peer
from .problems import Problem, Scene

_N_CONTROL_POINTS = 12
_ORDER = 6
_PERIOD = 0.01  # [s]


class DrakeOptimization:
    """B-splines of the least path energy within kinematic limits; it has no cost of efforts."""

    name = "drake"
    about = (
        "Drake's KinematicTrajectoryOptimization, B-splines with 6 free control points per joint, "
        "least path energy within position, velocity and acceleration limits; no efforts"
    )
    slow = False

    def __init__(self, scene: Scene, max_time: float) -> None:
        module = import_peer("pydrake.planning", "the peer 'drake'", "drake")
        self._program = module.KinematicTrajectoryOptimization
        self._solve = import_peer("pydrake.solvers", "the peer 'drake'", "drake").Solve
        self._limits = scene.limits
        self._joints = scene.robot.joint_names

    def solve(self, problem: Problem) -> Answer:
        """Solve one problem."""
        began = time.perf_counter()
        n, limits = len(self._joints), self._limits
        program = self._program(n, _N_CONTROL_POINTS, _ORDER, problem.duration)
        program.AddDurationConstraint(problem.duration, problem.duration)
        zero = np.zeros(n)
        for phase, end in ((0.0, problem.start), (1.0, problem.goal)):
            program.AddPathPositionConstraint(end, end, phase)
            program.AddPathVelocityConstraint(zero, zero, phase)
            program.AddPathAccelerationConstraint(zero, zero, phase)
        program.AddPositionBounds(limits.lower, limits.upper)
        program.AddVelocityBounds(-limits.velocity, limits.velocity)
        if np.isfinite(limits.acceleration).any():
            program.AddAccelerationBounds(-limits.acceleration, limits.acceleration)
        program.AddPathEnergyCost(1.0)
        result = self._solve(program.prog())
        took = time.perf_counter() - began
        if not result.is_success():
            return Answer(None, took, status=str(result.get_solution_result()))
        motion = program.ReconstructTrajectory(result)
        times = np.linspace(0.0, problem.duration, int(np.ceil(problem.duration / _PERIOD)) + 1)
        # Its end time may differ from the duration in the last digit.
        inside = np.clip(times, motion.start_time(), motion.end_time())
        states = [
            np.array([motion.EvalDerivative(t, order).ravel() for t in inside])
            for order in range(3)
        ]
        return Answer(Trajectory(self._joints, times, *states), took)
