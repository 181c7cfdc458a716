# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Smooth motions on a uniform grid, with their derivatives, from repaired samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from ..arrays import FloatArray
from .repair import Piece


@dataclass(frozen=True)
class SmoothingOptions:
    """Filter and rate of smooth motions.

    Attributes
    ----------
    cutoff : float
        Cut-off of the low-pass [Hz]; 6 to 10 Hz is usual for movements of the human arm. Below
        five times this rate samples are not filtered, since they hold little above the cut-off.
    order : int
        Order of the low-pass. It is applied forwards and backwards: no delay, twice the order.
    min_rate, max_rate : float
        Bounds of the rate of the result [Hz]; between them it has the rate of the recording.
    degree : int
        Degree of the spline. 3 is the lowest one with continuous accelerations; higher ones
        oscillate where samples are few.
    """

    cutoff: float = 8.0
    order: int = 2
    min_rate: float = 50.0
    max_rate: float = 200.0
    degree: int = 3


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


def smooth(
    piece: Piece, rate: float, options: SmoothingOptions = SmoothingOptions()
) -> SmoothPiece:
    """Filter and resample a piece, and differentiate the resulting curve.

    Parameters
    ----------
    piece :
        Samples, at any times.
    rate :
        The usual rate of the recording [Hz].
    options :
        Filter and rate of the result.
    """
    # Stamps jitter: a smooth curve through the samples themselves would overshoot where two are
    # close, straight lines don't.
    times = _grid(piece.times, rate, options)
    grid = _grid(times, float(np.clip(rate, options.min_rate, options.max_rate)), options)
    curves = np.empty((3, grid.size, piece.positions.shape[1]))
    # One joint after the other: a spline of all at once takes several times their memory.
    for joint, recorded in enumerate(piece.positions.T):
        position = np.interp(times, piece.times, recorded)
        if rate >= 5 * options.cutoff:
            position = _filtered(position, rate, options)
        spline = make_interp_spline(times, position, k=options.degree)
        for order in range(3):
            curves[order, :, joint] = spline(grid, nu=order)
    positions, velocities, accelerations = curves
    return SmoothPiece(grid, positions, velocities, accelerations, recorded_rate=rate)


def _grid(times: FloatArray, rate: float, options: SmoothingOptions) -> FloatArray:
    """Evenly spaced times from the first to the last, at about the given rate [Hz]."""
    n_steps = max(options.degree + 1, round((times[-1] - times[0]) * rate) + 1)
    return np.linspace(times[0], times[-1], n_steps)


def _filtered(position: FloatArray, rate: float, options: SmoothingOptions) -> FloatArray:
    low_pass = butter(options.order, options.cutoff, fs=rate, output="sos")
    # Padding over the impulse response of the filter; the default is shorter.
    padding = min(len(position) - 1, round(2 * rate / options.cutoff))
    return np.asarray(sosfiltfilt(low_pass, position, padlen=padding), dtype=np.float64)
