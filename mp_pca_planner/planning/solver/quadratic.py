# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Small convex quadratic programs, solved exactly.

A strictly convex program with inequalities is a least-distance problem, and that is a
nonnegative least-squares problem (Lawson and Hanson, "Solving Least Squares Problems", 1974,
chapter 23), for which SciPy has an active-set method. With few unknowns and few constraints
near their bounds it takes tens of microseconds, needs no further dependency, and detects
infeasible programs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from .matrices import Factor

# Squared distance to infeasibility that counts as rounding, in units of the scaled right-hand side.
_INFEASIBLE = 1e-12


@dataclass(frozen=True, eq=False)
class QuadraticSolution:
    """Minimiser of a quadratic program.

    Attributes
    ----------
    step : array, shape (n,)
        The minimiser.
    multipliers : array, shape (m,)
        Lagrange multipliers of the constraints, not negative.
    """

    step: FloatArray
    multipliers: FloatArray


def solve_quadratic(
    factor: Factor | None, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> QuadraticSolution | None:
    """Minimise ½pᵀHp + gᵀp subject to A p ≤ b.

    Parameters
    ----------
    factor : Factor or None
        Cholesky factor of H; None if that is not positive definite.
    gradient : array, shape (n,)
        g.
    rows : array, shape (m, n)
        A.
    bounds : array, shape (m,)
        b.

    Returns
    -------
    solution : QuadraticSolution or None
        None if the constraints contradict each other (or H is not positive definite).
    """
    # Imported here for a fast start of the node.
    from scipy.optimize import nnls

    if factor is None:
        return None
    n = len(gradient)
    # With u = Lᵀp + L⁻¹g the objective is ½‖u‖² up to a constant.
    whole = np.empty((n, 1 + len(bounds)), order="F")
    whole[:, 0], whole[:, 1:] = gradient, rows.T
    whole = factor.solve_lower(whole)
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
    step = factor.solve_upper(u - shifted)
    return QuadraticSolution(step, dual / -residual[n] / lengths)
