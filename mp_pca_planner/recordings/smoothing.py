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


def smooth(piece: Piece, rate: float) -> SmoothPiece:
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
    curves = np.empty((3, grid.size, piece.positions.shape[1]))
    # One joint after the other: a spline of all at once takes several times their memory.
    for joint, recorded in enumerate(piece.positions.T):
        position = np.interp(times, piece.times, recorded)
        if rate >= _FILTERED_RATE * CUTOFF:
            position = _filtered(position, rate)
        spline = make_interp_spline(times, position, k=_DEGREE)
        for order in range(3):
            curves[order, :, joint] = spline(grid, nu=order)
    positions, velocities, accelerations = curves
    return SmoothPiece(grid, positions, velocities, accelerations, recorded_rate=rate)


def _grid(times: FloatArray, rate: float) -> FloatArray:
    """Evenly spaced times from the first to the last, at about the given rate [Hz]."""
    n_steps = max(_DEGREE + 1, round((times[-1] - times[0]) * rate) + 1)
    return np.linspace(times[0], times[-1], n_steps)


def _filtered(position: FloatArray, rate: float) -> FloatArray:
    low_pass = butter(_ORDER, CUTOFF, fs=rate, output="sos")
    # Padding over the impulse response of the filter; the default is shorter.
    padding = min(len(position) - 1, round(2 * rate / CUTOFF))
    return np.asarray(sosfiltfilt(low_pass, position, padlen=padding), dtype=np.float64)
