# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Methods without optimisation of efforts: minimum jerk, ProMP, DMP; they may break limits."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from ..arrays import FloatArray
from ..exceptions import require
from ..motion.trajectory import Trajectory
from ..primitives.boundary import hermite_functions
from ..primitives.differences import PHASES
from ..recordings.demonstration import Demonstration
from .method import Method, PeerResult
from .problems import Problem, Scene


def minimum_jerk_method(scene: Scene) -> Method:
    """The quintic polynomial from rest to rest (Flash and Hogan, J. Neurosci. 5(7), 1985)."""
    joints = scene.robot.joint_names

    def solve(problem: Problem) -> PeerResult:
        """Evaluate the polynomial."""
        began = time.perf_counter()
        states = minimum_jerk(problem, PHASES)
        took = time.perf_counter() - began
        return PeerResult(Trajectory(joints, PHASES * problem.duration, *states), took)

    return Method("minimum_jerk", "the quintic polynomial from rest to rest", solve)


def promp_method(scene: Scene, _: float) -> Method:
    """ProMP of the package movement_primitives, conditioned on start and goal."""
    module = require("movement_primitives.promp", "peers", "the peer 'promp'")
    joints = scene.robot.joint_names
    shown = np.array([motion.time_normalised(PHASES.size) for motion in scene.demonstrations])
    model = module.ProMP(n_dims=len(joints), n_weights_per_dim=10)
    model.imitate([PHASES] * len(shown), shown)
    exact = 1e-8 * np.eye(len(joints))

    def solve(problem: Problem) -> PeerResult:
        """Condition the ProMP on both ends, and return its mean."""
        began = time.perf_counter()
        from_start = model.condition_position(problem.start, exact, t=0.0)
        conditioned = from_start.condition_position(problem.goal, exact, t=1.0)
        positions = conditioned.mean_trajectory(PHASES)
        took = time.perf_counter() - began
        return PeerResult(_through(joints, PHASES * problem.duration, positions), took)

    about = "ProMP of movement_primitives, conditioned on start and goal; no limits, no efforts"
    return Method("promp", about, solve)


def dmp_method(scene: Scene, _: float) -> Method:
    """DMP of the package movement_primitives, of the demonstration with the nearest ends."""
    module = require("movement_primitives.dmp", "peers", "the peer 'dmp'")
    joints = scene.robot.joint_names

    def model_of(duration: float, n_steps: int) -> Any:
        """An untrained DMP."""
        step = duration / n_steps
        return module.DMP(
            n_dims=len(joints), execution_time=duration, dt=step, n_weights_per_dim=20
        )

    def learn(motion: Demonstration) -> FloatArray:
        """Weights of a DMP trained with a motion."""
        model = model_of(motion.duration, len(motion.times) - 1)
        model.imitate(motion.times, motion.positions)
        return np.asarray(model.get_weights())

    learned = [learn(motion) for motion in scene.demonstrations]
    ends = np.array([motion.positions[[0, -1]] for motion in scene.demonstrations])

    def solve(problem: Problem) -> PeerResult:
        """Integrate the DMP to the new goal with the new duration."""
        began = time.perf_counter()
        distances = np.sum((ends - [problem.start, problem.goal]) ** 2, axis=(1, 2))
        model = model_of(problem.duration, PHASES.size - 1)
        model.set_weights(learned[int(np.argmin(distances))])
        model.configure(start_y=problem.start, goal_y=problem.goal)
        times, positions = model.open_loop()
        took = time.perf_counter() - began
        return PeerResult(_through(joints, np.asarray(times), np.asarray(positions)), took)

    about = "DMP of movement_primitives, of the nearest demonstration; no limits, no efforts"
    return Method("dmp", about, solve)


def minimum_jerk(problem: Problem, phases: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of the minimum-jerk motion."""
    ends = np.array([problem.start, problem.goal])
    q, v, a = (
        hermite_functions(phases, d)[:, [0, 3]] @ ends / problem.duration**d for d in range(3)
    )
    return q, v, a


def _through(joints: tuple[str, ...], times: FloatArray, positions: FloatArray) -> Trajectory:
    """The quintic spline through positions without given derivatives."""
    curve = make_interp_spline(times, positions, k=5)
    return Trajectory(joints, times, *(curve(times, nu=order) for order in range(3)))
