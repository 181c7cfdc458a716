# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Quadratic models: steps in a trust region, and small convex programs, solved exactly.

A strictly convex program with inequalities is a least-distance problem, and that is a
nonnegative least-squares problem (Lawson and Hanson, "Solving Least Squares Problems", 1974,
chapter 23), for which SciPy has an active-set method. With few unknowns and few constraints
near their bounds it takes tens of microseconds, needs no further dependency, and detects
infeasible programs.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ...arrays import FloatArray

TINY = float(np.finfo(float).tiny)
"""Avoids divisions by zero."""

# Squared distance to infeasibility that counts as rounding, in units of the scaled right-hand side.
_INFEASIBLE = 1e-12


def cholesky(matrix: FloatArray, shift: float = 0.0) -> FloatArray | None:
    """The lower factor of H + shift·I; None if that is not positive definite."""
    moved = matrix + shift * np.eye(len(matrix)) if shift else matrix
    lower, failed = lapack.dpotrf(moved, lower=1)
    return None if failed else lower


def _solved(lower: FloatArray, right: FloatArray, transposed: int = 0) -> FloatArray:
    """L⁻¹ or L⁻ᵀ times a matrix or vector."""
    found, _ = lapack.dtrtrs(lower, right, lower=1, trans=transposed)
    return np.asarray(found)


def solve_quadratic(
    factor: FloatArray | None, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Minimise ½pᵀHp + gᵀp subject to A p ≤ b.

    Parameters
    ----------
    factor : array, shape (n, n), or None
        Lower Cholesky factor of H; None if that is not positive definite.
    gradient : array, shape (n,)
        g.
    rows : array, shape (m, n)
        A.
    bounds : array, shape (m,)
        b.

    Returns
    -------
    solution : tuple of (array, shape (n,), array, shape (m,)), or None
        The minimiser, and the Lagrange multipliers of the constraints, not negative. None if the
        constraints contradict each other (or H is not positive definite).
    """
    # Imported here for a fast start of the node.
    from scipy.optimize import nnls

    if factor is None:
        return None
    n = len(gradient)
    # With u = Lᵀp + L⁻¹g the objective is ½‖u‖² up to a constant.
    whole = np.empty((n, 1 + len(bounds)), order="F")
    whole[:, 0], whole[:, 1:] = gradient, rows.T
    whole = _solved(factor, whole)
    shifted, whitened = whole[:, 0], whole[:, 1:]
    # Rows are scaled to unit length, which reduces rounding errors.
    lengths = np.maximum(np.sqrt(np.sum(whitened * whitened, axis=0)), 1e-12)
    system = np.empty((n + 1, len(bounds)))
    np.divide(whitened, -lengths, out=system[:n])
    np.divide(bounds + shifted @ whitened, -lengths, out=system[n])
    target = np.zeros(n + 1)
    target[n] = 1.0
    try:
        dual, _ = nnls(system, target)
    except (RuntimeError, ValueError):  # nearly dependent rows, or rows that are not finite
        return None
    residual = system @ dual - target
    if -residual[n] <= _INFEASIBLE:
        return None
    u = -residual[:n] / residual[n]
    step = _solved(factor, u - shifted, transposed=1)
    return step, dual / -residual[n] / lengths


def nearest_step(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A step with small violations of contradicting constraints, and their penalties."""
    broken = bounds < 0.0
    if not broken.any():  # the constraints are consistent, but the program was not solved
        step = np.asarray(np.linalg.solve(hessian, -gradient))
        broken = rows @ step > bounds
        if not broken.any():
            return step, np.zeros(len(bounds))
    matrix = rows[broken]
    penalty = 1e3 * float(np.trace(hessian)) / max(float(np.sum(matrix**2)), TINY)
    regular = hessian + penalty * matrix.T @ matrix
    step = np.asarray(np.linalg.solve(regular, penalty * matrix.T @ bounds[broken] - gradient))
    return step, np.where(broken, penalty * np.maximum(rows @ step - bounds, 0.0), 0.0)


def convex_factor(hessian: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """The matrix, if needed with the absolute values of its eigenvalues, and its lower factor."""
    factor = cholesky(hessian)
    if factor is not None:
        return hessian, factor
    eigenvalues, vectors = np.linalg.eigh(hessian)
    sizes = np.abs(eigenvalues)
    convex = np.asarray((vectors * np.maximum(sizes, 1e-10 * sizes.max())) @ vectors.T)
    return convex, cholesky(convex)


def trust_region_step(
    hessian: FloatArray, gradient: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """Minimise gᵀp + ½pᵀHp over ‖p‖ ≤ radius.

    After Moré and Sorensen (SIAM J. Sci. Stat. Comput. 4(3), 1983).

    Parameters
    ----------
    hessian : array, shape (n, n)
        Symmetric H, may be indefinite.
    gradient : array, shape (n,)
        g.
    radius : float
        Radius of the trust region.

    Returns
    -------
    step : array, shape (n,)
        The minimiser p; its length meets the radius to a few percent.
    shift : float
        The μ ≥ 0 with (H + μI)p = −g.
    """
    if not gradient.size:
        return gradient, 0.0
    _, newton, failed = lapack.dposv(hessian, gradient)
    if not failed and newton @ newton <= radius**2:
        return -newton, 0.0
    eigenvalues, vectors = np.linalg.eigh(hessian)
    rotated = vectors.T @ gradient
    margin = 1e-10 * max(float(np.abs(eigenvalues).max()), 1e-300)
    shift = lowest = max(0.0, margin - float(eigenvalues[0]))
    for _ in range(50):
        step = rotated / (eigenvalues + shift)
        length = float(np.linalg.norm(step))
        excess = length / radius - 1.0
        if abs(excess) < 0.05 or (excess < 0.0 and shift == lowest):
            break
        # Newton's method on 1/‖p(μ)‖, which is nearly linear in μ.
        slope = float(np.sum(step**2 / (eigenvalues + shift))) / length
        shift = max(lowest, shift + excess * length / slope)
    step = -rotated / (eigenvalues + shift)
    return vectors @ step, shift
