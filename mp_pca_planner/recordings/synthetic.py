# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Synthetic arm-raising motions of a person, for the demo, tests and users without recordings.

The motions are those of the arm in ``config/human_arm.urdf`` and stay within its limits. They
are no model of the nervous system, but have the variation of recorded motions: starts, goals and
durations that differ, joints that don't move in step, curved paths, tremor and noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, check_number
from ..exceptions import RecordingError
from ..lazy import LazyModule
from .bags import write_joint_states
from .demonstration import Demonstration

interpolate, special = LazyModule("scipy.interpolate"), LazyModule("scipy.special")

JOINT_NAMES = ("shoulder1", "shoulder2", "shoulder3", "elbow")

Range = tuple[float, float]


# Postures: azimuth (0: forward, positive: to the left) and elevation (0: horizontal) of the upper
# arm, shoulder3, elbow [deg].
_HANGING = ((-70.0, -10.0), (-88.0, -75.0), (35.0, 65.0), (-35.0, -12.0))
_RESTING = ((-45.0, 0.0), (-80.0, -65.0), (40.0, 70.0), (-100.0, -70.0))
_RAISED = ((-85.0, 10.0), (-25.0, 50.0), (38.0, 62.0), (-60.0, -15.0))
# Outward turn of shoulder3 for a given azimuth; without it the hand of an arm raised to the side
# would be behind the head.
_TURN_WITH_AZIMUTH = 0.45
# Duration of a motion [s, s/rad] for the distance in joint space.
_BASE_DURATION = 0.35
_DURATION_PER_RADIAN = 0.3
# Factor of the duration, and its bounds [s].
_HASTE = (0.8, 1.25)
_DURATION_RANGE = (0.5, 1.5)
# Phase of the peak speed. Acceleration takes a smaller part of an upward motion than of a
# downward one: Papaxanthis, Pozzo and Stapley, Neurosci. Lett. 253, 1998. It differs from one
# half by about this much: Nagasaki, Exp. Brain Res. 74, 1989.
_PEAK_UPWARD = (0.40, 0.52)
_PEAK_DOWNWARD = (0.46, 0.54)
# Phases of the joints' own peaks relative to it, and their deviation.
_PEAK_SHIFT = (-0.01, 0.0, 0.01, 0.03)
_PEAK_SHIFT_SPREAD = 0.015
# Detour of each joint (rows) halfway, as a share of the distance of each joint (columns). Paths
# of unrestrained vertical motions are curved (Atkeson and Hollerbach, J. Neurosci. 5(9), 1985):
# here the elbow flexes and the arm leaves the body a little.
_DETOUR = (
    (0.00, 0.05, 0.00, 0.04),
    (0.05, 0.00, 0.00, 0.00),
    (0.05, 0.04, 0.00, 0.00),
    (0.13, 0.00, 0.05, 0.00),
)
# Relative deviation of the detours.
_DETOUR_SPREAD = 0.4
# Phase of the largest detour.
_DETOUR_PEAK = (0.38, 0.62)
# Frequencies of physiological tremor [Hz]: Lakie et al., J. Physiol. 593, 2015.
_TREMOR_BAND = (6.0, 12.0)
# Its amplitudes [rad]; in motion it is a few times larger (measured at the ankle: J. Appl.
# Physiol. 52, 1982).
_TREMOR_IN_MOTION = 6e-4
_TREMOR_AT_REST = 2e-4
# Standard deviation of the measured positions [rad].
_SENSOR_NOISE = 1e-3


@dataclass(frozen=True, eq=False)
class SyntheticRecording:
    """Measurements of motions one after the other, and their true times.

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
        Start and end of each motion back to the start of the next one [s], in order.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    motion_spans: FloatArray
    return_spans: FloatArray

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps [ns], shape (n_steps,), of a time of day and not of a simulation."""
        return 1_700_000_000_000_000_000 + np.round(1e9 * self.times).astype(np.int64)


def generate_motions(n_motions: int, seed: int, *, rate: float = 200.0) -> list[Demonstration]:
    """Generate arm-raising motions: from hanging or resting to raised, in front or to the side.

    Parameters
    ----------
    n_motions : int
        Number of motions, at least 1.
    seed : int
        Chooses the motions. The first ones don't depend on their number.
    rate : float
        Samples per second [Hz], at least 20 to show the tremor. The samples divide a motion
        evenly, which makes its own rate a little different.

    Returns
    -------
    motions : list of Demonstration
        The motions, with tremor but without the noise of a sensor.

    Raises
    ------
    RecordingError
        If the number or the seed is out of its range.
    """
    check_number(n_motions, "the number of motions", RecordingError, 1, is_whole=True)
    check_number(seed, "the seed", RecordingError, 0, is_whole=True)
    generators = (np.random.default_rng([seed, i]) for i in range(n_motions))
    return [_raise_arm(generator, rate) for generator in generators]


def continuous_recording(
    motions: Sequence[Demonstration], rate: float = 100.0, rest: Range = (0.3, 0.8), *, seed: int
) -> SyntheticRecording:
    """Measure a person who does motions one after the other.

    Parameters
    ----------
    motions : sequence of Demonstration
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
    """
    rng = np.random.default_rng(seed)
    backs = (
        _move(before.positions[-1], after.positions[0], _PEAK_DOWNWARD, rng, rate)
        for before, after in pairwise(motions)
    )
    noise = _TREMOR_AT_REST, _SENSOR_NOISE
    return measured_in_turn(motions, backs, rng, rate, rest, noise)


def measured_in_turn(
    motions: Sequence[Demonstration],
    backs: Iterator[Demonstration],
    rng: np.random.Generator,
    rate: float,
    rest: Range,
    noise: tuple[float, float],
) -> SyntheticRecording:
    """Measure motions and motions back in turn, see :func:`continuous_recording`.

    Parameters
    ----------
    motions, backs :
        The motions, and those from the end of each to the start of the next one.
    rng :
        Draws the rests and the noise.
    rate, rest :
        Samples per second [Hz]; shortest and longest rest [s].
    noise :
        Amplitude of tremor, and standard deviation of the measured positions [rad or m].
    """
    knots, path = [np.zeros(1)], [motions[0].positions[:1]]
    now, spans = rng.uniform(*rest), []
    for index in range(2 * len(motions) - 1):
        motion = next(backs) if index % 2 else motions[index // 2]
        knots.append(now + motion.times)
        path.append(motion.positions)
        spans.append((now, now + motion.duration))
        now = spans[-1][1] + rng.uniform(*rest)
    # Where there is no rest, the end of a motion is the start of the next one.
    at, first = np.unique(np.concatenate([*knots, [now]]), return_index=True)
    # Monotone interpolation: a spline would ring in the rests.
    curve = interpolate.PchipInterpolator(
        at, np.concatenate([*path, motions[-1].positions[-1:]])[first]
    )
    times = np.arange(int(now * rate) + 1) / rate
    positions = curve(times) + _tremor(times, motions[0].n_joints, noise[0], rng)
    positions += rng.normal(0.0, noise[1], positions.shape)
    of_all = np.array(spans)
    return SyntheticRecording(motions[0].joint_names, times, positions, of_all[::2], of_all[1::2])


def write_example_recording(path: str | Path, n_motions: int = 40, *, seed: int = 1) -> Path:
    """Write a bag of arm-raising motions of the arm in ``config/human_arm.urdf``.

    Parameters
    ----------
    path : str or Path
        A file name ending in .mcap, or a rosbag2 folder; an existing one is replaced.
    n_motions : int
        Number of motions, at least 1.
    seed : int
        Selects the motions.

    Raises
    ------
    RecordingError
        If the number of motions is too small, or the file can't be written.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.write_example_recording("motions.mcap", 6).name
    'motions.mcap'
    """
    file = Path(path)
    check_number(n_motions, "the number of motions", RecordingError, 1, 10_000, is_whole=True)
    check_number(seed, "the seed", RecordingError, 0, is_whole=True)
    recording = continuous_recording(generate_motions(n_motions, seed), seed=seed)
    names, stamps = recording.joint_names, recording.stamps
    write_joint_states(file, "mcap", names, stamps, recording.positions, overwrite=True)
    return file


def _raise_arm(rng: np.random.Generator, rate: float) -> Demonstration:
    start = _posture(_HANGING if rng.random() < 0.6 else _RESTING, rng)
    return _move(start, _posture(_RAISED, rng), _PEAK_UPWARD, rng, rate)


def _posture(ranges: tuple[Range, ...], rng: np.random.Generator) -> FloatArray:
    azimuth, elevation, turn, elbow = np.deg2rad([rng.uniform(*bounds) for bounds in ranges])
    turn += _TURN_WITH_AZIMUTH * min(azimuth, 0.0) * np.cos(elevation)
    # Direction of the upper arm, Ry(q1) Rx(q2) (0, 0, -1) in the frame of the shoulder, solved
    # for q1 and q2. The azimuths of all postures are on the side where q1 is negative. In the
    # URDF the axis of shoulder1 is turned by -50 degrees about the vertical.
    from_axis = azimuth + np.deg2rad(50.0)
    x, y = np.cos(elevation) * np.array([np.cos(from_axis), np.sin(from_axis)])
    return np.array([np.arctan2(-x, -np.sin(elevation)), np.arcsin(y), turn, elbow])


def _move(
    start: FloatArray, goal: FloatArray, peak_range: Range, rng: np.random.Generator, rate: float
) -> Demonstration:
    distance = goal - start
    usual = _BASE_DURATION + _DURATION_PER_RADIAN * np.linalg.norm(distance)
    duration = np.clip(usual * rng.uniform(*_HASTE), *_DURATION_RANGE)
    phases = np.linspace(0.0, 1.0, round(duration * rate) + 1)[:, None]
    peaks = rng.uniform(*peak_range) + np.array(_PEAK_SHIFT)
    peaks += rng.uniform(-_PEAK_SHIFT_SPREAD, _PEAK_SHIFT_SPREAD, peaks.shape)
    spread = rng.uniform(1.0 - _DETOUR_SPREAD, 1.0 + _DETOUR_SPREAD, distance.shape)
    detour = (np.array(_DETOUR) @ distance) * spread
    times = phases[:, 0] * duration
    positions = (
        start
        + distance * progress(phases, peaks)
        + detour * bell(phases, rng.uniform(*_DETOUR_PEAK))
        + _tremor(times, start.size, _TREMOR_IN_MOTION, rng) * bell(phases, 0.5)
    )
    curve = interpolate.CubicSpline(times, positions)
    return Demonstration.of_curve(JOINT_NAMES, curve, times, "made up")


def progress(phases: FloatArray, peaks: FloatArray) -> FloatArray:
    """Share of the distance travelled, with the speed s^a (1 - s)^b.

    The speed peaks at the phase a / (a + b). For a = b = 2 this is the minimum-jerk motion: Flash
    and Hogan, J. Neurosci. 5(7), 1985.
    """
    return np.asarray(special.betainc(4.0 * peaks + 1.0, 4.0 * (1.0 - peaks) + 1.0, phases))


def bell(phases: FloatArray, peak: float) -> FloatArray:
    """Smooth rise from 0 to 1 at the phase `peak`, and fall back to 0."""
    rise = (phases / peak) ** (6.0 * peak)
    return np.asarray(rise * ((1.0 - phases) / (1.0 - peak)) ** (6.0 * (1.0 - peak)))


def _tremor(
    times: FloatArray, n_joints: int, amplitude: float, rng: np.random.Generator
) -> FloatArray:
    """Three sinusoids a joint with a common amplitude [rad], shape (n_steps, n_joints)."""
    shape = (3, n_joints)
    frequencies = rng.uniform(*_TREMOR_BAND, shape)
    offsets = rng.uniform(0.0, 2.0 * np.pi, shape)
    waves = np.sin(2.0 * np.pi * frequencies * times[:, None, None] + offsets)
    return np.asarray(amplitude * waves.mean(axis=1))
