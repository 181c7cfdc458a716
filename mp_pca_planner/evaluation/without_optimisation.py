# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Methods that optimise nothing: the minimum-jerk motion, ProMP, DMP and Ruckig.

They know no efforts; limits hold where the motions happen to keep them (Ruckig keeps velocities
and accelerations).
"""

from __future__ import annotations

import time

import numpy as np
from scipy.interpolate import make_interp_spline

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from .method import Answer, import_peer
from .problems import Problem, Scene

_N_POINTS = 101
_PERIOD = 0.01  # [s]


class MinimumJerk:
    """The quintic polynomial from rest to rest (Flash and Hogan, J. Neurosci. 5(7), 1985)."""

    name = "minimum_jerk"
    about = "the quintic polynomial from rest to rest"
    slow = False

    def __init__(self, scene: Scene) -> None:
        self._joints = scene.robot.joint_names

    def solve(self, problem: Problem) -> Answer:
        """Evaluate it."""
        began = time.perf_counter()
        phases = np.linspace(0.0, 1.0, _N_POINTS)
        states = minimum_jerk(problem, phases)
        took = time.perf_counter() - began
        return Answer(Trajectory(self._joints, phases * problem.duration, *states), took)


class ProbabilisticPrimitive:
    """ProMP of the package movement_primitives, conditioned on start and goal."""

    name = "promp"
    about = "ProMP of movement_primitives, conditioned on start and goal; no limits, no efforts"
    slow = False
    _N_WEIGHTS = 10

    def __init__(self, scene: Scene) -> None:
        module = import_peer("movement_primitives.promp", "the peer 'promp'")
        self._joints = scene.robot.joint_names
        shown = np.array([d.time_normalised(_N_POINTS) for d in scene.demonstrations])
        self._phases = np.linspace(0.0, 1.0, _N_POINTS)
        self._model = module.ProMP(n_dims=len(self._joints), n_weights_per_dim=self._N_WEIGHTS)
        self._model.imitate([self._phases] * len(shown), shown)

    def solve(self, problem: Problem) -> Answer:
        """Condition, and take the mean."""
        began = time.perf_counter()
        exact = 1e-8 * np.eye(len(self._joints))
        model = self._model.condition_position(problem.start, exact, t=0.0)
        model = model.condition_position(problem.goal, exact, t=1.0)
        positions = model.mean_trajectory(self._phases)
        took = time.perf_counter() - began
        return Answer(through(self._joints, self._phases * problem.duration, positions), took)


class DynamicPrimitive:
    """DMP of the package movement_primitives, of the demonstration with the nearest ends."""

    name = "dmp"
    about = "DMP of movement_primitives, of the nearest demonstration; no limits, no efforts"
    slow = False
    _N_WEIGHTS = 20

    def __init__(self, scene: Scene) -> None:
        self._dmp = import_peer("movement_primitives.dmp", "the peer 'dmp'").DMP
        self._joints = scene.robot.joint_names
        self._ends = np.array(
            [np.r_[d.positions[0], d.positions[-1]] for d in scene.demonstrations]
        )
        self._learned = [
            self._learn(d.times, d.positions, d.duration) for d in scene.demonstrations
        ]

    def _learn(self, times: FloatArray, positions: FloatArray, duration: float) -> FloatArray:
        model = self._dmp(
            n_dims=len(self._joints),
            execution_time=duration,
            dt=duration / (len(times) - 1),
            n_weights_per_dim=self._N_WEIGHTS,
        )
        model.imitate(times, positions)
        return np.asarray(model.get_weights())

    def solve(self, problem: Problem) -> Answer:
        """Integrate it to the new goal in the new time."""
        began = time.perf_counter()
        wanted = np.r_[problem.start, problem.goal]
        nearest = int(np.argmin(np.sum((self._ends - wanted) ** 2, axis=1)))
        model = self._dmp(
            n_dims=len(self._joints),
            execution_time=problem.duration,
            dt=problem.duration / (_N_POINTS - 1),
            n_weights_per_dim=self._N_WEIGHTS,
        )
        model.set_weights(self._learned[nearest])
        model.configure(start_y=problem.start, goal_y=problem.goal)
        times, positions = model.open_loop()
        took = time.perf_counter() - began
        return Answer(through(self._joints, np.asarray(times), np.asarray(positions)), took)


class TimeOptimal:
    """Ruckig: the shortest motion within velocity, acceleration and jerk limits.

    The reference for durations, not for efforts, which it does not know.
    """

    name = "ruckig"
    slow = False

    # Where there is no limit: full speed may be reached in so long, and so may be full
    # acceleration [s].
    _TO_FULL = 0.1

    def __init__(self, scene: Scene) -> None:
        self._ruckig = import_peer("ruckig", "the peer 'ruckig'")
        limits = scene.limits
        self._joints = scene.robot.joint_names
        self._velocity = np.where(np.isfinite(limits.velocity), limits.velocity, 10.0)
        self._acceleration = np.minimum(limits.acceleration, self._velocity / self._TO_FULL)
        self._jerk = np.minimum(limits.jerk, self._acceleration / self._TO_FULL)
        self.about = (
            "Ruckig, time-optimal in its own duration; accelerations and jerks without a limit may "
            f"reach full speed and full acceleration in {self._TO_FULL} s; no efforts"
        )

    def solve(self, problem: Problem) -> Answer:
        """Find the shortest motion."""
        began = time.perf_counter()
        n = len(self._joints)
        request = self._ruckig.InputParameter(n)
        request.current_position, request.target_position = list(problem.start), list(problem.goal)
        request.max_velocity = list(self._velocity)
        request.max_acceleration = list(self._acceleration)
        request.max_jerk = list(self._jerk)
        motion = self._ruckig.Trajectory(n)
        result = self._ruckig.Ruckig(n).calculate(request, motion)
        took = time.perf_counter() - began
        if result not in (self._ruckig.Result.Working, self._ruckig.Result.Finished):
            return Answer(None, took, status=str(result))
        times = np.linspace(0.0, motion.duration, int(np.ceil(motion.duration / _PERIOD)) + 1)
        states = np.array([motion.at_time(t) for t in times])
        return Answer(Trajectory(self._joints, times, *states.transpose(1, 0, 2)), took)


def minimum_jerk(problem: Problem, phases: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of the minimum-jerk motion."""
    s = phases[:, None]
    way = problem.goal - problem.start
    return (
        problem.start + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * way,
        (30.0 * s**2 - 60.0 * s**3 + 30.0 * s**4) * way / problem.duration,
        (60.0 * s - 180.0 * s**2 + 120.0 * s**3) * way / problem.duration**2,
    )


def through(joints: tuple[str, ...], times: FloatArray, positions: FloatArray) -> Trajectory:
    """The quintic spline through positions that come without derivatives."""
    curve = make_interp_spline(times, positions, k=5)
    return Trajectory(joints, times, *(curve(times, nu=order) for order in range(3)))
