# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The boundary part h(s): the quintic, or minimum-jerk, motion between two states.

Every motion is its boundary part plus a shape that vanishes at both ends together with its first
two derivatives. Therefore a motion starts and ends as requested for any shape. Minimum-jerk motion:
Flash and Hogan, J. Neurosci. 5(7), 1985.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..arrays import FloatArray
from ..motion.interpolation import hermite_functions as hermite_functions
from ..motion.interpolation import quintics as quintics


def boundary_values(
    start: Iterable[FloatArray],
    goal: Iterable[FloatArray],
    duration: float,
) -> FloatArray:
    """Boundary values of a motion with respect to phase.

    Parameters
    ----------
    start, goal : array, shape (3, n_joints), or three arrays of shape (n_joints,)
        Positions [rad or m], velocities [/s] and accelerations [/s²].
    duration : float
        Duration of the motion [s].

    Returns
    -------
    values : array, shape (6, n_joints)
        q, dq/ds = T q̇ and d²q/ds² = T² q̈ at phase 0, then at phase 1.
    """
    (q, v, a), (q_end, v_end, a_end) = start, goal
    square = duration**2
    return np.array([q, duration * v, square * a, q_end, duration * v_end, square * a_end])
