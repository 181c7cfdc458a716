# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Monotone time warps σ(p) from the phase p of a refined motion to that of the original.

σ' = exp(u) with u = Σ cₖ bₖ − κ b₀ and functions bₖ = p²(1−p)² Pₖ(2p−1) that vanish at both
ends with their first derivative. For all parameters c, σ increases, σ' = 1 and σ'' = 0 at both
ends, so positions, velocities and accelerations there do not change. κ ensures σ(1) = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from ..arrays import FloatArray
from ..primitives.basis import legendre_values

N_WARP_PARAMETERS = 3
"""Parameters of a warp: towards an end, towards the middle, and both."""

# exp(u) is analytic: this number of nodes gives it to rounding for parameters of a few units.
_N_NODES = 40
_NODES, _QUADRATURE = legendre.leggauss(_N_NODES)
# Values at the nodes → Legendre coefficients.
_ANALYSIS = (
    legendre.legvander(_NODES, _N_NODES - 1) * _QUADRATURE[:, None] * (np.arange(_N_NODES) + 0.5)
).T


def _bumps(n: int) -> FloatArray:
    """b₀ … bₙ at the nodes, shape (n_nodes, n + 1); b₀ is 1 in the middle."""
    phases = (_NODES + 1.0) / 2.0
    bump = 16.0 * (phases * (1.0 - phases)) ** 2
    return np.asarray(bump[:, None] * legendre.legvander(_NODES, n))


_BUMPS = _bumps(N_WARP_PARAMETERS)


@dataclass(frozen=True, eq=False)
class WarpValues:
    """A warp at some phases, with its derivatives by phase and by parameter.

    Attributes
    ----------
    values : array, shape (3, n_steps)
        σ, σ' and σ''.
    by_parameter : array, shape (3, n_steps, n_parameters)
        Their derivatives by the parameters.
    """

    values: FloatArray
    by_parameter: FloatArray


def evaluate_warp(parameters: FloatArray, phases: FloatArray) -> WarpValues:
    """Evaluate a warp.

    Parameters
    ----------
    parameters : array, shape (n_parameters,)
        c; zeros are the identity.
    phases : array, shape (n_steps,)
        Phases p in [0, 1].
    """
    bump, bumps = _BUMPS[:, 0], _BUMPS[:, 1:]
    kappa = _normalising(bumps @ parameters, bump)
    rate = _QUADRATURE * np.exp(bumps @ parameters - kappa * bump)
    # κ follows the parameters so that the integral of σ' stays 1.
    admissible = bumps - bump[:, None] * ((rate @ bumps) / (rate @ bump))
    # Columns: of the values, then of their derivatives by each parameter.
    exponents = (_ANALYSIS @ np.column_stack([bumps @ parameters - kappa * bump, admissible])).T
    u, bend = (legendre_values(exponents, phases, d) for d in (0, 1))
    ratio = np.exp(u[:, :1])
    rates = np.hstack([ratio, ratio * u[:, 1:]])
    bends = np.hstack([ratio * bend[:, :1], rates[:, 1:] * bend[:, :1] + ratio * bend[:, 1:]])
    at_nodes = (rate / _QUADRATURE)[:, None] * np.column_stack([np.ones(_N_NODES), admissible])
    # dp = dx / 2, and σ(0) = 0.
    integrals = legendre.legint((_ANALYSIS @ at_nodes).T, scl=0.5, lbnd=-1.0, axis=1)
    shares = legendre_values(np.asarray(integrals, dtype=np.float64), phases)
    tables = np.stack([shares, rates, bends])
    return WarpValues(tables[:, :, 0], tables[:, :, 1:])


def _normalising(exponent: FloatArray, bump: FloatArray) -> float:
    """The κ that makes the integral of exp(exponent − κ bump) over phase 1."""
    kappa = 0.0
    for _ in range(50):
        rate = _QUADRATURE * np.exp(exponent - kappa * bump) / 2.0
        excess = float(rate.sum()) - 1.0
        # The integral is convex in κ and decreasing: Newton's method converges monotonically.
        kappa += excess / float(rate @ bump)
        if abs(excess) < 1e-14:
            break
    return kappa
