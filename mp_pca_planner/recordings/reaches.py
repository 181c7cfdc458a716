# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Made-up reaches of any arm within its limits, where nobody has recorded any.

All motions of one task go from about one posture to about another with the same kind of detour,
as the demonstrations of one task do; each has its own ends, timing and haste.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .demonstration import Demonstration
from .synthetic import bell, progress

# Joints that turn far are used within this distance of the middle of their range [rad or m].
_MOST_REACH = 2.0
# Joints that turn without end never have to go half a turn: which way would they?
_REACH_OF_CONTINUOUS = 1.5
# Part of that range in which the postures of a task are, and by how much they differ in it.
_POSTURES, _SPREAD = 0.6, 0.12
# Least length of the way between them, as a share of the longest possible.
_LEAST_WAY = 0.25
_DETOUR = 0.12
_DETOUR_SPREAD = 0.4
_PEAK = (0.44, 0.52)
_JOINT_PEAK_SHIFT = 0.02
_DETOUR_PEAK = (0.4, 0.6)
# Peak speeds and efforts as shares of the limits.
_HASTE = (0.6, 0.95)
_SHORTEST = 0.4  # [s]
_MOST_DRAWS = 1000
_MOST_STRETCHES = 30
_RATE = 100.0  # [Hz]
_N_PHASES = 101


def random_reaches(
    robot: Robot, limits: JointLimits, n_motions: int, seed: int, *, task: int = 0
) -> list[Demonstration]:
    """Make up reaches that keep the limits of a robot.

    Parameters
    ----------
    robot : Robot
        The arm.
    limits : JointLimits
        Limits of its joints; jerks are not looked at.
    n_motions : int
        How many, at least 1.
    seed : int
        Chooses the motions. The first ones don't depend on how many there are.
    task : int
        Chooses where they go from and to, and their detours.

    Raises
    ------
    RecordingError
        If the number is too small, or no reach keeps the limits.
    """
    if n_motions < 1:
        raise RecordingError(f"the number of motions must be at least 1, got {n_motions}")
    kind = _Task(robot, limits, task)
    return [kind.reach(np.random.default_rng([seed, task, i]), i) for i in range(n_motions)]


def random_ends(
    robot: Robot, limits: JointLimits, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, float]:
    """Draw a start and a goal anywhere within the limits, and a duration.

    Returns
    -------
    start, goal : array, shape (n_joints,)
        Configurations [rad or m] that the joints can hold.
    duration : float
        Duration in which the minimum-jerk motion between them keeps the limits [s].

    Raises
    ------
    RecordingError
        If none are found.
    """
    phases = np.linspace(0.0, 1.0, _N_PHASES)[:, None]
    share = progress(phases, np.array([0.5]))
    for _ in range(_MOST_DRAWS):
        start, goal = (_draw(robot, limits, rng) for _ in range(2))
        haste = rng.uniform(*_HASTE)
        if np.abs(goal - start).max() < 0.1 * np.max(_half_range(limits)):
            continue
        duration = _duration(start + (goal - start) * share, robot, limits, haste)
        if duration is not None:
            return start, goal, duration
    raise RecordingError("no two postures were found that a motion within the limits joins")


class _Task:
    """Two postures and what all ways between them have in common."""

    def __init__(self, robot: Robot, limits: JointLimits, seed: int) -> None:
        rng = np.random.default_rng([seed, robot.n_joints])
        self._robot, self._limits = robot, limits
        self._spread = _SPREAD * _half_range(limits)
        for _ in range(_MOST_DRAWS):
            ends = [_draw(robot, limits, rng, _POSTURES) for _ in range(2)]
            longest = 2.0 * _POSTURES * np.linalg.norm(_half_range(limits))
            if np.linalg.norm(ends[1] - ends[0]) > _LEAST_WAY * longest:
                break
        self._ends = ends
        n = robot.n_joints
        self._detour = rng.normal(0.0, _DETOUR, (n, n)) * (1.0 - np.eye(n))
        self._peak_shift = rng.normal(0.0, _JOINT_PEAK_SHIFT, n)

    def reach(self, rng: np.random.Generator, number: int) -> Demonstration:
        phases = np.linspace(0.0, 1.0, _N_PHASES)
        for _ in range(_MOST_DRAWS):
            start, goal = (
                end + rng.uniform(-1.0, 1.0, end.size) * self._spread for end in self._ends
            )
            way = goal - start
            peaks = rng.uniform(*_PEAK) + self._peak_shift
            factors = rng.uniform(1.0 - _DETOUR_SPREAD, 1.0 + _DETOUR_SPREAD, way.size)
            detour = (self._detour @ way) * factors
            column = phases[:, None]
            path = start + way * progress(column, peaks)
            path = path + detour * bell(column, rng.uniform(*_DETOUR_PEAK))
            haste = rng.uniform(*_HASTE)
            duration = _duration(path, self._robot, self._limits, haste)
            if duration is not None:
                return self._demonstration(phases * duration, path, number)
        raise RecordingError(
            f"no reach of {path.shape[1]} joints was found that keeps the limits of the robot: "
            "there may be some of fewer joints, such as those of one arm"
        )

    def _demonstration(self, knots: FloatArray, path: FloatArray, number: int) -> Demonstration:
        curve = CubicSpline(knots, path, bc_type="clamped")
        times = np.linspace(0.0, knots[-1], round(knots[-1] * _RATE) + 1)
        return Demonstration(
            self._robot.joint_names,
            times,
            *(curve(times, order) for order in range(3)),
            recording=f"made-up reach {number}",
            start_time=0.0,
            end_time=float(times[-1]),
        )


def _half_range(limits: JointLimits) -> FloatArray:
    half = np.minimum((limits.upper - limits.lower) / 2.0, _MOST_REACH)
    return np.where(np.isfinite(limits.upper - limits.lower), half, _REACH_OF_CONTINUOUS)


def _draw(
    robot: Robot, limits: JointLimits, rng: np.random.Generator, part: float = 0.9
) -> FloatArray:
    """A configuration in a part of the range that the joints can hold."""
    robot.require_inertias("postures that the joints can hold")
    bounded = np.isfinite(limits.upper) & np.isfinite(limits.lower)
    middle = np.zeros(robot.n_joints)
    middle[bounded] = (limits.lower[bounded] + limits.upper[bounded]) / 2.0
    zero = np.zeros((1, robot.n_joints))
    for _ in range(_MOST_DRAWS):
        q = middle + part * rng.uniform(-1.0, 1.0, middle.size) * _half_range(limits)
        tau = robot.inverse_dynamics(q[None], zero, zero)[0]
        if np.all(np.abs(tau) <= _HASTE[1] * limits.effort):
            return q
    raise RecordingError(
        f"no posture was found that the {robot.n_joints} joints of the robot can hold: "
        "there may be some of fewer joints, such as those of one arm"
    )


def _duration(path: FloatArray, robot: Robot, limits: JointLimits, haste: float) -> float | None:
    """The time for a path over phase that keeps the limits, None if there is none.

    The speed peaks at that share of a velocity limit, unless accelerations and efforts ask for
    more time.
    """
    curve = CubicSpline(np.linspace(0.0, 1.0, len(path)), path, bc_type="clamped")
    phases = np.linspace(0.0, 1.0, 2 * len(path) - 1)
    q, slope, bend = (curve(phases, order) for order in range(3))
    if np.any(q < limits.lower) or np.any(q > limits.upper):
        return None
    duration = max(_SHORTEST, float((np.abs(slope).max(axis=0) / (haste * limits.velocity)).max()))
    for _ in range(_MOST_STRETCHES):
        a = bend / duration**2
        tau = robot.inverse_dynamics(q, slope / duration, a)
        if np.all(np.abs(a) <= limits.acceleration) and np.all(
            np.abs(tau) <= _HASTE[1] * limits.effort
        ):
            return duration
        duration *= 1.1
    return None
