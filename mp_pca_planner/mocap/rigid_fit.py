# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The pose of a rigid body from points on it (Kabsch's method), frame by frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

MIN_POINTS = 3

_LEAST_WIDTH = 0.05
"""Points whose width is below this share of their length are on one line."""


def fix_a_pose(points: FloatArray, weights: FloatArray) -> NDArray[np.bool_]:
    """Whether points (those with a weight) fix a pose: at least three, not on one line.

    Parameters
    ----------
    points : array, shape (n_points, 3)
        Points in the body's frame [m].
    weights : array, shape (n_frames, n_points)
        Weight of each, 0 if it is missing.

    Returns
    -------
    :
        shape (n_frames,)
    """
    centred = points - _centres(np.broadcast_to(points, (*weights.shape, 3)), weights)
    spread = np.linalg.svd(centred * np.sqrt(weights)[..., None], compute_uv=False)
    if spread.shape[1] < 2:
        return np.zeros(len(weights), dtype=bool)
    enough = np.count_nonzero(weights, axis=1) >= MIN_POINTS
    return np.asarray(enough & (spread[:, 1] > _LEAST_WIDTH * spread[:, 0]))


def fit_poses(
    points: FloatArray, measured: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations R and translations t that minimise Σ w ‖R p + t − m‖² in each frame.

    Parameters
    ----------
    points : array, shape (n_points, 3)
        Points p in the body's frame [m].
    measured : array, shape (n_frames, n_points, 3)
        Measured positions m [m]; any finite ones where the weight is 0.
    weights : array, shape (n_frames, n_points)
        Weights w.

    Returns
    -------
    rotations : array, shape (n_frames, 3, 3)
        NaN in frames whose points don't fix a pose.
    translations : array, shape (n_frames, 3)
        [m]; likewise.
    """
    fixed = fix_a_pose(points, weights)
    there = np.broadcast_to(points, measured.shape)
    local_centres, centres = _centres(there, weights), _centres(measured, weights)
    correlation = np.einsum(
        "kp,kpi,kpj->kij", weights, measured - centres, there - local_centres, optimize=True
    )
    left, _, right = np.linalg.svd(correlation)
    # The nearest orthogonal matrix may be a reflection; then the weakest direction is turned.
    signs = np.ones((len(measured), 3))
    signs[:, 2] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotations = (left * signs[:, None, :]) @ right
    translations = centres[:, 0] - np.einsum("kij,kj->ki", rotations, local_centres[:, 0])
    rotations[~fixed], translations[~fixed] = np.nan, np.nan
    return rotations, translations


def _centres(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted means over the points, shape (n_frames, 1, 3)."""
    total = np.maximum(weights.sum(axis=1), np.finfo(float).tiny)
    means = np.einsum("kp,kpi->ki", weights, points) / total[:, None]
    return np.asarray(means[:, None, :])
