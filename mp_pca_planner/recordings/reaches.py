# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Random reaches of any arm within its limits, for robots without recordings.

All motions of one task connect about the same two postures with the same kind of detour, as the
demonstrations of one task do; their ends, timing and speed differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..lazy import LazyModule
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .demonstration import Demonstration
from .synthetic import SyntheticRecording, bell, measured_in_turn, progress

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

interpolate = LazyModule("scipy.interpolate")

# Largest distance from the middle of a joint's range that is used [rad or m].
_MAX_REACH = 2.0
# The same for joints without limits, which never turn by half a turn [rad].
_CONTINUOUS_REACH = 1.5
# Shares of the used range that contain the postures of a task, and their deviation in it.
_POSTURES = 0.6
_SPREAD = 0.12
# Shortest distance between them, as a share of the longest possible.
_MIN_DISTANCE = 0.25
# Standard deviation of the detours of a task as shares of the distances, and their relative
# deviation.
_DETOUR = 0.12
_DETOUR_SPREAD = 0.4
# Phases of the peak speed and of the largest detour.
_PEAK = (0.44, 0.52)
_DETOUR_PEAK = (0.4, 0.6)
# Standard deviation of the joints' own peaks.
_JOINT_PEAK_SHIFT = 0.02
# Peak speeds as shares of the limits. Efforts stay below the second share of theirs.
_HASTE = (0.6, 0.95)
# Shortest duration [s].
_MIN_DURATION = 0.4
# Samples per second [Hz].
_RATE = 100.0
# Phases of a path at which it is computed.
_N_PHASES = 101
# Random draws after which the limits leave no reach.
_MAX_DRAWS = 1000
# Shortest and longest rest between the motions of a recording [s].
_REST = (0.8, 1.2)
# Standard deviation of recorded positions [rad].
_SENSOR_NOISE = 1e-4


def random_reaches(
    robot: Robot, limits: JointLimits, n_motions: int, seed: int
) -> list[Demonstration]:
    """Generate reaches that keep the limits of a robot.

    Parameters
    ----------
    robot : Robot
        The arm.
    limits : JointLimits
        Limits of its joints; limits of jerks are ignored.
    n_motions : int
        Number of reaches, at least 1.
    seed : int
        Chooses the motions. The first ones don't depend on their number.

    Raises
    ------
    RecordingError
        If the number is too small, or no reach keeps the limits.
    """
    if n_motions < 1:
        raise RecordingError(f"the number of motions must be at least 1, got {n_motions}")
    arm, n = ReachingArm(robot, limits), robot.n_joints
    rng = np.random.default_rng([0, n])
    longest = 2.0 * _POSTURES * np.linalg.norm(arm.half_range)
    for _ in range(_MAX_DRAWS):
        ends = [arm.posture(rng, _POSTURES) for _ in range(2)]
        if np.linalg.norm(ends[1] - ends[0]) > _MIN_DISTANCE * longest:
            break
    detours = rng.normal(0.0, _DETOUR, (n, n)) * (1.0 - np.eye(n))
    peak_shifts = rng.normal(0.0, _JOINT_PEAK_SHIFT, n)
    found = []
    for i in range(n_motions):
        own = np.random.default_rng([seed, 0, i])
        curve, duration = _reach(arm, ends, detours, peak_shifts, own)
        times = np.linspace(0.0, duration, round(duration * _RATE) + 1)
        name = f"made-up reach {i}"
        found.append(Demonstration.of_curve(robot.joint_names, curve, times, name))
    return found


def _reach(
    arm: ReachingArm,
    ends: Sequence[FloatArray],
    detours: FloatArray,
    peak_shifts: FloatArray,
    rng: np.random.Generator,
) -> tuple[CubicSpline, float]:
    """Draw a reach between about two postures: positions by time [s], and its duration [s]."""
    phases = np.linspace(0.0, 1.0, _N_PHASES)[:, None]
    for _ in range(_MAX_DRAWS):
        spread = _SPREAD * arm.half_range
        start, goal = (end + rng.uniform(-1.0, 1.0, end.size) * spread for end in ends)
        distance = goal - start
        peaks = rng.uniform(*_PEAK) + peak_shifts
        low, high = 1.0 - _DETOUR_SPREAD, 1.0 + _DETOUR_SPREAD
        detour = (detours @ distance) * rng.uniform(low, high, distance.size)
        path = start + distance * progress(phases, peaks)
        path = path + detour * bell(phases, rng.uniform(*_DETOUR_PEAK))
        duration = arm.duration(path, rng.uniform(*_HASTE))
        if duration is not None:
            knots = phases[:, 0] * duration
            return interpolate.CubicSpline(knots, path, bc_type="clamped"), float(knots[-1])
    raise RecordingError(
        f"no reach of {len(peak_shifts)} joints was found that keeps the limits of the robot: "
        "there may be some of fewer joints, such as those of one arm"
    )


def reach_recording(
    motions: Sequence[Demonstration], still: Mapping[str, float], *, seed: int
) -> SyntheticRecording:
    """Measure a robot that is led through motions one after the other, and back in between.

    Parameters
    ----------
    motions : sequence of Demonstration
        The motions, at least one.
    still : mapping of str to float
        Positions [rad or m] of further joints that rest, such as a gripper's.
    seed : int
        Chooses the rests and the noise.

    Returns
    -------
    recording : SyntheticRecording
        The measured positions and the true spans of the motions.
    """
    rng = np.random.default_rng(seed)
    backs = (_way_back(before, after.positions[0]) for before, after in pairwise(motions))
    made = measured_in_turn(motions, backs, rng, _RATE, _REST, (0.0, _SENSOR_NOISE))
    resting = np.tile(list(still.values()), (len(made.times), 1))
    return replace(
        made,
        joint_names=(*made.joint_names, *still),
        positions=np.column_stack([made.positions, resting]),
    )


def _way_back(motion: Demonstration, goal: FloatArray) -> Demonstration:
    """The motion backwards, to about its start."""
    shares = progress(motion.times / motion.duration, np.array(0.5))[:, None]
    positions = motion.positions[::-1] + (goal - motion.positions[0]) * shares
    curve = interpolate.CubicSpline(motion.times, positions)
    return Demonstration.of_curve(motion.joint_names, curve, motion.times, "made up")


class ReachingArm:
    """A robot within limits: postures that it can hold, and durations of paths.

    Attributes
    ----------
    half_range : array, shape (n_joints,)
        Half of the range of each joint that is used [rad or m].
    """

    def __init__(self, robot: Robot, limits: JointLimits) -> None:
        robot.require_inertias("postures that the joints can hold")
        self.robot, self._limits = robot, limits
        bounded = np.isfinite(limits.upper) & np.isfinite(limits.lower)
        self._middle = np.zeros(robot.n_joints)
        self._middle[bounded] = (limits.lower[bounded] + limits.upper[bounded]) / 2.0
        width = limits.upper - limits.lower
        half = np.minimum(width / 2.0, _MAX_REACH)
        self.half_range = np.where(np.isfinite(width), half, _CONTINUOUS_REACH)

    def posture(self, rng: np.random.Generator, part: float) -> FloatArray:
        """A configuration in a part of the range that the joints can hold."""
        zero = np.zeros((1, self.robot.n_joints))
        for _ in range(_MAX_DRAWS):
            q = self._middle + part * rng.uniform(-1.0, 1.0, zero.size) * self.half_range
            if self._has_strength(self.robot.inverse_dynamics(q[None], zero, zero)):
                return q
        raise RecordingError(
            f"no posture was found that the {self.robot.n_joints} joints of the robot can hold: "
            "there may be some of fewer joints, such as those of one arm"
        )

    def duration(self, path: FloatArray, haste: float) -> float | None:
        """Duration for a path over phase that keeps the limits, None if there is none.

        The speed peaks at the share `haste` of a velocity limit, unless accelerations and efforts
        require more time.
        """
        curve = interpolate.CubicSpline(np.linspace(0.0, 1.0, len(path)), path, bc_type="clamped")
        phases = np.linspace(0.0, 1.0, 2 * len(path) - 1)
        q, slope, bend = (curve(phases, order) for order in range(3))
        if np.any(q < self._limits.lower) or np.any(q > self._limits.upper):
            return None
        fastest = float((np.abs(slope).max(axis=0) / (haste * self._limits.velocity)).max())
        duration = max(_MIN_DURATION, fastest)
        # Thirty steps of a tenth multiply it by 17: a longer motion is no reach.
        for _ in range(30):
            a = bend / duration**2
            tau = self.robot.inverse_dynamics(q, slope / duration, a)
            if np.all(np.abs(a) <= self._limits.acceleration) and self._has_strength(tau):
                return duration
            duration *= 1.1
        return None

    def _has_strength(self, tau: FloatArray) -> bool:
        return bool(np.all(np.abs(tau) <= _HASTE[1] * self._limits.effort))
