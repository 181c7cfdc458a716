# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The conditional model, which predicts weights, time scaling and duration for a request.

Gaussian-process regression, averaged over kernels. A few demonstrations don't determine their
smoothness and noise. They don't determine, either, whether a return motion repeats the forward
motion in reversed time (waving) or mirrors it (circles). Kernels are weighted by their density of
left-out demonstrations: pseudo-Bayes factors (Gelfand and Dey, 1994; Rasmussen and Williams,
"Gaussian Processes for Machine Learning", 2006, sections 2.2 and 5.4.2). The prior mean is the
minimum-jerk motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .covariances import in_span_score, marginal_precision, request_precision, shrunk_covariance
from .kernels import CONSTANT, LEAST_NOISE, RequestFeatures
from .pace import reversed_paces

# Predicted durations stay within this many standard deviations of the demonstrated ones.
_MAX_DEVIATIONS = 3.0

# Avoids logarithms of zero and divisions by zero.
_TINY = 1e-300

Groups = Sequence[NDArray[np.intp]]
"""Indices of demonstrations that are left out together, in arrays of groups of one size."""


@dataclass(frozen=True)
class FitOptions:
    """Kernels of a fit and their weighting.

    Attributes
    ----------
    time_reversal : float
        Magnitude of the time-reversal correlations of the kernels, from 0 to 1; there are kernels
        without, with the positive and with the negative one.
    noises : tuple of float
        Variances of the noise in units of the variance that depends on the request. The largest
        one leaves the prior mean.
    temper : float
        Power of the densities, below 1 because demonstrations are not independent.
    min_ranked : int
        Least number of demonstrations to rank kernels; with fewer, the first kernel is used.
    max_demonstrations : int
        Largest number of demonstrations; more are thinned out evenly, because the time to fit grows
        with the cube of their number.
    """

    time_reversal: float = 0.8
    noises: tuple[float, ...] = (LEAST_NOISE, 0.2, 2.0, 200.0)
    temper: float = 0.7
    min_ranked: int = 3
    max_demonstrations: int = 200


_FIT = FitOptions()


@dataclass(frozen=True, eq=False)
class ConditionalDistribution:
    """The distribution of motions for a request.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        Expected weights ŵ.
    covariance : array, shape (n_weights, n_weights)
        Their covariance Λ, positive definite.
    precision : array, shape (n_weights, n_weights)
        Λ⁻¹.
    pace : array, shape (n_pace,)
        Expected time scaling, see :mod:`.pace`; zero: even.
    duration : float
        The duration of the request, or else the expected one [s].
    in_span_score : float
        Distance of the request from the demonstrations: the Mahalanobis distance of its end points
        (and duration, if given), divided by the square root of their number; about 1 for a request
        like the demonstrations.
    """

    weights: FloatArray
    covariance: FloatArray
    precision: FloatArray
    pace: FloatArray
    duration: float
    in_span_score: float


@dataclass(frozen=True, eq=False)
class ConditionalModel:
    """A fitted regression of motions on requests (q0, qT, log T).

    Shapes and durations grow with the square root of the distance from start to goal: small
    motions are straighter. Demonstrations of several activities are fitted twice, with kernels
    ranked by left-out motions and by left-out activities. The second fit is used for requests
    out of distribution.

    Attributes
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of the demonstrations that the model is fitted to.
    shape_coefficients : array, shape (n_lengths, n_fits, 2, n_demonstrations, n_weights)
        Of weights less the straight ones: a prediction is the sum of their products with the
        similarities of the request to the demonstrations.
    straight_weights : array, shape (n_weights,)
        Weights of a minimum-jerk motion, which is the prior mean.
    pace_coefficients : array, shape (n_lengths, n_fits, 2, n_demonstrations, n_pace)
        Of time scalings.
    duration_coefficients : array, shape (n_lengths, 1, 2, n_demonstrations, 1)
        Of log T less its mean, by the end points alone.
    weight_covariance, weight_precision : array, shape (n_weights, n_weights)
        Covariance of the errors of the weights of left-out demonstrations, and its inverse.
    request_precision : array, shape (2 n_joints + 1, 2 n_joints + 1)
        Inverse covariance of the requests.
    """

    requests: FloatArray
    shape_coefficients: FloatArray
    straight_weights: FloatArray
    pace_coefficients: FloatArray
    duration_coefficients: FloatArray
    weight_covariance: FloatArray
    weight_precision: FloatArray
    request_precision: FloatArray

    @classmethod
    def fit(
        cls,
        requests: FloatArray,
        shapes: FloatArray,
        reversed_shapes: FloatArray,
        straight_weights: FloatArray,
        paces: FloatArray,
        labels: Sequence[str],
    ) -> ConditionalModel:
        """Fit a model to demonstrations.

        Parameters
        ----------
        requests, straight_weights :
            See the attributes; the requests are those of all demonstrations, the following
            arguments are of those that :func:`thinned` returns.
        shapes, reversed_shapes : array, shape (n_demonstrations, n_weights)
            Weights of the demonstrations less the straight ones, and of the same motions in
            reversed time.
        paces : array, shape (n_demonstrations, n_pace)
            Their time scalings.
        labels : sequence of str
            Activity of each.
        """
        used, activities = requests[thinned(requests)], np.asarray(labels)
        partitions: list[Groups] = [[np.arange(len(used))[:, None]]]
        if np.any(activities != activities[0]):
            partitions.append([np.argwhere(activities == x).T for x in np.unique(activities)])
        similar, distances = zip(*map(RequestFeatures(used), used), strict=True)
        roots = np.sqrt(distances)[:, None]
        there, back = (x / roots for x in (shapes, reversed_shapes))
        shape, residuals = _fit(similar, there, back, partitions)
        pace, _ = _fit(similar, paces, reversed_paces(paces), partitions)
        similar, _ = zip(*map(RequestFeatures(used[:, :-1]), used[:, :-1]), strict=True)
        times = used[:, -1:] - used[:, -1].mean() - np.log(roots)
        duration, _ = _fit(similar, times, times, partitions[:1])
        covariances = *shrunk_covariance(residuals * roots), request_precision(requests)
        return cls(used, shape, straight_weights, pace, duration, *covariances)

    def predict(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> ConditionalDistribution:
        """Predict motions for a request.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            End points [rad or m].
        duration : float, optional
            Duration [s]; the expected one unless given.
        """
        ends, score = np.concatenate([start, goal]), self.in_span_score(start, goal, duration)
        expected = self._expected_duration(ends) if duration is None else duration
        request = np.append(ends, math.log(expected))
        similar, distance = self._features(request)
        # Novelty of the request, from 0 to 1, by the shortest kernel.
        novelty = 1.0 + CONSTANT - similar[-1, 0].max()
        near, far = self._coefficients
        both = similar.ravel() @ (near + novelty * far if far.any() else near)
        shape, pace = both[: self.straight_weights.size], both[self.straight_weights.size :]
        weights = self.straight_weights + math.sqrt(distance) * shape
        of_weights = self.weight_covariance, self.weight_precision
        return ConditionalDistribution(weights, *of_weights, pace, expected, score)

    def in_span_score(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> float:
        """Distance of a request from the demonstrations, see :class:`ConditionalDistribution`."""
        if duration is None:
            return in_span_score(np.concatenate([start, goal]), self.mean, self._end_precision)
        request = np.concatenate([start, goal, [math.log(duration)]])
        return in_span_score(request, self.mean, self.request_precision)

    @cached_property
    def mean(self) -> FloatArray:
        """Mean request, shape (2 n_joints + 1,)."""
        return np.asarray(self.requests.mean(axis=0))

    @cached_property
    def _end_precision(self) -> FloatArray:
        """Inverse covariance of the end points of the requests."""
        return marginal_precision(self.request_precision, self.mean.size - 1)

    @cached_property
    def _features(self) -> RequestFeatures:
        return RequestFeatures(self.requests)

    @cached_property
    def _end_features(self) -> RequestFeatures:
        return RequestFeatures(self.requests[:, :-1])

    @cached_property
    def _coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Of shapes and time scalings near the demonstrations, and their change far from them."""
        both = np.concatenate([self.shape_coefficients, self.pace_coefficients], axis=-1)
        near, far = (both[:, i].reshape(-1, both.shape[-1]) for i in (0, -1))
        return near, far - near

    @cached_property
    def _reach(self) -> float:
        """Largest deviation of the logarithm of an expected duration from the mean."""
        return float(_MAX_DEVIATIONS * self.requests[:, -1].std())

    def _expected_duration(self, ends: FloatArray) -> float:
        similar, distance = self._end_features(ends)
        residual = float(similar.ravel() @ self.duration_coefficients[:, 0].ravel())
        # Bounded, because a distant request may extrapolate the trend to implausible durations.
        deviation = min(max(math.log(distance) / 2.0 + residual, -self._reach), self._reach)
        return math.exp(self.mean[-1] + deviation)


def left_out_squares(
    requests: FloatArray, shapes: FloatArray, reversed_shapes: FloatArray
) -> FloatArray:
    """Squared errors of shapes that are left out and predicted from the others.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T; the time grows with the cube of their number.
    shapes, reversed_shapes : array, shape (n_demonstrations, n_functions)
        Coefficients of the shapes, and of the same motions in reversed time.

    Returns
    -------
    squares : array, shape (n_demonstrations,)
        Sums of squares over the coefficients.
    """
    similar, distances = zip(*map(RequestFeatures(requests), requests), strict=True)
    roots = np.sqrt(distances)[:, None]
    partition: Groups = [np.arange(len(requests))[:, None]]
    _, residuals = _fit(similar, shapes / roots, reversed_shapes / roots, [partition])
    return np.asarray(np.sum((residuals * roots) ** 2, axis=1))


def thinned(requests: FloatArray) -> NDArray[np.intp]:
    """The demonstrations to fit, by index, whatever the order of all."""
    step = -(-len(requests) // _FIT.max_demonstrations)
    return np.lexsort(requests.T[::-1])[::step] if step > 1 else np.arange(len(requests))


def _fit(
    similarities: Sequence[FloatArray],
    outputs: FloatArray,
    reversed_outputs: FloatArray,
    partitions: Sequence[Groups],
) -> tuple[FloatArray, FloatArray]:
    """Fit averages of Gaussian processes, one for each partition.

    Parameters
    ----------
    similarities : sequence of arrays, shape (n_lengths, 2, n_demonstrations)
        Of each demonstration.
    outputs, reversed_outputs : array, shape (n_demonstrations, n_outputs)
        Outputs of the demonstrations, and of the same motions in reversed time.
    partitions : sequence of Groups
        Groups of demonstrations that are left out together to rank the kernels.

    Returns
    -------
    coefficients : array, shape (n_lengths, n_partitions, 2, n_demonstrations, n_outputs)
        A prediction is the sum of their products with the similarities of a request.
    residuals : array, shape (n_demonstrations, n_outputs)
        Outputs minus predictions from the other groups of the first partition.
    """
    parts = np.array([outputs + reversed_outputs, outputs - reversed_outputs]) / 2.0
    shares, residuals, scores = [], [], []
    # No correlation, then the same correlation with both signs.
    reversals = (0.0, -_FIT.time_reversal, _FIT.time_reversal)
    for (there, back), noise in product(np.stack(similarities, axis=2), _FIT.noises):
        gram = there + np.reshape(reversals, (-1, 1, 1)) * back
        inverses = np.linalg.inv(gram + noise * np.eye(len(outputs)))
        for i, reversal in enumerate(reversals):
            # Parts that are even in reversed time, then those that are odd.
            inverse = inverses[[i, -i]]
            solved = inverse @ parts
            shares.append([solved[0] + solved[1], reversal * (solved[0] - solved[1])])
            left = [_leave_out(inverse, solved, partition) for partition in partitions]
            residuals.append(left[0][0])
            scores.append([score for _, score in left])
    squares = outputs @ outputs.T
    # Effective number of independent outputs.
    freedom = np.trace(squares) ** 2 / (np.sum(squares**2) + _TINY)
    probabilities = np.exp(_FIT.temper * freedom * (np.array(scores) - np.max(scores, axis=0)))
    if len(outputs) < _FIT.min_ranked:
        probabilities[1:] = 0.0
    probabilities /= probabilities.sum(axis=0)
    weighted = probabilities[:, :, None, None, None] * np.array(shares)[:, None]
    first = range(0, len(scores), len(reversals) * len(_FIT.noises))
    return np.add.reduceat(weighted, first), np.tensordot(probabilities[:, 0], residuals, axes=1)


def _leave_out(inverse: FloatArray, solved: FloatArray, groups: Groups) -> tuple[FloatArray, float]:
    """Residuals of groups that are left out, and the logarithm of their density.

    Without refitting (Rasmussen and Williams, equations 5.10 to 5.12, for groups). The density is
    that of one output, with the variance that makes it highest, up to a constant.
    """
    residuals, variances = np.empty_like(solved), np.empty(solved.shape[:2])
    for group in groups:
        covariance = np.linalg.inv(inverse[:, group[..., None], group[:, None]])
        residuals[:, group] = covariance @ solved[:, group]
        variances[:, group] = np.diagonal(covariance, axis1=2, axis2=3)
    square = np.sum(residuals**2 / variances[:, :, None])
    score = -0.25 * np.sum(np.log(variances)) - 0.5 * solved.shape[1] * np.log(square + _TINY)
    return np.sum(residuals, axis=0), float(score)
