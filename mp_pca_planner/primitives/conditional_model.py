# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The conditional model, which predicts weights, time scaling and duration for a request.

Gaussian-process regression on requests. A few demonstrations don't determine their smoothness and
noise. They don't determine, either, whether a return motion repeats the forward motion in reversed
time (waving) or mirrors it (circles). Predictions are averages over :data:`KERNELS`, weighted by
their density of left-out demonstrations: pseudo-Bayes factors (Gelfand and Dey, 1994; Rasmussen and
Williams, "Gaussian Processes for Machine Learning", 2006, sections 2.2 and 5.4.2). The prior mean
is the minimum-jerk motion.
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
from .pace import reversed_paces

LEAST_NOISE = 0.02
"""Least variance of the noise, in units of that of the outputs which depends on the request."""

OFFSET = 10.0
"""Variance of the common offset of all outputs, in the same units."""

INVERSE_LENGTHS = (1.0, 0.25)
"""Inverse lengths of the kernels in units of the spread of the requests; with the long one,
predictions are nearly linear."""

KERNELS = tuple(product(range(2), (0.0, 0.8, -0.8), (LEAST_NOISE, 0.2, 2.0, 200.0)))
"""Number of the length, time-reversal correlation and noise of each; the largest noise leaves the
prior mean."""

# Share of the mean squared distance from start to goal that is added to each squared distance.
_MIN_SQUARE = 0.09
# Power of the densities, below 1 because demonstrations are not independent.
_TEMPER = 0.7
# With fewer demonstrations, kernels are not ranked.
_MIN_RANKED = 3
# More demonstrations are thinned out, because the time to fit grows with the cube of their number.
_MAX_DEMONSTRATIONS = 200
# Predicted durations stay within this many standard deviations of the demonstrated ones.
_MAX_DEVIATIONS = 3.0
# The second fit counts alone where the novelty is at least the inverse of this.
_FAR = 4.0
# Growth of the standard deviation of motions from a demonstrated request to one far from all.
_GROWTH = 5.0
# The prior of the covariance of requests counts as this many demonstrations.
_PRIOR_COUNT = 2.0
_TINY = 1e-300

Groups = Sequence[NDArray[np.intp]]
"""Indices of demonstrations that are left out together, in arrays of groups of one size."""


@dataclass(frozen=True, eq=False)
class ConditionalDistribution:
    """The distribution of motions for a request.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        Expected weights ŵ.
    covariance : array, shape (n_weights, n_weights)
        Covariance Λ of the errors of left-out demonstrations, positive definite; the same for all
        requests.
    precision : array, shape (n_weights, n_weights)
        Λ⁻¹.
    variance : float
        Factor of Λ for the errors to expect at this request. It grows with the size of the motion
        and with the distance from the demonstrations; more so, the fewer there are.
    pace : array, shape (n_pace,)
        Expected time scaling, see :mod:`.pace`; zero: even.
    duration : float
        The duration of the request, or else the expected one [s].
    in_span_score : float
        Distance of the request from the demonstrations: the Mahalanobis distance of its end points
        (and duration, if given), divided by the square root of their number; about 1 for a request
        like the demonstrations, whatever their number.
    """

    weights: FloatArray
    covariance: FloatArray
    precision: FloatArray
    variance: float
    pace: FloatArray
    duration: float
    in_span_score: float


@dataclass(frozen=True, eq=False)
class ConditionalModel:
    """A fitted regression of motions on requests (q0, qT, log T).

    Shapes and durations grow with the square root of the distance from start to goal: small
    motions are straighter. Expected errors grow likewise, and with the distance from the
    demonstrations. Demonstrations of several activities are fitted twice, with kernels
    ranked by left-out motions and by left-out activities. The second fit is used for requests
    out of distribution.

    Attributes
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of the demonstrations that the model is fitted to.
    shape_coefficients : array, shape (n_fits, n_lengths, 2, n_demonstrations, n_weights)
        Of weights minus the straight ones: a prediction is the sum of their products with the
        similarities of the request to the demonstrations and to the reversed ones.
    straight_weights : array, shape (n_weights,)
        Weights of a minimum-jerk motion, which is the prior mean.
    pace_coefficients : array, shape (n_fits, n_lengths, 2, n_demonstrations, n_pace)
        Of time scalings.
    duration_coefficients : array, shape (1, n_lengths, 2, n_demonstrations, 1)
        Of log T minus its mean, by the end points alone.
    weight_covariance, weight_precision : array, shape (n_weights, n_weights)
        Covariance of the errors of the weights of left-out demonstrations, and its inverse.
    error_variance : array, shape (1,)
        Factor of this covariance for a demonstrated request of usual size, widened to the variance
        of Student's t distribution with as many degrees of freedom as demonstrations.
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
    error_variance: FloatArray
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
            Weights of the demonstrations minus the straight ones, and of the same motions in
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
        similar, distances = RequestFeatures(used).of(used)
        roots = np.sqrt(distances)[:, None]
        shape, residuals = _fit(similar, shapes / roots, reversed_shapes / roots, partitions)
        errors, others = residuals * roots, similar[0, 0].copy()
        if len(used) > 1:
            np.fill_diagonal(others, -np.inf)
        variance = _error_variance(errors, _variance(distances, others))
        pace, _ = _fit(similar, paces, reversed_paces(paces), partitions)
        similar, _ = RequestFeatures(used[:, :-1]).of(used[:, :-1])
        times = used[:, -1:] - used[:, -1].mean() - np.log(roots)
        duration, _ = _fit(similar, times, times, partitions[:1])
        covariances = *shrunk_covariance(errors), variance, request_precision(requests)
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
        similar, distance = self._features(np.append(ends, math.log(expected)))
        near, far = self._coefficients
        share = min(1.0, _FAR * float(_novelty(similar[0, 0])))
        both = similar.ravel() @ (near + share * far if far.any() else near)
        shape, pace = both[: self.straight_weights.size], both[self.straight_weights.size :]
        weights = self.straight_weights + math.sqrt(distance) * shape
        variance = float(self.error_variance[0] * _variance(distance, similar[0, 0]))
        of_weights = self.weight_covariance, self.weight_precision, variance
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
        near, far = (both[i].reshape(-1, both.shape[-1]) for i in (0, -1))
        return near, far - near

    @cached_property
    def _reach(self) -> float:
        """Largest deviation of the logarithm of an expected duration from the mean."""
        return float(_MAX_DEVIATIONS * self.requests[:, -1].std())

    def _expected_duration(self, ends: FloatArray) -> float:
        similar, distance = self._end_features(ends)
        residual = float(similar.ravel() @ self.duration_coefficients.ravel())
        # Bounded, because a distant request may extrapolate the trend to implausible durations.
        deviation = min(max(math.log(distance) / 2.0 + residual, -self._reach), self._reach)
        return math.exp(self.mean[-1] + deviation)


class RequestFeatures:
    """Similarities of requests with those of the demonstrations, and their sizes.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, n_entries)
        Start, goal, and at most one entry that is the same in both directions.
    """

    def __init__(self, requests: FloatArray) -> None:
        n = requests.shape[1] // 2
        self._swapped = np.r_[n : 2 * n, :n, 2 * n : requests.shape[1]]
        # For a spread or distance of zero, the unit has no effect.
        self._spread = float(np.sqrt(np.sum(requests.var(axis=0)))) or 1.0
        self._both_directions = np.array([requests, requests[:, self._swapped]])
        squares = self._squared_distance(requests)
        self._floor = _MIN_SQUARE * float(squares.mean()) or 1.0
        self._unit = float(np.exp(np.mean(np.log(squares + self._floor))))

    def __call__(self, request: FloatArray) -> tuple[FloatArray, float]:
        """Prior covariances with the demonstrations, and the distance from start to goal.

        The covariances are those of Matérn with smoothness 5/2 (Rasmussen and Williams, equation
        4.17) and a constant. Squared exponentials,
        which are smoother, overshoot between and beyond demonstrations.

        Parameters
        ----------
        request : array, shape (n_entries,)
            Any request.

        Returns
        -------
        similarities : array, shape (n_lengths, 2, n_demonstrations)
            By inverse length, with motions and with reversed ones.
        distance : float
            Bounded from below, in units of the geometric mean of all.
        """
        deviations = self._both_directions - request
        apart = np.sqrt(5.0 * np.einsum("dni,dni->dn", deviations, deviations)) / self._spread
        ratios = np.multiply.outer(INVERSE_LENGTHS, apart)
        square = (self._squared_distance(request) + self._floor) / self._unit
        return (1.0 + ratios + ratios**2 / 3.0) * np.exp(-ratios) + OFFSET, math.sqrt(square)

    def of(self, requests: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same of several requests, the axis of which is the last but one."""
        similar, distances = zip(*map(self, requests), strict=True)
        return np.stack(similar, axis=2), np.array(distances)

    def _squared_distance(self, requests: FloatArray) -> FloatArray:
        # Each joint counts twice, which only changes the unit.
        change = requests - requests[..., self._swapped]
        return np.asarray(np.einsum("...i,...i->...", change, change))


def thinned(requests: FloatArray) -> NDArray[np.intp]:
    """The demonstrations to fit, by index, whatever the order of all."""
    step = -(-len(requests) // _MAX_DEMONSTRATIONS)
    return np.lexsort(requests.T[::-1])[::step] if step > 1 else np.arange(len(requests))


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
    similar, distances = RequestFeatures(requests).of(requests)
    roots = np.sqrt(distances)[:, None]
    alone: Groups = [np.arange(len(requests))[:, None]]
    _, residuals = _fit(similar, shapes / roots, reversed_shapes / roots, [alone])
    return np.asarray(np.sum((residuals * roots) ** 2, axis=1))


def shrunk_covariance(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance of errors about zero, and its inverse, shape (n_features, n_features).

    It is positive definite, and shrunk towards its diagonal, more strongly with fewer errors.

    Parameters
    ----------
    errors : array, shape (n_samples, n_features)
        Any errors.
    """
    n, size = errors.shape
    covariance = errors.T @ errors / n
    variances = np.diag(covariance)
    floor = max(1e-6 * float(variances.max(initial=0.0)), 1e-12)
    shrunk = (n * covariance + size * np.diag(variances)) / (n + size)
    positive = np.asarray(shrunk + floor * np.eye(size))
    return positive, np.asarray(np.linalg.inv(positive))


def request_precision(
    requests: FloatArray, min_deviation: float = float(np.deg2rad(1.0))
) -> FloatArray:
    """Inverse covariance of a new request, given those of the demonstrations.

    The covariance is that of the demonstrations with a prior: two more requests that scatter as
    far, but equally in all directions. A few demonstrations leave most directions open. The
    uncertainty of the mean is added. So held-out requests have scores of about 1 whatever the
    number of demonstrations.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, n_entries)
        Starts, goals [rad or m] and logarithms of durations.
    min_deviation :
        Least standard deviation in any direction, 1 degree (or 17 mm, or 1.7 % of the duration):
        keeps the score finite where demonstrations don't vary.
    """
    n, size = requests.shape
    deviations = requests - requests.mean(axis=0)
    scatter = deviations.T @ deviations
    variance = np.trace(scatter) / (max(n - 1, 1) * size)
    shrunk = (scatter + _PRIOR_COUNT * variance * np.eye(size)) / (max(n - 1, 1) + _PRIOR_COUNT)
    return np.asarray(np.linalg.inv((1.0 + 1.0 / n) * shrunk + min_deviation**2 * np.eye(size)))


def marginal_precision(precision: FloatArray, size: int) -> FloatArray:
    """Inverse covariance of the first entries of requests.

    Parameters
    ----------
    precision : array, shape (..., n_entries, n_entries)
        Inverse covariance of requests.
    size : int
        n_entries, or one less.
    """
    if size == precision.shape[-1]:
        return precision
    mixed = precision[..., -1:, :-1]
    products = np.swapaxes(mixed, -1, -2) * mixed
    return np.asarray(precision[..., :-1, :-1] - products / precision[..., -1:, -1:])


def in_span_score(given: FloatArray, mean: FloatArray, precision: FloatArray) -> float:
    """Distance of a request from the demonstrations, the in-span score.

    It is the Mahalanobis distance divided by the square root of the number of entries.

    Parameters
    ----------
    given : array, shape (n_given,)
        A request, or the first entries of one.
    mean, precision :
        Of the requests of the demonstrations.
    """
    deviation = given - mean[: given.size]
    squared = deviation @ marginal_precision(precision, given.size) @ deviation
    return float(np.sqrt(squared / given.size))


def _novelty(similarities: FloatArray) -> FloatArray:
    """0 at a demonstrated request, 1 far from all, given similarities in the last axis."""
    return np.asarray(1.0 + OFFSET - similarities.max(axis=-1)).clip(0.0, 1.0)


def _variance(distances: FloatArray | float, similarities: FloatArray) -> FloatArray:
    """Variance of errors, in units of that at a demonstrated request of usual size."""
    return np.asarray(distances * (1.0 + _GROWTH * _novelty(similarities)) ** 2)


def _error_variance(errors: FloatArray, variances: FloatArray) -> FloatArray:
    """Factor of the covariance of left-out errors with which variances of 1 are as predicted.

    Shape (1,). Widened as Student's t distribution is, with at least three degrees of freedom.
    """
    squares, freedom = np.sum(errors**2, axis=1), max(len(errors), 3)
    unit = (np.sum(squares / variances) + _TINY) / (np.sum(squares) + _TINY)
    return np.array([freedom / (freedom - 2.0) * unit])


def _fit(
    similarities: FloatArray,
    outputs: FloatArray,
    reversed_outputs: FloatArray,
    partitions: Sequence[Groups],
) -> tuple[FloatArray, FloatArray]:
    """Fit averages of Gaussian processes, one for each partition.

    Parameters
    ----------
    similarities : array, shape (n_lengths, 2, n_demonstrations, n_demonstrations)
        Of the demonstrations with each other, and with the reversed ones.
    outputs, reversed_outputs : array, shape (n_demonstrations, n_outputs)
        Outputs of the demonstrations, and of the same motions in reversed time.
    partitions : sequence of Groups
        Groups of demonstrations that are left out together to rank the kernels.

    Returns
    -------
    coefficients : array, shape (n_partitions, n_lengths, 2, n_demonstrations, n_outputs)
        A prediction is the sum of their products with the similarities of a request.
    residuals : array, shape (n_demonstrations, n_outputs)
        Outputs minus predictions from the other groups of the first partition.
    """
    # Parts that are even in reversed time, then those that are odd.
    parts = np.array([outputs + reversed_outputs, outputs - reversed_outputs]) / 2.0
    shares, residuals, scores = [], [], []
    for length, reversal, noise in KERNELS:
        signs = reversal * np.array([1.0, -1.0])[:, None, None]
        gram = similarities[length, 0] + signs * similarities[length, 1]
        inverse = np.linalg.inv(gram + noise * np.eye(len(outputs)))
        solved = inverse @ parts
        shares.append([solved[0] + solved[1], reversal * (solved[0] - solved[1])])
        left = [_leave_out(inverse, solved, partition) for partition in partitions]
        residuals.append(left[0][0])
        scores.append([score for _, score in left])
    squares = outputs @ outputs.T
    # Effective number of independent outputs.
    freedom = np.trace(squares) ** 2 / (np.sum(squares**2) + _TINY)
    probabilities = np.exp(_TEMPER * freedom * (np.array(scores) - np.max(scores, axis=0)))
    if len(outputs) < _MIN_RANKED:
        probabilities[1:] = 0.0
    probabilities /= probabilities.sum(axis=0)
    of_lengths = np.eye(len(INVERSE_LENGTHS))[[length for length, *_ in KERNELS]]
    coefficients = np.einsum("kp,kl,kdno->pldno", probabilities, of_lengths, shares)
    return coefficients, np.tensordot(probabilities[:, 0], residuals, axes=1)


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
