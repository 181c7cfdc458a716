# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Synthetic motions of different kinds, for benchmarks and tests of libraries."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, bell, progress


def generate_kinds(
    n_motions: int, n_kinds: int, seed: int, *, first: int = 0
) -> list[Demonstration]:
    """Generate motions of different kinds of the same arm, one of each kind in turn.

    The ends, the detour and the duration of a kind are drawn at random, and vary a little from
    motion to motion.

    Parameters
    ----------
    n_motions : int
        Number of motions.
    n_kinds : int
        Number of kinds; motion i is of kind i modulo this number.
    seed : int
        Chooses the kinds and the motions. The first ones don't depend on their number.
    first : int
        Index of the first motion.
    """
    return [_motion_of_kind(i, i % n_kinds, seed) for i in range(first, first + n_motions)]


def _motion_of_kind(index: int, kind: int, seed: int) -> Demonstration:
    rng = np.random.default_rng([seed, 0, kind])
    ends = rng.uniform([-2.0, -1.0, -0.5, -2.2], [0.2, 1.2, 1.5, -0.2], (2, 4))
    detour, detour_peak = rng.normal(0.0, 0.35, 4), rng.uniform(0.4, 0.6)
    usual_duration = rng.uniform(0.8, 2.0)
    rng = np.random.default_rng([seed, 1, index])
    start, goal = ends + rng.normal(0.0, 0.08, ends.shape)
    detour = detour * rng.uniform(0.7, 1.3) + rng.normal(0.0, 0.04, detour.shape)
    duration = usual_duration * float(np.exp(rng.normal(0.0, 0.1)))
    phases = np.linspace(0.0, 1.0, round(200.0 * duration) + 1)[:, None]
    peaks = np.full(4, rng.uniform(0.44, 0.52))
    positions = (
        start + (goal - start) * progress(phases, peaks) + detour * bell(phases, detour_peak)
    )
    times = phases[:, 0] * duration
    curve = CubicSpline(times, positions)
    return Demonstration.of_curve(JOINT_NAMES, curve, times, "made up")
