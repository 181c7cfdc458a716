# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Small convex quadratic programs, solved exactly.

A strictly convex program with inequalities is a least-distance problem, and that is a
nonnegative least-squares problem (Lawson and Hanson, "Solving Least Squares Problems", 1974,
chapter 23), for which SciPy has an active-set method. With few unknowns and few constraints
near their bounds it takes tens of microseconds, needs no further dependency, and tells
infeasible programs apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ..arrays import FloatArray

# Squared distance to infeasibility, in units of the scaled right-hand side, that is rounding.
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
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> QuadraticSolution | None:
    """Minimise ½pᵀHp + gᵀp subject to A p ≤ b.

    Parameters
    ----------
    hessian : array, shape (n, n)
        Positive definite H.
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
    # Late, so that the node starts fast.
    from scipy.optimize import nnls

    factor, failed = lapack.dpotrf(hessian, lower=1)
    if failed:
        return None
    n = len(gradient)
    # With u = Lᵀp + L⁻¹g the objective is ½‖u‖² up to a constant.
    whole = np.empty((n, 1 + len(bounds)), order="F")
    whole[:, 0], whole[:, 1:] = gradient, rows.T
    whole, _ = lapack.dtrtrs(factor, whole, lower=1, overwrite_b=1)
    shifted, whitened = whole[:, 0], whole[:, 1:]
    # Lengths of the rows don't matter to the problem, but to the rounding.
    lengths = np.maximum(np.sqrt(np.sum(whitened * whitened, axis=0)), 1e-12)
    system = np.empty((n + 1, len(bounds)))
    np.divide(whitened, -lengths, out=system[:n])
    np.divide(bounds + shifted @ whitened, -lengths, out=system[n])
    target = np.zeros(n + 1)
    target[n] = 1.0
    try:
        dual, _ = nnls(system, target)
    except RuntimeError:  # too many iterations: rows that depend on each other almost exactly
        return None
    residual = system @ dual - target
    if -residual[n] <= _INFEASIBLE:
        return None
    u = -residual[:n] / residual[n]
    step, _ = lapack.dtrtrs(factor, u - shifted, lower=1, trans=1)
    return QuadraticSolution(step, dual / -residual[n] / lengths)
