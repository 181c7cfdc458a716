# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences of two motions: in time, after the best time alignment, and in path."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .alignment import arc_length_warp, own_phases

FINE_PHASES = np.linspace(0.0, 1.0, 1001)
"""Evenly spaced shares of the duration at which motions are compared."""

PHASES = FINE_PHASES[::10]
"""A tenth of them, for paths and figures, which need fewer."""

MEASURES = ("time", "aligned", "path")
"""RMS differences over phases and joints: at equal shares of the time; at each instant of the
motion after the best warp of the prediction; at equal shares of the path. Only the first depends on
the timing."""


def differences(prediction: FloatArray, truth: FloatArray) -> FloatArray:
    """RMS differences of a prediction from a motion.

    Parameters
    ----------
    prediction, truth : array, shape (1001, n_joints)
        Positions at the fine phases [rad or m].

    Returns
    -------
    differences : array, shape (3,)
        By the `MEASURES`, in the same order [rad or m].
    """
    in_path = by_way(prediction) - by_way(truth)
    return np.array(
        [
            np.sqrt(np.mean((prediction[::10] - truth[::10]) ** 2)),
            _after_alignment(prediction[::2], truth[::10]),
            np.sqrt(np.mean(in_path**2)),
        ]
    )


def by_way(positions: FloatArray) -> FloatArray:
    """Positions along the path with the timing of a minimum-jerk motion.

    Parameters
    ----------
    positions : array, shape (1001, n_joints)
        A motion at the fine phases [rad or m].

    Returns
    -------
    positions : array, shape (101, n_joints)
        See :func:`.arc_length_warp`.
    """
    own = own_phases(arc_length_warp(positions), PHASES)
    return np.column_stack([np.interp(own, FINE_PHASES, x) for x in positions.T])


def _after_alignment(prediction: FloatArray, truth: FloatArray) -> float:
    """Least RMS difference over monotone matches of both ends, by dynamic programming."""
    squares = np.mean((truth[:, None] - prediction[None]) ** 2, axis=2)
    sums = np.full(len(prediction), np.inf)
    sums[0] = squares[0, 0]
    for row in squares[1:]:
        sums = row + np.minimum.accumulate(sums)
    return float(np.sqrt(sums[-1] / len(truth)))
