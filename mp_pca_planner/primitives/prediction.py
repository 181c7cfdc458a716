# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of weights, time scaling and duration for a request.

Gaussian-process regression on requests (Rasmussen and Williams, "Gaussian Processes for Machine
Learning", 2006, section 2.2). The prior mean is the minimum-jerk motion. A few demonstrations don't
determine how smooth and how noisy motions are, nor whether a return motion repeats the forward one
in reversed time (waving) or mirrors it (circles). So predictions are averages over :data:`KERNELS`,
weighted by their density of left-out demonstrations (section 5.4.2): pseudo-Bayes factors (Gelfand
and Dey, 1994). Read :func:`_fit`, then :meth:`ConditionalModel.fit`, then `predict`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .in_span import in_span_score

LENGTHS = (0.4, 1.2)
"""Distances over which motions resemble each other, in units of the spread of the requests."""

KERNELS = tuple(product((0.8, -0.8), (0.02, 0.2, 2.0, 200.0), range(len(LENGTHS))))
"""Correlation with motions in reversed time, noise, and index of the length of each kernel; the
largest noise leaves the prior mean."""

OFFSET = 10.0
"""Variance of what motions of all requests have in common, in units of what depends on them."""

GROWTHS = (0.5, 0.25, 0.0)
"""Exponents by which durations may grow with the distance; the data decide between them."""

FREEDOM = 6.0
"""Degrees of freedom of the errors. They follow Student's t distribution, because some motions are
harder to predict than others. With 6, intervals hold the predicted shares of left-out motions."""

# Share of the mean squared distance from start to goal that is added to each squared distance.
_MIN_SQUARE = 0.09
# Predicted durations stay within this many standard deviations of the demonstrated ones.
_MAX_DEVIATIONS = 3.0
# So many more demonstrations, of the mean duration, are imagined.
_PRIOR_COUNT = 2.0
# With fewer demonstrations, only the first kernel counts.
_MIN_RANKED = 3
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

    Shapes and their errors grow with the square root of the distance from start to goal: small
    motions are straighter.

    Attributes
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of the demonstrations that the model is fitted to.
    shape_coefficients : array, shape (n_lengths, 2, n_demonstrations, n_weights)
        Of weights minus the straight ones: a prediction is the sum of their products with the
        similarities of the request to the demonstrations and to the reversed ones.
    straight_weights : array, shape (n_weights,)
        Weights of a minimum-jerk motion, which is the prior mean.
    pace_coefficients : array, shape (n_lengths, 2, n_demonstrations, n_pace)
        Of time scalings.
    duration_coefficients : array, shape (n_lengths, 2, n_demonstrations, 1)
        Of log T minus its mean and its growth, by the end points alone.
    duration_growth : array, shape (1,)
        Exponent by which durations grow with the distance.
    weight_covariance : array, shape (n_weights, n_weights)
        Covariance of the errors of the weights of left-out demonstrations.
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
    duration_growth: FloatArray
    weight_covariance: FloatArray
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
        paces : array, shape (n_demonstrations, n_pace)
            Their time scalings.
        precision : array, shape (2 n_joints + 1, 2 n_joints + 1)
            See :func:`.request_precision`; of all demonstrations, if only some are fitted.
        """
        similar, distances = _Features(requests)(requests)
        of_ends, _ = _Features(requests[:, :-1])(requests[:, :-1])
        roots, log_times = np.sqrt(distances)[:, None], requests[:, -1:]
        shape, residuals, _ = _fit(similar, shapes[None] / roots)
        reversed_paces = -paces * (-1.0) ** np.arange(paces.shape[1])
        pace, _, _ = _fit(similar, np.array([[paces, reversed_paces]]))
        # The same motion in reversed time takes as long.
        growths = np.array(GROWTHS)[:, None, None] * np.log(distances)[:, None]
        times = log_times - log_times.mean() - growths
        duration, _, shares = _fit(of_ends, np.stack([times, times], axis=1))
        confidence = len(requests) / (len(requests) + _PRIOR_COUNT)
        # As similar as the nearest of the other demonstrations.
        others = np.where(np.eye(len(requests), dtype=bool)[:, None, None], 0.0, similar)
        covariance, factor = _error_model(residuals * roots, _variance(others, distances))
        return cls(
            requests=requests,
            shape_coefficients=shape,
            straight_weights=straight_weights,
            pace_coefficients=pace,
            duration_coefficients=confidence * duration,
            duration_growth=np.array([confidence * shares @ GROWTHS]),
            weight_covariance=covariance,
            error_variance=np.array([factor]),
            request_precision=precision,
        )

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
        of_requests, of_ends, precision = self._prepared
        ends, score = np.concatenate([start, goal]), self.in_span_score(start, goal, duration)
        if duration is None:
            similar, distance = of_ends(ends)
            deviation = float(similar.ravel() @ self.duration_coefficients.ravel())
            deviation += float(self.duration_growth[0]) * math.log(distance)
            # Bounded, because a distant request may extrapolate the trend to implausible durations.
            reach = float(_MAX_DEVIATIONS * self.requests[:, -1].std())
            duration = math.exp(self.mean[-1] + min(max(deviation, -reach), reach))
        similar, distance = of_requests(np.append(ends, math.log(duration)))
        shape = np.tensordot(similar, self.shape_coefficients, 3)
        return ConditionalDistribution(
            weights=self.straight_weights + math.sqrt(distance) * shape,
            covariance=self.weight_covariance,
            precision=precision,
            variance=float(self.error_variance[0] * _variance(similar, distance)),
            pace=np.tensordot(similar, self.pace_coefficients, 3),
            duration=duration,
            in_span_score=score,
        )

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
    def _prepared(self) -> tuple[_Features, _Features, FloatArray]:
        """Features of requests and of their ends, and the precision of the weights."""
        precision = np.asarray(np.linalg.inv(self.weight_covariance))
        precision.flags.writeable = False
        return _Features(self.requests), _Features(self.requests[:, :-1]), precision


class _Features:
    """Similarities of requests with those of demonstrations, and their sizes.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, n_entries)
        Start, goal, and at most one entry that is the same in both directions.
    """

    def __init__(self, requests: FloatArray) -> None:
        n = requests.shape[1] // 2
        self._swapped = np.r_[n : 2 * n, :n, 2 * n : requests.shape[1]]
        self._both_directions = np.array([requests, requests[:, self._swapped]])
        # For a spread or distance of zero, the unit has no effect.
        spread = float(np.sqrt(np.sum(requests.var(axis=0)))) or 1.0
        self._lengths = spread * np.array(LENGTHS)[:, None]
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
        similarities : array, shape (..., n_lengths, 2, n_demonstrations)
            With motions and with reversed ones.
        distances : array, shape (...)
            Bounded from below, in units of the geometric mean of all.
        """
        deviations = self._both_directions - requests[..., None, None, :]
        ratios = math.sqrt(5.0) * np.linalg.norm(deviations, axis=-1)[..., None, :, :]
        ratios = ratios / self._lengths[..., None]
        similar = (1.0 + ratios + ratios**2 / 3.0) * np.exp(-ratios) + OFFSET
        squares = np.sum((requests - requests[..., self._swapped]) ** 2, axis=-1)
        return similar, np.sqrt((squares + self._floor) / self._unit)


def _fit(
    similarities: FloatArray, candidates: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Average Gaussian processes of all kernels and candidates by the density of what is left out.

    Parameters
    ----------
    similarities : array, shape (n_demonstrations, n_lengths, 2, n_demonstrations)
        Of the demonstrations with each other, and with the reversed ones.
    candidates : array, shape (n_candidates, 2, n_demonstrations, n_outputs)
        Outputs of the demonstrations, and of the same motions in reversed time.

    Returns
    -------
    coefficients : array, shape (n_lengths, 2, n_demonstrations, n_outputs)
        A prediction is the sum of their products with the similarities of a request.
    residuals : array, shape (n_demonstrations, n_outputs)
        Outputs minus their predictions from the other demonstrations.
    shares : array, shape (n_candidates,)
        How much each candidate counts.
    """
    n, n_candidates = len(similarities), len(candidates)
    coefficients, residuals, scores = [], [], []
    for reversal, noise, length in KERNELS:
        there, back = similarities[:, length, 0], reversal * similarities[:, length, 1]
        # The parts that are even and odd in reversed time are independent.
        even, odd = np.linalg.inv([there + back, there - back] + noise * np.eye(n))
        variances = 1.0 / np.array([np.diag(even), np.diag(odd)])[..., None]
        for outputs, twins in candidates:
            of_even, of_odd = even @ (outputs + twins) / 2.0, odd @ (outputs - twins) / 2.0
            # Residuals of what is left out (equations 5.10 to 5.12), and the logarithm of the
            # density of one output, with the scale that makes it highest.
            left_out = variances * [of_even, of_odd]
            square = np.sum(left_out**2 / variances)
            scores.append(-0.25 * np.sum(np.log(variances)) - 0.5 * n * np.log(square + _TINY))
            residuals.append(left_out[0] + left_out[1])
            both = np.zeros((len(LENGTHS), 2, *outputs.shape))
            both[length] = of_even + of_odd, reversal * (of_even - of_odd)
            coefficients.append(both)
    # The outputs depend on each other: their effective number.
    squares = outputs @ outputs.T
    freedom = np.trace(squares) ** 2 / (np.sum(squares**2) + _TINY)
    probabilities = np.exp(freedom * (np.array(scores) - max(scores)))
    if n < _MIN_RANKED:
        probabilities[1:] = 0.0
    probabilities /= probabilities.sum()
    shares = probabilities.reshape(-1, n_candidates).sum(axis=0)
    average = np.tensordot(probabilities, coefficients, 1)
    return average, np.tensordot(probabilities, residuals, 1), shares


def _variance(similarities: FloatArray, distances: FloatArray) -> FloatArray:
    """Variance of errors, in units of that at a demonstrated request of usual size.

    Parameters
    ----------
    similarities : array, shape (..., n_lengths, 2, n_demonstrations)
        See :class:`_Features`.
    distances : array, shape (...)
        Of the same requests.
    """
    # 0 at a demonstrated request, 1 far from all.
    novelties = (1.0 + OFFSET - similarities[..., -1, 0, :].max(axis=-1)).clip(0.0, 1.0)
    return np.asarray(distances * (1.0 + _GROWTH * novelties) ** 2)


def _error_model(errors: FloatArray, variances: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of errors, and the factor by which their variances are `variances` times that.

    Parameters
    ----------
    errors : array, shape (n_demonstrations, n_weights)
        Of left-out demonstrations.
    variances : array, shape (n_demonstrations,)
        Their relative variances, see :func:`_variance`.
    """
    # About zero, shrunk towards its diagonal, more strongly with fewer errors.
    n, size = errors.shape
    covariance = errors.T @ errors / n
    diagonal = np.diag(covariance)
    floor = max(1e-6 * float(diagonal.max(initial=0.0)), 1e-12)
    shrunk = (n * covariance + size * np.diag(diagonal)) / (n + size)
    # Widened as Student's t distribution.
    squares, freedom = np.sum(errors**2, axis=1), max(n, 3)
    ratio = (np.sum(squares / variances) + _TINY) / (np.sum(squares) + _TINY)
    return shrunk + floor * np.eye(size), freedom / (freedom - 2.0) * float(ratio)


def left_out_errors(
    requests: FloatArray, shapes: FloatArray, remainders: FloatArray, n_values: int
) -> tuple[float | None, float]:
    """RMS errors of motions that are left out [rad or m].

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T. The time grows with the cube of their number.
    shapes : array, shape (2, n_demonstrations, n_functions)
        Coefficients of the shapes, and of the same motions in reversed time.
    remainders : array, shape (n_demonstrations,)
        Sums of squares of the residuals of the coefficients.
    n_values : int
        Number of values of a shape.

    Returns
    -------
    of_prediction : float or None
        From their prediction by the other demonstrations; None for a single motion.
    of_straight : float
        From the minimum-jerk motion between their ends.
    """
    straight = np.sum(shapes[0] ** 2, axis=1)
    of_straight = float(np.sqrt((straight + remainders).mean() / n_values))
    if len(requests) == 1:
        return None, of_straight
    similar, distances = _Features(requests)(requests)
    roots = np.sqrt(distances)[:, None]
    _, residuals, _ = _fit(similar, shapes[None] / roots)
    squares = np.sum((residuals * roots) ** 2, axis=1)
    return float(np.sqrt((squares + remainders).mean() / n_values)), of_straight
