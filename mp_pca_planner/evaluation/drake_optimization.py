# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Drake's KinematicTrajectoryOptimization on the same problems."""

from __future__ import annotations

import time

import numpy as np

from ..motion.trajectory import Trajectory
from .method import Method, PeerResult, import_peer
from .problems import Problem, Scene
from .without_optimisation import sample_times

_N_CONTROL_POINTS = 12  # fixed ones at the ends included
_ORDER = 6


def drake_method(scene: Scene, _: float) -> Method:
    """B-splines of the least path energy within kinematic limits; it has no cost of efforts."""
    planning = import_peer("pydrake.planning", "the peer 'drake'", "drake")
    solvers = import_peer("pydrake.solvers", "the peer 'drake'", "drake")
    joints, limits = scene.robot.joint_names, scene.limits
    zero = np.zeros(len(joints))

    def solve(problem: Problem) -> PeerResult:
        """Solve one problem."""
        began = time.perf_counter()
        program = planning.KinematicTrajectoryOptimization(
            len(joints), _N_CONTROL_POINTS, _ORDER, problem.duration
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
