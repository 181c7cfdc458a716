# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Made-up arm-raising motions of a person, for the demo, tests and users without recordings.

The motions are those of the arm in ``config/human_arm.urdf`` and stay within its limits. They
are no model of the nervous system, but have what recordings of people have: other starts, goals
and durations each time, joints that do not move in step, curved paths, tremor and noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.special import betainc

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import RecordingError
from .demonstration import Demonstration

JOINT_NAMES = ("shoulder1", "shoulder2", "shoulder3", "elbow")

# The axis of shoulder1 is turned about the vertical by this much (see the URDF).
_SHOULDER_YAW = np.deg2rad(-50.0)

# Ranges of postures: azimuth (0: forward, positive: to the left) and elevation (0: horizontal)
# of the upper arm, shoulder3, elbow [deg].
_HANGING = ((-70.0, -10.0), (-88.0, -75.0), (35.0, 65.0), (-35.0, -12.0))
_RESTING = ((-45.0, 0.0), (-80.0, -65.0), (40.0, 70.0), (-100.0, -70.0))
_RAISED = ((-85.0, 10.0), (-25.0, 50.0), (38.0, 62.0), (-60.0, -15.0))
# An arm raised to the side is turned outwards, or the hand would end up behind the head.
_TURN_WITH_AZIMUTH = 0.45

# Duration of a motion [s]: it grows with the distance in joint space, less than in proportion.
_BASE_DURATION, _DURATION_PER_RADIAN = 0.35, 0.3
_HASTE = (0.8, 1.25)
_DURATION_RANGE = (0.5, 1.5)

# Phase of the peak speed. Acceleration takes a smaller part of an upward motion than of a
# downward one: Papaxanthis, Pozzo and Stapley, Neurosci. Lett. 253, 1998. That it moves away
# from one half at all, and by about as much: Nagasaki, Exp. Brain Res. 74, 1989.
_PEAK_UPWARD = (0.40, 0.52)
_PEAK_DOWNWARD = (0.46, 0.54)
# The joints' own peaks come a little before or after it.
_PEAK_SHIFT = np.array([-0.01, 0.0, 0.01, 0.03])
_PEAK_SHIFT_SPREAD = 0.015

# Detour of each joint (rows) halfway, as a share of what each joint (columns) has to go. Paths
# of unrestrained vertical motions are curved (Atkeson and Hollerbach, J. Neurosci. 5(9), 1985):
# here the arm goes up with a more flexed elbow and a little away from the body.
_DETOUR = np.array(
    [
        [0.00, 0.05, 0.00, 0.04],
        [0.05, 0.00, 0.00, 0.00],
        [0.05, 0.04, 0.00, 0.00],
        [0.13, 0.00, 0.05, 0.00],
    ]
)
_DETOUR_SPREAD = 0.4
_DETOUR_PEAK = (0.38, 0.62)

# Physiological tremor has its peak between 6 and 12 Hz (Lakie et al., J. Physiol. 593, 2015), and
# is a few times larger in motion than in rest (measured at the ankle: J. Appl. Physiol. 52, 1982).
_TREMOR_BAND = (6.0, 12.0)
_TREMOR_IN_MOTION = 6e-4
_TREMOR_AT_REST = 2e-4
_SENSOR_NOISE = 1e-3


@dataclass(frozen=True, eq=False)
class SyntheticMotion:
    """One made-up motion from rest to rest.

    Attributes
    ----------
    times : array, shape (n_steps,)
        Times since the start [s], evenly spaced, first 0.
    positions : array, shape (n_steps, 4)
        Positions [rad] of the joints in `JOINT_NAMES`.

    Raises
    ------
    RecordingError
        If shapes disagree, a number is not finite, or the times don't increase from 0.
    """

    times: FloatArray
    positions: FloatArray

    def __init__(self, times: ArrayLike, positions: ArrayLike) -> None:
        stamps = frozen_array(times, (None,), "times of a motion", RecordingError)
        if stamps.size < 2 or stamps[0] != 0.0 or np.diff(stamps).min() <= 0.0:
            raise RecordingError("times of a motion must start at 0 and strictly increase")
        shape = (stamps.size, len(JOINT_NAMES))
        object.__setattr__(self, "times", stamps)
        object.__setattr__(
            self, "positions", frozen_array(positions, shape, "positions", RecordingError)
        )

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def as_demonstration(self, recording: str = "made up") -> Demonstration:
        """The motion as if it had been recorded without noise, cut out and differentiated."""
        curve = CubicSpline(self.times, self.positions)
        return Demonstration(
            JOINT_NAMES,
            self.times,
            *(curve(self.times, order) for order in range(3)),
            recording=recording,
            start_time=0.0,
            end_time=self.duration,
        )


@dataclass(frozen=True, eq=False)
class SyntheticRecording:
    """Motions one after the other as a sensor would report them, and where they really are.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    times : array, shape (n_steps,)
        Times since the start [s], evenly spaced, first 0.
    positions : array, shape (n_steps, n_joints)
        Measured positions [rad], noise included.
    motion_spans : array, shape (n_motions, 2)
        Start and end of each motion [s], in order.
    return_spans : array, shape (n_motions - 1, 2)
        Start and end of each motion back to where the next one starts [s], in order.

    Raises
    ------
    RecordingError
        If shapes disagree or a number is not finite.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    motion_spans: FloatArray
    return_spans: FloatArray

    def __post_init__(self) -> None:
        names = unique_names(self.joint_names, "joints of a recording", RecordingError)
        shapes: dict[str, tuple[int | None, ...]] = {
            "times": (None,),
            "positions": (len(self.times), len(names)),
            "motion_spans": (None, 2),
            "return_spans": (len(self.motion_spans) - 1, 2),
        }
        for field, shape in shapes.items():
            array = frozen_array(getattr(self, field), shape, field, RecordingError)
            object.__setattr__(self, field, array)


def generate_motions(n_motions: int, seed: int, *, rate: float = 200.0) -> list[SyntheticMotion]:
    """Make up arm-raising motions: from hanging or resting to raised, in front or to the side.

    Parameters
    ----------
    n_motions : int
        How many, at least 1.
    seed : int
        Chooses the motions. The first ones don't depend on how many there are.
    rate : float
        Samples per second [Hz], at least 20. The samples divide a motion evenly, which makes
        its own rate a little different.

    Returns
    -------
    motions : list of SyntheticMotion
        The motions, with tremor but without the noise of a sensor.

    Raises
    ------
    RecordingError
        If the number or the rate is too small.
    """
    if n_motions < 1:
        raise RecordingError(f"the number of motions must be at least 1, got {n_motions}")
    _check_rate(rate)
    return [_raise_arm(np.random.default_rng([seed, i]), rate) for i in range(n_motions)]


def continuous_recording(
    motions: Sequence[SyntheticMotion],
    rate: float = 100.0,
    rest: tuple[float, float] = (0.3, 0.8),
    *,
    seed: int,
) -> SyntheticRecording:
    """Let a person do motions one after the other, and record it in one go.

    Parameters
    ----------
    motions : sequence of SyntheticMotion
        The motions, at least one.
    rate : float
        Samples per second [Hz], at least 20.
    rest : tuple of float
        Shortest and longest rest [s] before, between and after the motions; not negative.
    seed : int
        Chooses the rests, the motions back and the noise.

    Returns
    -------
    recording : SyntheticRecording
        The measured positions and the true spans of the motions.

    Raises
    ------
    RecordingError
        If there is no motion, the rate is too small or the rests are no range.
    """
    if not motions:
        raise RecordingError("a recording needs at least one motion, got none")
    _check_rate(rate)
    if not 0.0 <= rest[0] <= rest[1] < np.inf:
        raise RecordingError(
            f"rests must be a range of seconds, shortest first and not negative, got {rest}"
        )
    rng = np.random.default_rng(seed)
    timeline = _Timeline(motions[0].positions[0])
    motion_spans = []
    return_spans = []
    timeline.rest(rng.uniform(*rest))
    for i, motion in enumerate(motions):
        if i > 0:
            back = _move(
                motions[i - 1].positions[-1], motion.positions[0], _PEAK_DOWNWARD, rng, rate
            )
            return_spans.append(timeline.append(back))
            timeline.rest(rng.uniform(*rest))
        motion_spans.append(timeline.append(motion))
        timeline.rest(rng.uniform(*rest))
    times, positions = timeline.sampled(rate)
    positions += _tremor(times, _TREMOR_AT_REST, rng)
    positions += rng.normal(0.0, _SENSOR_NOISE, positions.shape)
    return SyntheticRecording(
        JOINT_NAMES,
        times,
        positions,
        np.array(motion_spans),
        np.reshape(return_spans, (-1, 2)),
    )


class _Timeline:
    """Knots of a long motion, built up piece by piece."""

    def __init__(self, start: FloatArray) -> None:
        self._times = [np.zeros(1)]
        self._positions = [start[None]]

    def rest(self, duration: float) -> None:
        if duration > 0.0:
            self._times.append(self._times[-1][-1:] + duration)
            self._positions.append(self._positions[-1][-1:])

    def append(self, motion: SyntheticMotion) -> tuple[float, float]:
        start = float(self._times[-1][-1])
        self._times.append(start + motion.times[1:])
        self._positions.append(motion.positions[1:])
        return start, start + motion.duration

    def sampled(self, rate: float) -> tuple[FloatArray, FloatArray]:
        # Monotone interpolation: a spline would ring in the rests.
        curve = PchipInterpolator(np.concatenate(self._times), np.concatenate(self._positions))
        times = np.arange(int(self._times[-1][-1] * rate) + 1) / rate
        return times, np.asarray(curve(times), dtype=np.float64)


def _check_rate(rate: float) -> None:
    # Below this the samples don't show the tremor or the shape of a motion of half a second.
    if not 20.0 <= rate < np.inf:
        raise RecordingError(f"the rate must be at least 20 Hz, got {rate}")


def _raise_arm(rng: np.random.Generator, rate: float) -> SyntheticMotion:
    start = _posture(_HANGING if rng.random() < 0.6 else _RESTING, rng)
    goal = _posture(_RAISED, rng)
    return _move(start, goal, _PEAK_UPWARD, rng, rate)


def _posture(ranges: tuple[tuple[float, float], ...], rng: np.random.Generator) -> FloatArray:
    azimuth, elevation, turn, elbow = np.deg2rad([rng.uniform(*bounds) for bounds in ranges])
    turn += _TURN_WITH_AZIMUTH * min(azimuth, 0.0) * np.cos(elevation)
    # Direction of the upper arm, Ry(q1) Rx(q2) (0, 0, -1) in the frame of the shoulder, solved
    # for q1 and q2. The azimuths of all postures are on the side where q1 is negative.
    x, y = np.cos(elevation) * np.array(
        [np.cos(azimuth - _SHOULDER_YAW), np.sin(azimuth - _SHOULDER_YAW)]
    )
    return np.array([np.arctan2(-x, -np.sin(elevation)), np.arcsin(y), turn, elbow])


def _move(
    start: FloatArray,
    goal: FloatArray,
    peak_range: tuple[float, float],
    rng: np.random.Generator,
    rate: float,
) -> SyntheticMotion:
    way = goal - start
    duration = np.clip(
        (_BASE_DURATION + _DURATION_PER_RADIAN * np.linalg.norm(way)) * rng.uniform(*_HASTE),
        *_DURATION_RANGE,
    )
    phases = np.linspace(0.0, 1.0, round(duration * rate) + 1)[:, None]
    peaks = rng.uniform(*peak_range) + _PEAK_SHIFT
    peaks += rng.uniform(-_PEAK_SHIFT_SPREAD, _PEAK_SHIFT_SPREAD, peaks.shape)
    detour = (_DETOUR @ way) * rng.uniform(1.0 - _DETOUR_SPREAD, 1.0 + _DETOUR_SPREAD, way.shape)
    times = phases[:, 0] * duration
    positions = (
        start
        + way * progress(phases, peaks)
        + detour * bell(phases, rng.uniform(*_DETOUR_PEAK))
        + _tremor(times, _TREMOR_IN_MOTION, rng) * bell(phases, 0.5)
    )
    return SyntheticMotion(times, positions)


def progress(phases: FloatArray, peaks: FloatArray) -> FloatArray:
    """Share of the way done, with the speed s^a (1 - s)^b that peaks at the phase a / (a + b).

    For a = b = 2 this is the minimum-jerk motion: Flash and Hogan, J. Neurosci. 5(7), 1985.
    """
    return np.asarray(betainc(4.0 * peaks + 1.0, 4.0 * (1.0 - peaks) + 1.0, phases))


def bell(phases: FloatArray, peak: float) -> FloatArray:
    """Rise smoothly from 0 to 1 at a phase, and fall back to 0."""
    rise = (phases / peak) ** (6.0 * peak)
    return np.asarray(rise * ((1.0 - phases) / (1.0 - peak)) ** (6.0 * (1.0 - peak)))


def _tremor(times: FloatArray, amplitude: float, rng: np.random.Generator) -> FloatArray:
    """Three sinusoids a joint with a common amplitude [rad], shape (n_steps, n_joints)."""
    shape = (3, len(JOINT_NAMES))
    frequencies = rng.uniform(*_TREMOR_BAND, shape)
    offsets = rng.uniform(0.0, 2.0 * np.pi, shape)
    waves = np.sin(2.0 * np.pi * frequencies * times[:, None, None] + offsets)
    return np.asarray(amplitude * waves.mean(axis=1))
