# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences of motions in path, and predictions at the same phases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..motion.interpolation import hermite_functions
from .timing import arc_length_warp, own_phases

if TYPE_CHECKING:
    from .primitive import MovementPrimitive

FINE_PHASES = np.linspace(0.0, 1.0, 1001)
"""Evenly spaced shares of the duration at which motions are compared."""

PHASES = FINE_PHASES[::10]
"""A tenth of them, for paths and figures, which need fewer."""


def path_difference(first: FloatArray, second: FloatArray) -> float:
    """RMS difference of two motions at equal shares of the path [rad or m].

    Each has the shape (1001, n_joints), at the fine phases.
    """
    return float(np.sqrt(np.mean((by_path_share(first) - by_path_share(second)) ** 2)))


def by_path_share(positions: FloatArray) -> FloatArray:
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
    shares = own_phases(arc_length_warp(positions), PHASES)
    return np.column_stack([np.interp(shares, FINE_PHASES, x) for x in positions.T])


def minimum_jerk_motion(start: FloatArray, goal: FloatArray) -> FloatArray:
    """The minimum-jerk motion between two positions at the fine phases, (1001, n_joints)."""
    return np.asarray(start + hermite_functions(FINE_PHASES)[:, 3:4] * (goal - start))


def expected_motion(
    primitive: MovementPrimitive, start: FloatArray, goal: FloatArray, duration: float
) -> FloatArray:
    """The prediction of a primitive for a request, at the fine phases, (1001, n_joints)."""
    expected = primitive.model.predict(start, goal, duration)
    basis = primitive.paced_basis(start, goal, expected.pace)
    return minimum_jerk_motion(start, goal) + basis.shape(expected.weights, FINE_PHASES)
