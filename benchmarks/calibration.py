# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How well predicted standard deviations describe the errors of motions left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import by_way, expected_motion
from mp_pca_planner.primitives.prediction import FREEDOM
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.primitives.timing import align, aligned_positions
from mp_pca_planner.recordings.demonstration import Demonstration

CALIBRATION_SIZES = (3, 5, 8, 12, 20)
"""Numbers of demonstrations for which the predicted standard deviations are checked."""


@dataclass(frozen=True)
class Calibration:
    """How well predicted standard deviations describe the errors of motions left out.

    Attributes
    ----------
    n_demonstrations : int
        Number of demonstrations of each primitive.
    within : tuple of float
        Shares of the errors within the predicted intervals of 68, 95 and 99.7 %, which are those
        of one, two and three standard deviations of a Gaussian.
    in_span : float
        Share of the left-out requests with an in-span score below 3.
    error_ratio : float
        RMS error of left-out motions in path, in units of the expected one.
    """

    n_demonstrations: int
    within: tuple[float, float, float]
    in_span: float
    error_ratio: float


def calibration(
    motions: Sequence[Demonstration],
    options: PrimitiveOptions,
    *,
    sizes: Sequence[int] = CALIBRATION_SIZES,
    n_draws: int = 10,
    n_tested: int = 3,
) -> list[Calibration]:
    """Predict motions from a few others, drawn at random.

    Errors are those of the joint angles at a quarter, half and three quarters of the path.

    Parameters
    ----------
    motions :
        Motions of the same joints.
    options :
        How primitives are built.
    sizes :
        Numbers of demonstrations; those that leave no motion are skipped.
    n_draws, n_tested :
        Number of primitives for each size, and of motions left out of each.
    """
    found = []
    for size in sizes:
        rng, rows = np.random.default_rng(size), []
        for _ in range(n_draws if size < len(motions) else 0):
            order = rng.permutation(len(motions))
            primitive = build_primitive([motions[i] for i in order[:size]], "some", options)
            tested = [motions[i] for i in order[size:][:n_tested]]
            rows += [_standardised(motion, primitive) for motion in tested]
        if rows:
            errors, scores, squares, expected = map(np.array, zip(*rows, strict=True))
            one, two, three = (float(np.mean(np.abs(errors) < x)) for x in _interval_bounds())
            ratio = float(np.sqrt(squares.mean() / np.mean(expected**2)))
            in_span = float(np.mean(scores < 3.0))
            found.append(Calibration(size, (one, two, three), in_span, ratio))
    return found


def _interval_bounds() -> FloatArray:
    """Bounds of the predicted intervals of 68, 95 and 99.7 %, in standard deviations."""
    bounds = t.ppf(norm.cdf([1.0, 2.0, 3.0]), FREEDOM)
    return np.asarray(bounds * np.sqrt((FREEDOM - 2.0) / FREEDOM))


def _standardised(
    motion: Demonstration, primitive: MovementPrimitive
) -> tuple[FloatArray, float, float, float]:
    """Errors in standard deviations, in-span score, and mean square and expected error."""
    phases = np.array([0.25, 0.5, 0.75])
    start, goal = motion.positions[[0, -1]]
    expected = primitive.model.predict(start, goal, motion.duration)
    (warp,) = align([motion], "arc_length")
    straight = start + hermite_functions(phases)[:, 3:4] * (goal - start)
    predicted = straight + primitive.basis.shape(expected.weights, phases)
    errors = aligned_positions(motion, warp, phases) - predicted
    functions = primitive.basis.functions(phases)
    covariance = expected.variance * expected.covariance
    variances = np.einsum("pjk,kl,pjl->pj", functions, covariance, functions)
    variances += np.mean(primitive.fit_residual**2, axis=0) + 1e-12
    both = by_way(expected_motion(primitive, motion)) - by_way(motion.time_normalised(1001))
    score, usual = expected.in_span_score, primitive.prediction_error(expected)
    return errors / np.sqrt(variances), score, float(np.mean(both**2)), usual
