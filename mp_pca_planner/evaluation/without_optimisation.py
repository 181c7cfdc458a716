# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Methods without optimisation of efforts: minimum jerk, ProMP, DMP, Ruckig.

They may break limits, except the last.
"""

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


def ruckig_method(scene: Scene, _: float) -> Method:
    """Ruckig: the shortest motion within velocity, acceleration and jerk limits.

    A reference for durations, not for efforts. Where an acceleration or a jerk has no limit, full
    speed or full acceleration is reached in 0.1 s.
    """
    ruckig = require("ruckig", "peers", "the peer 'ruckig'")
    joints, limits = scene.robot.joint_names, scene.limits
    velocity = np.where(np.isfinite(limits.velocity), limits.velocity, 10.0)
    acceleration = np.minimum(limits.acceleration, velocity / 0.1)
    jerk = np.minimum(limits.jerk, acceleration / 0.1)

    def solve(problem: Problem) -> PeerResult:
        """Find the shortest motion."""
        began = time.perf_counter()
        request = ruckig.InputParameter(len(joints))
        request.current_position, request.target_position = list(problem.start), list(problem.goal)
        request.max_velocity, request.max_acceleration = list(velocity), list(acceleration)
        request.max_jerk = list(jerk)
        motion = ruckig.Trajectory(len(joints))
        result = ruckig.Ruckig(len(joints)).calculate(request, motion)
        took = time.perf_counter() - began
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            return PeerResult(None, took, status=str(result))
        times = sample_times(motion.duration)
        states = np.array([motion.at_time(t) for t in times])
        return PeerResult(Trajectory(joints, times, *states.transpose(1, 0, 2)), took)

    about = (
        "Ruckig, time-optimal in its own duration; accelerations and jerks without a limit may "
        "reach full speed and full acceleration in 0.1 s; no efforts"
    )
    return Method("ruckig", about, solve)


def minimum_jerk(problem: Problem, phases: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of the minimum-jerk motion."""
    ends = np.array([problem.start, problem.goal])
    q, v, a = (
        hermite_functions(phases, d)[:, [0, 3]] @ ends / problem.duration**d for d in range(3)
    )
    return q, v, a


def sample_times(duration: float) -> FloatArray:
    """Times of the points of a trajectory, at most 10 ms apart."""
    return np.linspace(0.0, duration, int(np.ceil(duration / 0.01)) + 1)


def _through(joints: tuple[str, ...], times: FloatArray, positions: FloatArray) -> Trajectory:
    """The quintic spline through positions without given derivatives."""
    curve = make_interp_spline(times, positions, k=5)
    return Trajectory(joints, times, *(curve(times, nu=order) for order in range(3)))
