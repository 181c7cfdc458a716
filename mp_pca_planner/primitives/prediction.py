# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of weights, time scaling and duration for a request.

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
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .in_span import in_span_score

OFFSET = 10.0
"""Variance of the common offset of all outputs, in units of the variance of outputs that depends
on the request."""

FREEDOM = 6.0
"""Degrees of freedom of the errors. They follow Student's t distribution, because some motions are
harder to predict than others. With 6, intervals hold the predicted shares of left-out motions."""

KERNELS = tuple(product((0.8, -0.8), (0.02, 0.2, 2.0, 200.0)))
"""Time-reversal correlation and noise of each; the largest noise leaves the prior mean."""

# Share of the mean squared distance from start to goal that is added to each squared distance.
_MIN_SQUARE = 0.09
# Power of the densities, below 1 because demonstrations are not independent.
_TEMPER = 0.7
# With fewer demonstrations, kernels are not ranked.
_MIN_RANKED = 3
# Predicted durations stay within this many standard deviations of the demonstrated ones.
_MAX_DEVIATIONS = 3.0
# The second fit counts alone where the novelty is at least the inverse of this.
_FAR = 4.0
# Growth of the standard deviation of motions from a demonstrated request to one far from all.
_GROWTH = 5.0
_TINY = 1e-300


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
        and with the distance from the demonstrations; more so, the fewer there are. With this
        covariance, errors follow Student's t distribution of `FREEDOM`.
    pace : array, shape (n_pace,)
        Expected time scaling, see :mod:`.timing`; zero: even.
    duration : float
        The duration of the request, or else the expected one [s].
    in_span_score : float
        Distance of the request from the demonstrations, see :func:`.in_span_score`; about 1 for a
        request like the demonstrations, whatever their number.
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
    shape_coefficients : array, shape (n_fits, 2, n_demonstrations, n_weights)
        Of weights minus the straight ones: a prediction is the sum of their products with the
        similarities of the request to the demonstrations and to the reversed ones.
    straight_weights : array, shape (n_weights,)
        Weights of a minimum-jerk motion, which is the prior mean.
    pace_coefficients : array, shape (n_fits, 2, n_demonstrations, n_pace)
        Of time scalings.
    duration_coefficients : array, shape (1, 2, n_demonstrations, 1)
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

    def __repr__(self) -> str:
        n, n_joints = len(self.requests), self.requests.shape[1] // 2
        return f"ConditionalModel of {n} demonstrations, {n_joints} joints"

    @classmethod
    def fit(
        cls,
        requests: FloatArray,
        shapes: FloatArray,
        straight_weights: FloatArray,
        paces: FloatArray,
        labels: Sequence[str],
        precision: FloatArray,
    ) -> Self:
        """Fit a model to demonstrations.

        Parameters
        ----------
        requests, straight_weights :
            See the attributes; the time grows with the cube of the number of requests.
        shapes : array, shape (2, n_demonstrations, n_weights)
            Weights of the demonstrations minus the straight ones, and of the same motions in
            reversed time.
        paces : array, shape (2, n_demonstrations, n_pace)
            Their time scalings, and those of the reversed motions.
        labels : sequence of str
            Activity of each.
        precision : array, shape (2 n_joints + 1, 2 n_joints + 1)
            See :func:`.request_precision`; of all demonstrations, if only some are fitted.
        """
        similar, distances = RequestFeatures(requests)(requests)
        roots = np.sqrt(distances)[:, None]
        shape, residuals = _fit(similar, shapes / roots, labels)
        pace, _ = _fit(similar, paces, labels)
        of_ends, _ = RequestFeatures(requests[:, :-1])(requests[:, :-1])
        times = requests[:, -1:] - requests[:, -1].mean() - np.log(roots)
        duration, _ = _fit(of_ends, np.array([times, times]))
        # Covariance about zero, shrunk towards its diagonal, more strongly with fewer errors.
        errors = residuals * roots
        n, size = errors.shape
        covariance = errors.T @ errors / n
        diagonal = np.diag(covariance)
        floor = max(1e-6 * float(diagonal.max(initial=0.0)), 1e-12)
        shrunk = (n * covariance + size * np.diag(diagonal)) / (n + size)
        positive = np.asarray(shrunk + floor * np.eye(size))
        # Its factor, by which variances of 1 are as predicted, widened as Student's t distribution.
        squares, freedom = np.sum(errors**2, axis=1), max(n, 3)
        variances = _variance(distances, _novelty(similar, is_left_out=True))
        unit = np.sum(squares / variances) + _TINY
        factor = np.array([freedom / (freedom - 2.0) * unit / (np.sum(squares) + _TINY)])
        of_weights = positive, np.asarray(np.linalg.inv(positive)), factor
        return cls(requests, shape, straight_weights, pace, duration, *of_weights, precision)

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
        of_requests, of_ends, coefficients = self._prepared
        if duration is None:
            similar, distance = of_ends(ends)
            residual = float(similar.ravel() @ self.duration_coefficients.ravel())
            # Bounded, because a distant request may extrapolate the trend to implausible durations.
            reach = float(_MAX_DEVIATIONS * self.requests[:, -1].std())
            deviation = min(max(math.log(distance) / 2.0 + residual, -reach), reach)
            duration = math.exp(self.mean[-1] + deviation)
        similar, distance = of_requests(np.append(ends, math.log(duration)))
        novelty = _novelty(similar)
        both = _mixed(similar.ravel() @ coefficients, novelty)
        shape, pace = np.split(both, [self.straight_weights.size])
        weights = self.straight_weights + math.sqrt(distance) * shape
        variance = float(self.error_variance[0] * _variance(distance, novelty))
        of_weights = self.weight_covariance, self.weight_precision, variance
        return ConditionalDistribution(weights, *of_weights, pace, duration, score)

    def in_span_score(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> float:
        """Distance of a request from the demonstrations, see :class:`ConditionalDistribution`."""
        request = np.concatenate([start, goal, [] if duration is None else [math.log(duration)]])
        return in_span_score(request, self.mean, self.request_precision)

    def turned(
        self, start: FloatArray, goal: FloatArray, continuous: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """End points by full turns of continuous joints, with the start near the demonstrated ones.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            End points [rad or m].
        continuous : array of bool, shape (n_joints,)
            Which joints are continuous.
        """
        turns = np.round((self.mean[: start.size] - start) / math.tau)
        shift = np.where(continuous, math.tau * turns, 0.0)
        return start + shift, goal + shift

    @cached_property
    def mean(self) -> FloatArray:
        """Mean request, shape (2 n_joints + 1,)."""
        return np.asarray(self.requests.mean(axis=0))

    @cached_property
    def _prepared(self) -> tuple[RequestFeatures, RequestFeatures, FloatArray]:
        """Features of requests and of their ends, and coefficients of shapes and time scalings.

        The shape of the coefficients is (n_fits, n_similarities, n_weights + n_pace).
        """
        both = np.concatenate([self.shape_coefficients, self.pace_coefficients], axis=-1)
        features = RequestFeatures(self.requests), RequestFeatures(self.requests[:, :-1])
        return *features, both.reshape(len(both), -1, both.shape[-1])


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
        squares = np.sum((requests - requests[:, self._swapped]) ** 2, axis=1)
        self._floor = _MIN_SQUARE * float(squares.mean()) or 1.0
        self._unit = float(np.exp(np.mean(np.log(squares + self._floor))))

    def __call__(self, requests: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Prior covariances with the demonstrations, and the distances from start to goal.

        The covariances are those of Matérn with smoothness 5/2 (Rasmussen and Williams, equation
        4.17) and a constant. Squared exponentials, which are smoother, overshoot between and beyond
        demonstrations.

        Parameters
        ----------
        requests : array, shape (..., n_entries)
            Any request, or several.

        Returns
        -------
        similarities : array, shape (2, ..., n_demonstrations)
            With motions and with reversed ones.
        distances : array, shape (...)
            Bounded from below, in units of the geometric mean of all.
        """
        change = requests - requests[..., self._swapped]
        squares = np.einsum("...i,...i->...", change, change)
        several = np.expand_dims(self._both_directions, tuple(range(1, requests.ndim)))
        deviations = several - requests[..., None, :]
        ratios = np.sqrt(5.0 * np.einsum("...i,...i->...", deviations, deviations)) / self._spread
        similar = (1.0 + ratios + ratios**2 / 3.0) * np.exp(-ratios) + OFFSET
        return similar, np.sqrt((squares + self._floor) / self._unit)


def left_out_squares(
    requests: FloatArray, shapes: FloatArray, labels: Sequence[str] = ()
) -> FloatArray:
    """Squared errors of shapes, each predicted from the other demonstrations.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T. The time grows with the cube of their number.
    shapes : array, shape (2, n_demonstrations, n_functions)
        Coefficients of the shapes, and of the same motions in reversed time.
    labels : sequence of str, optional
        Activity of each demonstration; the same by default.

    Returns
    -------
    squares : array, shape (n_demonstrations,)
        Sums of squares over the coefficients.
    """
    similar, distances = RequestFeatures(requests)(requests)
    roots = np.sqrt(distances)[:, None]
    _, residuals = _fit(similar, shapes / roots, labels)
    return np.asarray(np.sum((residuals * roots) ** 2, axis=1))


def _novelty(similarities: FloatArray, *, is_left_out: bool = False) -> FloatArray:
    """0 at a demonstrated request, 1 far from all.

    Parameters
    ----------
    similarities : array, shape (2, ..., n_demonstrations)
        See :class:`RequestFeatures`.
    is_left_out : bool
        Whether these are the demonstrations, each of which is compared with the others.
    """
    nearest = similarities[0]
    if is_left_out and len(nearest) > 1:
        nearest = np.where(np.eye(len(nearest), dtype=bool), -np.inf, nearest)
    return np.asarray(1.0 + OFFSET - nearest.max(axis=-1)).clip(0.0, 1.0)


def _mixed(fits: FloatArray, novelties: FloatArray) -> FloatArray:
    """Mix the values of all fits: the second one counts where requests are new.

    Parameters
    ----------
    fits : array, shape (n_fits, ..., n_outputs)
        Values of each fit, for a request or several.
    novelties : array, shape (...)
        Of the requests.
    """
    share = np.minimum(1.0, _FAR * novelties)[..., None]
    return np.asarray(fits[0] + share * (fits[-1] - fits[0]))


def _variance(distances: FloatArray | float, novelties: FloatArray) -> FloatArray:
    """Variance of errors, in units of that at a demonstrated request of usual size."""
    return np.asarray(distances * (1.0 + _GROWTH * novelties) ** 2)


def _fit(
    similarities: FloatArray, outputs: FloatArray, labels: Sequence[str] = ()
) -> tuple[FloatArray, FloatArray]:
    """Fit averages of Gaussian processes, with kernels ranked by what is left out.

    Left out are single demonstrations and, in a second fit of several activities, those of each
    activity, without refitting (Rasmussen and Williams, equations 5.10 to 5.12, for groups).

    Parameters
    ----------
    similarities : array, shape (2, n_demonstrations, n_demonstrations)
        Of the demonstrations with each other, and with the reversed ones.
    outputs : array, shape (2, n_demonstrations, n_outputs)
        Outputs of the demonstrations, and of the same motions in reversed time.
    labels : sequence of str
        Activity of each demonstration; one activity by default.

    Returns
    -------
    coefficients : array, shape (n_fits, 2, n_demonstrations, n_outputs)
        A prediction is the sum of their products with the similarities of a request.
    residuals : array, shape (n_demonstrations, n_outputs)
        Outputs minus their predictions from the other demonstrations.
    """
    # Parts that are even in reversed time, then those that are odd.
    parts = np.array([outputs[0] + outputs[1], outputs[0] - outputs[1]]) / 2.0
    reversals, noises = np.array(KERNELS).T[:, :, None, None]
    there, back = similarities
    signs = reversals[..., None] * np.array([1.0, -1.0])[:, None, None]
    inverse = np.linalg.inv(there + signs * back + noises[..., None] * np.eye(len(there)))
    solved = inverse @ parts
    shares = np.array([solved[:, 0] + solved[:, 1], reversals * (solved[:, 0] - solved[:, 1])])
    # Indices of demonstrations that are left out together, in arrays of groups of one size.
    activities, names = np.asarray(labels), np.unique(labels)
    partitions = [[np.arange(len(there))[:, None]]]
    if len(names) > 1:
        partitions.append([np.argwhere(activities == name).T for name in names])
    left, logs = np.empty((len(partitions), *solved.shape)), []
    for residuals, groups in zip(left, partitions, strict=True):
        variances = np.empty(solved.shape[:3])
        for group in groups:
            covariance = np.linalg.inv(inverse[:, :, group[..., None], group[:, None]])
            residuals[:, :, group] = covariance @ solved[:, :, group]
            variances[:, :, group] = np.diagonal(covariance, axis1=3, axis2=4)
        # Of the density of one output, with the variance that makes it highest.
        square = np.sum(residuals**2 / variances[..., None], axis=(1, 2, 3))
        log_square = solved.shape[2] * np.log(square + _TINY)
        logs.append(-0.5 * (0.5 * np.sum(np.log(variances), axis=(1, 2)) + log_square))
    squares, scores = outputs[0] @ outputs[0].T, np.array(logs)
    # Effective number of independent outputs.
    freedom = np.trace(squares) ** 2 / (np.sum(squares**2) + _TINY)
    probabilities = np.exp(_TEMPER * freedom * (scores - scores.max(axis=1, keepdims=True)))
    if len(squares) < _MIN_RANKED:
        probabilities[:, 1:] = 0.0
    probabilities /= probabilities.sum(axis=1, keepdims=True)
    coefficients = np.einsum("pk,dkno->pdno", probabilities, shares)
    fits = np.tensordot(probabilities, np.sum(left[0], axis=1), axes=1)
    return coefficients, _mixed(fits, _novelty(similarities, is_left_out=True))
