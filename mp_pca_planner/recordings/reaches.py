# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Random reaches of any arm within its limits, for robots without recordings.

All motions of one task connect about the same two postures with the same kind of detour, as the
demonstrations of one task do; their ends, timing and speed differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .demonstration import Demonstration
from .synthetic import SyntheticRecording, bell, progress


@dataclass(frozen=True)
class ReachOptions:
    """Distributions of the reaches; ranges are of uniform distributions.

    Attributes
    ----------
    max_reach : float
        Largest distance from the middle of a joint's range that is used [rad or m].
    continuous_reach : float
        The same for joints without limits, which never turn by half a turn [rad].
    postures, spread : float
        Shares of the used range that contain the postures of a task, and their deviation in it.
    min_distance : float
        Shortest distance between them, as a share of the longest possible.
    detour, detour_spread : float
        Standard deviation of the detours of a task as shares of the distances, and their relative
        deviation.
    peak, detour_peak : tuple of float
        Phases of the peak speed and of the largest detour.
    joint_peak_shift : float
        Standard deviation of the joints' own peaks.
    haste : tuple of float
        Peak speeds as shares of the limits. Efforts stay below the second share of theirs.
    min_duration : float
        Shortest duration [s].
    rate : float
        Samples per second [Hz].
    n_phases : int
        Phases of a path at which it is computed.
    max_draws : int
        Random draws after which the limits leave no reach.
    rest : tuple of float
        Shortest and longest rest between the motions of a recording [s].
    sensor_noise : float
        Standard deviation of recorded positions [rad].
    """

    max_reach: float = 2.0
    continuous_reach: float = 1.5
    postures: float = 0.6
    spread: float = 0.12
    min_distance: float = 0.25
    detour: float = 0.12
    detour_spread: float = 0.4
    peak: tuple[float, float] = (0.44, 0.52)
    detour_peak: tuple[float, float] = (0.4, 0.6)
    joint_peak_shift: float = 0.02
    haste: tuple[float, float] = (0.6, 0.95)
    min_duration: float = 0.4
    rate: float = 100.0
    n_phases: int = 101
    max_draws: int = 1000
    rest: tuple[float, float] = (0.8, 1.2)
    sensor_noise: float = 1e-4


OPTIONS = ReachOptions()


def random_reaches(
    robot: Robot, limits: JointLimits, n_motions: int, seed: int, *, task: int = 0
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
    task : int
        Chooses the postures that they connect, and their detours.

    Raises
    ------
    RecordingError
        If the number is too small, or no reach keeps the limits.
    """
    if n_motions < 1:
        raise RecordingError(f"the number of motions must be at least 1, got {n_motions}")
    arm = _Arm(robot, limits)
    kind = _ReachTask(arm, np.random.default_rng([task, robot.n_joints]))
    return [kind.reach(np.random.default_rng([seed, task, i]), i) for i in range(n_motions)]


def reach_recording(
    motions: Sequence[Demonstration], still: Mapping[str, float], *, seed: int
) -> SyntheticRecording:
    """Measure a robot that is led through motions one after the other, and back each time.

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
    times, path, spans, now = [], [], [], 0.0
    for motion, following in zip(motions, [*motions[1:], motions[0]], strict=True):
        s = (motion.times / motion.duration)[:, None]
        shift = following.positions[0] - motion.positions[0]
        back = motion.positions[::-1] + shift * progress(s, np.array(0.5))
        for positions in (motion.positions, back):
            now += rng.uniform(*OPTIONS.rest)
            times.append(now + motion.times)
            path.append(positions)
            spans.append((now, now + motion.duration))
            now += motion.duration
    grid = np.arange(0.0, now + OPTIONS.rest[1], 1.0 / OPTIONS.rate)
    # Monotone interpolation: a spline would ring in the rests.
    curve = PchipInterpolator(np.concatenate(times), np.concatenate(path))
    positions = curve(np.clip(grid, times[0][0], times[-1][-1]))
    positions += rng.normal(0.0, OPTIONS.sensor_noise, positions.shape)
    resting = np.tile(list(still.values()), (len(grid), 1))
    of_all = np.array(spans)
    return SyntheticRecording(
        (*motions[0].joint_names, *still),
        grid,
        np.column_stack([positions, resting]),
        of_all[::2],
        of_all[1::2],
    )


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
    arm = _Arm(robot, limits)
    share = progress(_phases(), np.array([0.5]))
    for _ in range(OPTIONS.max_draws):
        start, goal = (arm.posture(rng, 0.9) for _ in range(2))
        haste = rng.uniform(*OPTIONS.haste)
        if np.abs(goal - start).max() < 0.1 * np.max(arm.half_range):
            continue
        duration = arm.duration(start + (goal - start) * share, haste)
        if duration is not None:
            return start, goal, duration
    raise RecordingError("no two postures were found that a motion within the limits joins")


class _Arm:
    """A robot within limits: postures that it can hold, and durations of paths."""

    def __init__(self, robot: Robot, limits: JointLimits) -> None:
        robot.require_inertias("postures that the joints can hold")
        self.robot, self._limits = robot, limits
        bounded = np.isfinite(limits.upper) & np.isfinite(limits.lower)
        self._middle = np.zeros(robot.n_joints)
        self._middle[bounded] = (limits.lower[bounded] + limits.upper[bounded]) / 2.0
        width = limits.upper - limits.lower
        half = np.minimum(width / 2.0, OPTIONS.max_reach)
        self.half_range = np.where(np.isfinite(width), half, OPTIONS.continuous_reach)

    def posture(self, rng: np.random.Generator, part: float) -> FloatArray:
        """A configuration in a part of the range that the joints can hold."""
        zero = np.zeros((1, self.robot.n_joints))
        for _ in range(OPTIONS.max_draws):
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
        curve = CubicSpline(np.linspace(0.0, 1.0, len(path)), path, bc_type="clamped")
        phases = np.linspace(0.0, 1.0, 2 * len(path) - 1)
        q, slope, bend = (curve(phases, order) for order in range(3))
        if np.any(q < self._limits.lower) or np.any(q > self._limits.upper):
            return None
        fastest = float((np.abs(slope).max(axis=0) / (haste * self._limits.velocity)).max())
        duration = max(OPTIONS.min_duration, fastest)
        # Thirty steps of a tenth multiply it by 17: a longer motion is no reach.
        for _ in range(30):
            a = bend / duration**2
            tau = self.robot.inverse_dynamics(q, slope / duration, a)
            if np.all(np.abs(a) <= self._limits.acceleration) and self._has_strength(tau):
                return duration
            duration *= 1.1
        return None

    def _has_strength(self, tau: FloatArray) -> bool:
        return bool(np.all(np.abs(tau) <= OPTIONS.haste[1] * self._limits.effort))


class _ReachTask:
    """Two postures, and the common detours and timing of all reaches between them."""

    def __init__(self, arm: _Arm, rng: np.random.Generator) -> None:
        options, n = OPTIONS, arm.robot.n_joints
        self._arm = arm
        longest = 2.0 * options.postures * np.linalg.norm(arm.half_range)
        for _ in range(OPTIONS.max_draws):
            self._ends = [arm.posture(rng, options.postures) for _ in range(2)]
            if np.linalg.norm(self._ends[1] - self._ends[0]) > options.min_distance * longest:
                break
        self._detour = rng.normal(0.0, options.detour, (n, n)) * (1.0 - np.eye(n))
        self._peak_shift = rng.normal(0.0, options.joint_peak_shift, n)

    def reach(self, rng: np.random.Generator, number: int) -> Demonstration:
        for _ in range(OPTIONS.max_draws):
            path = self._path(rng)
            duration = self._arm.duration(path, rng.uniform(*OPTIONS.haste))
            if duration is not None:
                return self._demonstration(_phases()[:, 0] * duration, path, number)
        raise RecordingError(
            f"no reach of {path.shape[1]} joints was found that keeps the limits of the robot: "
            "there may be some of fewer joints, such as those of one arm"
        )

    def _path(self, rng: np.random.Generator) -> FloatArray:
        options, column = OPTIONS, _phases()
        spread = options.spread * self._arm.half_range
        start, goal = (end + rng.uniform(-1.0, 1.0, end.size) * spread for end in self._ends)
        distance = goal - start
        peaks = rng.uniform(*options.peak) + self._peak_shift
        low, high = 1.0 - options.detour_spread, 1.0 + options.detour_spread
        detour = (self._detour @ distance) * rng.uniform(low, high, distance.size)
        path = start + distance * progress(column, peaks)
        return path + detour * bell(column, rng.uniform(*options.detour_peak))

    def _demonstration(self, knots: FloatArray, path: FloatArray, number: int) -> Demonstration:
        curve = CubicSpline(knots, path, bc_type="clamped")
        times = np.linspace(0.0, knots[-1], round(knots[-1] * OPTIONS.rate) + 1)
        names = self._arm.robot.joint_names
        return Demonstration.of_curve(names, curve, times, f"made-up reach {number}")


def _phases() -> FloatArray:
    """Phases at which paths are computed, shape (n_phases, 1)."""
    return np.linspace(0.0, 1.0, OPTIONS.n_phases)[:, None]
