# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Naturalness: the price of deviations from the demonstrations."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ...primitives.prediction import ConditionalDistribution
from ..options import SearchOptions
from .bases import MotionBasis
from .segment import SegmentProgram
from .unknowns import END_SCALES, GOAL_POSITION, LOG_DURATION_SCALE


def goal_precision(
    segment: SegmentProgram, basis: MotionBasis, goals: FloatArray, search: SearchOptions
) -> FloatArray:
    """Precision of the unknowns of a motion to a single goal, in units of its objective.

    Parameters
    ----------
    segment : SegmentProgram
        The motion.
    basis : MotionBasis
        Its basis, with a prediction.
    goals : array, shape (n_demonstrations, n_joints)
        Goals of the demonstrations. A free goal is natural near the configuration of the search
        that is most like them; their spread is the unit of its changes.
    search : SearchOptions
        Options.

    Returns
    -------
    precision : array, shape (n_unknowns, n_unknowns)
        At ρ = 1.
    """
    assert basis.precision is not None
    n, size = segment.unknowns.n_weights, segment.unknowns.scales.size
    own = basis.precision * np.outer(segment.unknowns.scales[:n], segment.unknowns.scales[:n])
    precision = np.zeros((size, size))
    precision[:n, :n] = own
    free = range(n, segment.unknowns.n_linear)
    if free:
        spread = np.maximum(goals.std(axis=0), search.min_spread)
        precision[free, free] = (END_SCALES[GOAL_POSITION] / spread) ** 2
    return precision * unit_of_naturalness(segment, own, search.effort_weight)


def segment_precision(
    segment: SegmentProgram,
    basis: MotionBasis,
    expected: ConditionalDistribution,
    search: SearchOptions,
) -> FloatArray:
    """Precision of the unknowns of a segment, shape (n_unknowns, n_unknowns).

    A change of the boundary states bends the motion as weights do. Its cost is relative to the
    spread of the demonstrations of each joint, averaged over the motion.
    """
    unknowns, tables = segment.unknowns, basis.tables
    n, n_joints = unknowns.n_weights, unknowns.boundary.shape[1]
    precision = np.zeros((segment.unknowns.scales.size, segment.unknowns.scales.size))
    if basis.precision is not None:
        precision[:n, :n] = basis.precision * np.outer(
            segment.unknowns.scales[:n], segment.unknowns.scales[:n]
        )
    if unknowns.duration_is_free:
        precision[unknowns.n_linear, unknowns.n_linear] = (
            LOG_DURATION_SCALE / search.duration_spread
        ) ** 2
    variances = np.zeros(n_joints)
    if basis.n_components:
        k = basis.n_components
        functions = tables.values[0, 1:-1, :, 1 : k + 1]
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, expected.covariance, functions
        )
    spreads = search.bend_spread * np.maximum(np.sqrt(variances), search.min_spread)
    rows = unknowns.free_rows
    bends = tables.hermite[0, 1:-1, rows].T * END_SCALES[rows]
    gram = bends.T @ (bends * tables.quadrature[:, None])
    for j in range(n_joints):
        index = n + j + n_joints * np.arange(len(rows))
        precision[np.ix_(index, index)] += gram / spreads[j] ** 2
    return precision


def unit_of_naturalness(
    segment: SegmentProgram, precision: FloatArray, effort_weight: float
) -> float:
    """Cost of one standard deviation from the expected motion at ρ = 1.

    It is the larger of two values: the cost of the expected motion, and `effort_weight` times the
    decrease of the objective along one standard deviation. The second keeps motions natural if
    their effort could decrease fast: to first order, the optimum is at most 1 / (ρ effort_weight)
    standard deviations away.
    """
    _, here = segment.at(segment.expected)
    gradient = here.gradient[: len(precision)]
    descent = float(np.sqrt(gradient @ np.linalg.solve(precision, gradient)))
    return max(here.cost, effort_weight * descent)
