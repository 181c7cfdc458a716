# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of a trust region (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4(3), 1983)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from ...arrays import FloatArray
from .matrices import BlockMatrix, Matrix, cholesky, mean_diagonal

# Factorisations of a matrix of blocks before the step falls back to steepest descent.
_MAX_FACTORS = 40


class TrustRegionStep(NamedTuple):
    """Minimiser of a quadratic model in a ball.

    Attributes
    ----------
    step : array, shape (n,)
        The minimiser p; its length meets the radius to a few percent.
    predicted : float
        Predicted decrease of the model.
    shift : float
        The μ ≥ 0 with (H + μI)p = −g.
    lowest_shift : float
        The least μ ≥ 0 that makes H + μI positive definite.
    """

    step: FloatArray
    predicted: float
    shift: float
    lowest_shift: float


def trust_region_step(hessian: Matrix, gradient: FloatArray, radius: float) -> TrustRegionStep:
    """Minimise gᵀp + ½pᵀHp over ‖p‖ ≤ radius (approximately, if H consists of blocks).

    Parameters
    ----------
    hessian : array, shape (n, n), or BlockMatrix
        Symmetric H, may be indefinite.
    gradient : array, shape (n,)
        g.
    radius : float
        Radius of the trust region.
    """
    if not gradient.size:
        return TrustRegionStep(gradient, 0.0, 0.0, 0.0)
    if isinstance(hessian, BlockMatrix):
        return _factorised_step(hessian, gradient, radius)
    _, newton, failed = lapack.dposv(hessian, gradient)
    if not failed and newton @ newton <= radius**2:
        return TrustRegionStep(-newton, 0.5 * float(newton @ gradient), 0.0, 0.0)
    eigenvalues, vectors = np.linalg.eigh(hessian)
    rotated = vectors.T @ gradient
    lowest = _lowest_shift(eigenvalues)
    shift = _shift(eigenvalues, rotated, radius, lowest)
    step = -rotated / (eigenvalues + shift)
    predicted = -float(rotated @ step + 0.5 * step @ (eigenvalues * step))
    return TrustRegionStep(vectors @ step, predicted, shift, lowest)


def _factorised_step(hessian: BlockMatrix, gradient: FloatArray, radius: float) -> TrustRegionStep:
    """Minimise by Cholesky factors alone, which preserve the blocks (Moré and Sorensen)."""
    shift, lowest = 0.0, 0.0
    for _ in range(_MAX_FACTORS):
        factor = cholesky(hessian, shift)
        if factor is None:
            shift = max(4.0 * shift, 1e-3 * abs(mean_diagonal(hessian)))
            lowest = shift
            continue
        step = -factor.solve(gradient)
        length = float(np.linalg.norm(step))
        if length <= 1.05 * radius:
            break
        bent = factor.solve_lower(step)
        # Newton's method on 1/‖p(μ)‖, which is nearly linear in μ.
        shift += (length / radius - 1.0) * length**2 / float(bent @ bent)
    else:
        step = -radius / float(np.linalg.norm(gradient)) * gradient
    predicted = -float(gradient @ step + 0.5 * step @ (hessian @ step))
    return TrustRegionStep(step, predicted, shift, lowest)


def _lowest_shift(eigenvalues: FloatArray) -> float:
    margin = 1e-10 * max(float(np.abs(eigenvalues).max()), 1e-300)
    return max(0.0, margin - float(eigenvalues[0]))


def _shift(eigenvalues: FloatArray, rotated: FloatArray, radius: float, lowest: float) -> float:
    """The μ ≥ `lowest` with ‖(H + μI)⁻¹g‖ about the radius."""
    shift = lowest
    for _ in range(50):
        step = rotated / (eigenvalues + shift)
        length = float(np.linalg.norm(step))
        excess = length / radius - 1.0
        if abs(excess) < 0.05 or (excess < 0.0 and shift == lowest):
            break
        # Newton's method on 1/‖p(μ)‖, which is nearly linear in μ.
        slope = float(np.sum(step**2 / (eigenvalues + shift))) / length
        shift = max(lowest, shift + excess * length / slope)
    return shift
