# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Naturalness of segments of a chain: how unlike the demonstrations a change of them is."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..primitives.conditional_model import ConditionalDistribution
from .bases import MotionBasis
from .compiler import MotionProgram
from .unknowns import END_SCALES, LOG_DURATION_SCALE

# Spread of the logarithm of durations that is as natural as a standard deviation of weights.
_DURATION_SPREAD = 0.3
# Passing at speed bends segments by more than demonstrations from rest to rest show: this many of
# their standard deviations count as one (`benchmarks/sequences.py` shows what comes of it). Where
# a joint hardly spreads, the deviation is at least this [rad or m].
_BEND_SPREAD, _MIN_SPREAD = 18.0, 0.01


def segment_precision(
    program: MotionProgram, basis: MotionBasis, expected: ConditionalDistribution
) -> FloatArray:
    """Precision of the unknowns of a segment, shape (n_unknowns, n_unknowns).

    A change of the states at the ends bends the motion, as weights do, so that it is weighed by the
    spread of the demonstrations, joint by joint, in the mean over the motion.
    """
    unknowns, tables = program.unknowns, basis.tables
    n, n_joints = unknowns.n_weights, unknowns.boundary.shape[1]
    precision = np.zeros((program.scales.size, program.scales.size))
    if basis.precision is not None:
        precision[:n, :n] = basis.precision * np.outer(program.scales[:n], program.scales[:n])
    if unknowns.duration_is_free:
        precision[unknowns.n_linear, unknowns.n_linear] = (
            LOG_DURATION_SCALE / _DURATION_SPREAD
        ) ** 2
    variances = np.zeros(n_joints)
    if basis.n_components:
        k = basis.n_components
        functions = tables.functions[:, 0, :, :k] / basis.basis.scales[:k]
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, expected.covariance, functions
        )
    spreads = _BEND_SPREAD * np.maximum(np.sqrt(variances), _MIN_SPREAD)
    rows = unknowns.free_rows
    bends = tables.hermite[0][:, rows] * END_SCALES[rows]
    gram = bends.T @ (bends * tables.quadrature[:, None])
    for j in range(n_joints):
        index = n + j + n_joints * np.arange(len(rows))
        precision[np.ix_(index, index)] += gram / spreads[j] ** 2
    return precision
