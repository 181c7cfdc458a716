# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Segmentation of a recording into single motions, by the speed of its joints on a smooth curve.

A recording is cut at *rests*, where the joints are nearly still, and at *valleys*, where the speed
is low relative to the peaks on both sides: people often continue with the next motion without a
stop. All speeds are compared with the recording's own, so units and scale of the joints don't
matter. The extent of a motion is compared with the noise, with the other motions and with a least
extent, since a recording of an arm that stands still contains speeds but no motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from heapq import heapify, heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..lazy import LazyModule
from .continuity import noise_deviation
from .recording import Samples

interpolate, signal = LazyModule("scipy.interpolate"), LazyModule("scipy.signal")

CUTOFF = 8.0
"""Cut-off of the low-pass [Hz]; 6 to 10 Hz is usual for movements of the human arm."""

MIN_RATE, MAX_RATE = 50.0, 200.0
"""Bounds of the rate of smooth motions [Hz]; between them it is the rate of the recording."""

# Samples are filtered from this many times the cut-off on: slower ones hold little above it.
_FILTERED_RATE = 5
# Order of the low-pass. It is applied forwards and backwards: no delay, twice the order.
_ORDER = 2
# Degree of the spline. 3 is the lowest one with continuous accelerations; higher ones oscillate
# where samples are few.
_DEGREE = 3


@dataclass(frozen=True, eq=False)
class SmoothPiece:
    """A smooth motion on a uniform grid.

    Attributes
    ----------
    times : array, shape (n_steps,)
        Times since the recording's first message [s], evenly spaced.
    positions, velocities, accelerations : array, shape (n_steps, n_joints)
        Joint positions [rad or m] and the derivatives of the same curve [/s, /s²].
    recorded_rate : float
        The usual rate of the recording [Hz].
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    recorded_rate: float

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return float((self.times.size - 1) / (self.times[-1] - self.times[0]))


def smooth(piece: Samples, rate: float) -> SmoothPiece:
    """Filter and resample a piece, and differentiate the resulting curve.

    Parameters
    ----------
    piece :
        Samples, at any times.
    rate :
        The usual rate of the recording [Hz].
    """
    # Stamps jitter: a smooth curve through the samples themselves would overshoot where two are
    # close, straight lines don't.
    times = _grid(piece.times, rate)
    grid = _grid(times, float(np.clip(rate, MIN_RATE, MAX_RATE)))
    positions = np.column_stack([np.interp(times, piece.times, q) for q in piece.positions.T])
    if rate >= _FILTERED_RATE * CUTOFF:
        # Padding over the impulse response of the filter; the default is shorter.
        padding = min(len(positions) - 1, round(2 * rate / CUTOFF))
        positions = signal.sosfiltfilt(_low_pass(rate), positions, axis=0, padlen=padding)
    spline = interpolate.make_interp_spline(times, positions, k=_DEGREE)
    positions, velocities, accelerations = (spline(grid, nu=k) for k in range(3))
    return SmoothPiece(grid, positions, velocities, accelerations, recorded_rate=rate)


def _grid(times: FloatArray, rate: float) -> FloatArray:
    """Evenly spaced times from the first to the last, at about the given rate [Hz]."""
    n_steps = max(_DEGREE + 1, round((times[-1] - times[0]) * rate) + 1)
    return np.linspace(times[0], times[-1], n_steps)


@lru_cache(maxsize=16)  # its design takes as long as its use on a motion
def _low_pass(rate: float) -> Any:
    return signal.butter(_ORDER, CUTOFF, fs=rate, output="sos")


Span = tuple[int, int]
"""First and last step of an interval."""


# Joints rest while their speed is under this share of the recording's usual peak speed.
_REST_RATIO = 0.05
# Joints also rest under this many times the noise floor of the speed, which is this percentile of
# all speeds.
_NOISE_FACTOR = 5.0
_NOISE_PERCENTILE = 5.0
# A valley cuts if its speed is under this share of the lower of the adjacent peaks: the former
# where the joints reverse, the latter where they keep their direction, and in between in proportion
# to the cosine of the turn.
_TURNING_RATIO, _PASSING_RATIO = 0.6, 0.1
# Below this rate [Hz] valleys don't cut: the speed between samples is unknown.
_MIN_VALLEY_RATE = 20.0
# No motion is shorter [s]: a valley that would leave one doesn't cut.
_MIN_DURATION = 0.25
# A motion covers more than this share of the usual extent of the motions of all recordings.
_SET_RATIO = 0.05
# A motion covers more than this many standard deviations of the noise. Unfiltered noise, the worst
# case, reaches that during minutes at 10 to 25 Hz.
_NOISE_EXTENTS = 8.0
# The speed of means over this time shows no flicker of encoders at rest [s].
_FLICKER_TIME = 0.2

MOVING_RATIO = 0.15
"""A motion has a peak over this share of the recording's usual peak speed."""

MIN_EXTENT = 0.035
"""A motion covers more than this [rad or m]; an arm that is held still sways by two degrees."""

ABSURD_EXTENT = 12.0
"""Motions of a joint over more than this [rad or m] are absurd, such as those of degrees."""


@dataclass(frozen=True)
class SpeedThresholds:
    """Speeds that separate rest from motion: norms over the joints [rad/s or m/s].

    Attributes
    ----------
    rest : float
        Under it the joints rest.
    moving : float
        A motion has a peak over it.
    """

    rest: float
    moving: float


def joint_speed(velocities: FloatArray) -> FloatArray:
    """Norm of the joint velocities, shape (n_steps,)."""
    return np.asarray(np.linalg.norm(velocities, axis=1), dtype=np.float64)


def speed_thresholds(speed: FloatArray) -> SpeedThresholds:
    """Determine the thresholds from all speeds of a recording, shape (n_steps,)."""
    peak = _usual_peak(speed)
    noise = float(np.percentile(speed, _NOISE_PERCENTILE))
    moving = MOVING_RATIO * peak
    # A recording without rest shows no noise floor: its low speeds are motion.
    rest = min(max(_REST_RATIO * peak, _NOISE_FACTOR * noise), 0.5 * moving)
    return SpeedThresholds(rest=rest, moving=moving)


def _usual_peak(values: FloatArray) -> float:
    """Median of values weighted by their squares: many small ones hardly change it."""
    ordered = np.sort(values)
    energy = np.cumsum(ordered**2)
    return float(ordered[np.searchsorted(energy, 0.5 * energy[-1])])


def least_extent(pieces: Sequence[Samples]) -> float:
    """Smallest extent of a motion, by the noise of the recording [rad or m]."""
    positions = np.concatenate([piece.positions for piece in pieces])
    noise = [noise_deviation(position) for position in positions.T]
    return max(MIN_EXTENT, _NOISE_EXTENTS * float(np.linalg.norm(noise)))


def least_extent_of_set(extents: Sequence[float]) -> float:
    """Smallest extent of a motion, by the extents of the motions of all recordings [rad or m]."""
    return _SET_RATIO * _usual_peak(np.asarray(extents))


def find_motions(
    piece: SmoothPiece, thresholds: SpeedThresholds, min_rest: float, *, valleys: bool
) -> list[Span]:
    """Find the motions of a piece, also small ones, in order, as first and last step.

    They are cut at rests of at least `min_rest` [s], and on request at valleys of the speed.
    """
    speed = joint_speed(piece.velocities)
    runs = _moving_runs(speed, thresholds, round(min_rest * piece.rate))
    if valleys and piece.recorded_rate >= _MIN_VALLEY_RATE:
        window = max(1, round(_MIN_DURATION * piece.rate))
        runs = [part for run in runs for part in _split_at_valleys(piece, speed, run, window)]
    return [
        (first, last)
        for first, last in runs
        if speed[first : last + 1].max() >= thresholds.moving
        and last - first >= _MIN_DURATION * piece.rate
    ]


def trim(piece: SmoothPiece, thresholds: SpeedThresholds) -> Span | None:
    """First and last step of the motion of a piece; None if it doesn't move.

    Encoders that flicker at rest show speeds, but no speed of the means over a short time. Rests
    at the ends separate no motions, so that they need no length but that time.
    """
    runs = _moving_runs(joint_speed(piece.velocities), thresholds, min_rest_steps=0)
    if not runs:
        return None
    first, last = runs[0][0], runs[-1][1]
    calm = _moving_runs(_speed_of_means(piece), thresholds, min_rest_steps=0)
    least = _FLICKER_TIME * piece.rate
    if calm and calm[0][0] - first > least:
        first = calm[0][0]
    if calm and last - calm[-1][1] > least:
        last = calm[-1][1]
    return first, last


def _speed_of_means(piece: SmoothPiece) -> FloatArray:
    """Norm of the joint velocities between means over a short time before and after each step."""
    n = max(1, round(_FLICKER_TIME * piece.rate))
    padded = np.pad(piece.positions, ((n, n), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros(padded.shape[1]), padded]), axis=0)
    means = (sums[n:] - sums[:-n]) / n
    steps = means[n:] - means[:-n]
    return joint_speed(steps[: len(piece.positions)] / (n / piece.rate))


def extent(positions: FloatArray) -> float:
    """Norm over the joints of the distance that each of them covers [rad or m]."""
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def _moving_runs(speed: FloatArray, thresholds: SpeedThresholds, min_rest_steps: int) -> list[Span]:
    """Intervals over the rest speed; short rests between them are bridged."""
    over = np.concatenate(([False], speed > thresholds.rest, [False]))
    firsts = np.flatnonzero(~over[:-1] & over[1:])
    lasts = np.flatnonzero(over[:-1] & ~over[1:]) - 1
    if not firsts.size:
        return []
    rests = firsts[1:] - lasts[:-1] > min_rest_steps
    starts = firsts[np.concatenate(([True], rests))]
    ends = lasts[np.concatenate((rests, [True]))]
    return [
        _grown(speed, int(a), int(b))
        for a, b in zip(starts, ends, strict=True)
        if speed[a : b + 1].max() >= thresholds.moving
    ]


def _grown(speed: FloatArray, first: int, last: int) -> Span:
    """Extend a run outwards while the speed falls, because motions begin and end slowly.

    By at most a fifth of its length, three times as much as a minimum-jerk motion needs: without
    noise, a robot that settles at its goal slows down for a second.
    """
    most = (last - first) // 5
    start, end = max(first - most, 0), min(last + most, speed.size - 1)
    while first > start and speed[first - 1] < speed[first]:
        first -= 1
    while last < end and speed[last + 1] < speed[last]:
        last += 1
    return first, last


def _split_at_valleys(piece: SmoothPiece, speed: FloatArray, run: Span, window: int) -> list[Span]:
    """Split a run at its valleys.

    At first all local minima of the speed cut. Then the shallowest cut is removed, and the peaks
    beside it become one, until all cuts are deep enough: ripple on a flank does not hide a valley.
    Cuts beside a part of fewer steps than `window` are removed first.
    """
    minima, _ = signal.find_peaks(-speed[run[0] : run[1] + 1])
    bounds = [run[0], *(run[0] + int(step) for step in minima), run[1]]
    enough = [_share_that_cuts(piece.positions, cut, window) for cut in bounds[1:-1]]
    peaks = [float(speed[first : last + 1].max()) for first, last in pairwise(bounds)]

    n = len(enough)
    # Neighbours of each cut; -1 and n are the ends of the run. Cut i is at bounds[i + 1], and the
    # part behind it has the peak peaks[i + 1].
    before, behind = list(range(-1, n - 1)), list(range(1, n + 1))

    def excess(cut: int) -> float:
        first, valley, last = (bounds[i + 1] for i in (before[cut], cut, behind[cut]))
        too_near = min(valley - first, last - valley) < window
        share = float(speed[valley]) / min(peaks[before[cut] + 1], peaks[cut + 1])
        return share - enough[cut] + too_near

    excesses = {cut: excess(cut) for cut in range(n)}
    queue = [(-value, cut) for cut, value in excesses.items()]
    heapify(queue)
    while queue and queue[0][0] < 0.0:
        value, cut = heappop(queue)
        if excesses.get(cut) != -value:
            continue
        del excesses[cut]
        left, right = before[cut], behind[cut]
        peaks[left + 1] = max(peaks[left + 1], peaks[cut + 1])
        if left >= 0:
            behind[left] = right
        if right < n:
            before[right] = left
        for neighbour in {left, right} & excesses.keys():
            excesses[neighbour] = excess(neighbour)
            heappush(queue, (-excesses[neighbour], neighbour))
    return list(pairwise([run[0], *(bounds[cut + 1] for cut in sorted(excesses)), run[1]]))


def _share_that_cuts(positions: FloatArray, cut: int, window: int) -> float:
    """Share of the peak speed under which a valley cuts, by the turn of the joints there."""
    before = positions[cut] - positions[max(cut - window, 0)]
    after = positions[min(cut + window, len(positions) - 1)] - positions[cut]
    lengths = float(np.linalg.norm(before) * np.linalg.norm(after))
    cosine = float(before @ after) / lengths if lengths else 0.0
    turn = (1.0 - cosine) / 2.0
    return _PASSING_RATIO + turn * (_TURNING_RATIO - _PASSING_RATIO)
