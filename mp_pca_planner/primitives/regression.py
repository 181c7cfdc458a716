# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression on requests, averaged over kernels.

A few demonstrations don't determine how smooth and how noisy they are, nor whether a motion back
repeats the motion there in reversed time (waving) or mirrors it (circles). Predictions of several
kernels are therefore averaged. Each kernel counts by the density that it gives to demonstrations
that are left out: pseudo-Bayes factors (Gelfand and Dey, 1994; Rasmussen and Williams, "Gaussian
Processes for Machine Learning", 2006, sections 2.2 and 5.4.2). The prior mean is zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

# The kernels: inverse lengths in units of the spread of the requests, correlations of a motion with
# the reversed one, and variances of the noise in units of the variance that depends on the request.
# The largest noise leaves the prior mean.
_INVERSE_LENGTHS = (0.25, 1.0, 2.0)
_REVERSALS = (0.0, -0.8, 0.8)
_NOISES = (0.02, 0.2, 2.0, 200.0)
N_LENGTHS = len(_INVERSE_LENGTHS)
# Variance of what all outputs have in common, in the same units.
_CONSTANT = 10.0
# Power of the densities. Demonstrations that are left out one by one are not independent.
_TEMPER = 0.7
# Fewer demonstrations can't rank kernels; the first one is taken.
_MIN_RANKED = 3
# Share of the mean squared distance from start to goal that is added to each.
_MIN_SQUARE = 0.09
# Avoids logarithms of and divisions by zero.
_TINY = 1e-300

# What keeps its sign and what changes it where a motion is reversed in time.
_SIGNS = np.array([1.0, -1.0])[:, None, None]


Partition = Sequence[NDArray[np.intp]]
"""Groups of demonstrations that are left out together, by their indices."""


class RequestFeatures:
    """Distances and similarities of requests, in units of the demonstrations.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, n_entries)
        Start, goal, and at most one entry that is the same in both directions.
    """

    def __init__(self, requests: FloatArray) -> None:
        n = requests.shape[1] // 2
        starts, goals, rest = np.split(np.arange(requests.shape[1]), [n, 2 * n])
        self._swapped = np.concatenate([goals, starts, rest])
        mean = requests.mean(axis=0)
        self._centre = (mean + mean[self._swapped]) / 2.0
        # A spread or distance of zero: any unit will do.
        self._spread = float(np.sqrt(np.sum(requests.var(axis=0)))) or 1.0
        scaled = (requests - self._centre) / self._spread
        self._both_directions = np.array([scaled, scaled[:, self._swapped]])
        squares = self._squared_distances(requests)
        self._floor = _MIN_SQUARE * float(squares.mean()) or 1.0
        self._unit = float(np.exp(np.mean(np.log(squares + self._floor))))

    def distances(self, requests: FloatArray) -> FloatArray:
        """From start to goal, bounded from below, in units of their geometric mean."""
        return np.asarray(np.sqrt((self._squared_distances(requests) + self._floor) / self._unit))

    def similarities(self, request: FloatArray) -> FloatArray:
        """Prior covariances with demonstrations and reversed ones, by inverse length.

        Those of Matérn with smoothness 5/2 (Rasmussen and Williams, equation 4.17) and a constant.
        Squared exponentials, which are smoother, overshoot between and beyond demonstrations.

        Parameters
        ----------
        request : array, shape (n_entries,)
            Any request.

        Returns
        -------
        similarities : array, shape (n_lengths, 2, n_demonstrations)
            Of motions, then of reversed ones.
        """
        scaled = (request - self._centre) / self._spread
        apart = np.linalg.norm(self._both_directions - scaled, axis=2)
        ratios = np.sqrt(5.0) * np.multiply.outer(_INVERSE_LENGTHS, apart)
        return np.asarray((1.0 + ratios + ratios**2 / 3.0) * np.exp(-ratios) + _CONSTANT)

    def _squared_distances(self, requests: FloatArray) -> FloatArray:
        # Each joint counts twice, which any unit allows.
        return np.asarray(np.sum((requests - requests[..., self._swapped]) ** 2, axis=-1))


def novelty(similarities: FloatArray) -> float:
    """How unlike all demonstrations a request is, from 0 to 1, by the shortest kernel."""
    return 1.0 + _CONSTANT - float(similarities[-1, 0].max())


def fit_coefficients(
    similarities: Sequence[FloatArray],
    outputs: FloatArray,
    reversed_outputs: FloatArray,
    partitions: Sequence[Partition],
) -> tuple[FloatArray, FloatArray]:
    """Fit averages of Gaussian processes, one for each partition.

    Parameters
    ----------
    similarities : sequence of arrays, shape (n_lengths, 2, n_demonstrations)
        Of each demonstration.
    outputs, reversed_outputs : array, shape (n_demonstrations, n_outputs)
        Outputs of the demonstrations, and of the same motions in reversed time.
    partitions : sequence of Partition
        Groups of demonstrations that are left out together to rank the kernels.

    Returns
    -------
    coefficients : array, shape (n_partitions, n_lengths, 2, n_demonstrations, n_outputs)
        A prediction is the sum of their products with the similarities of a request.
    residuals : array, shape (n_demonstrations, n_outputs)
        Outputs minus predictions from the other groups of the first partition.
    """
    parts = np.array([outputs + reversed_outputs, outputs - reversed_outputs]) / 2.0
    shares, residuals, scores = [], [], []
    by_length = np.stack(similarities, axis=2)
    for (there, back), reversal, noise in product(by_length, _REVERSALS, _NOISES):
        gram = there + _SIGNS * reversal * back + noise * np.eye(len(outputs))
        inverse = np.linalg.inv(gram)
        solved = inverse @ parts
        shares.append([solved[0] + solved[1], reversal * (solved[0] - solved[1])])
        left = [_leave_out(inverse, solved, partition) for partition in partitions]
        residuals.append(left[0][0])
        scores.append([score for _, score in left])
    probabilities = _probabilities(np.array(scores).T, outputs)
    kernels = N_LENGTHS, len(_REVERSALS) * len(_NOISES)
    coefficients = np.einsum(
        "plk,lkdno->pldno",
        probabilities.reshape(-1, *kernels),
        np.reshape(shares, (*kernels, 2, *outputs.shape)),
    )
    return coefficients, np.tensordot(probabilities[0], residuals, axes=1)


def _leave_out(
    inverse: FloatArray, solved: FloatArray, partition: Partition
) -> tuple[FloatArray, float]:
    """Residuals of groups that are left out, and the logarithm of their density.

    Without refitting (Rasmussen and Williams, equations 5.10 to 5.12, for groups). The density is
    that of one output, with the variance that makes it highest, up to a constant.
    """
    residuals, variances = np.empty_like(solved), np.empty(solved.shape[:2])
    for group in partition:
        covariance = np.linalg.inv(inverse[:, group[:, None], group])
        residuals[:, group] = covariance @ solved[:, group]
        variances[:, group] = np.diagonal(covariance, axis1=1, axis2=2)
    square = np.sum(residuals**2 / variances[:, :, None])
    score = -0.25 * np.sum(np.log(variances)) - 0.5 * solved.shape[1] * np.log(square + _TINY)
    return np.sum(residuals, axis=0), float(score)


def _probabilities(scores: FloatArray, outputs: FloatArray) -> FloatArray:
    """Probabilities of the kernels for each partition, shape (n_partitions, n_kernels)."""
    if len(outputs) < _MIN_RANKED:
        return np.eye(1, scores.shape[1]).repeat(len(scores), axis=0)
    squares = outputs @ outputs.T
    # As many independent outputs as these correlated ones are worth.
    freedom = np.trace(squares) ** 2 / (np.sum(squares**2) + _TINY)
    probabilities = np.exp(_TEMPER * freedom * (scores - scores.max(axis=1, keepdims=True)))
    return np.asarray(probabilities / probabilities.sum(axis=1, keepdims=True))
