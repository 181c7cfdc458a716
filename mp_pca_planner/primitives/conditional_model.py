# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The conditional model: weights, time scaling and duration that are likely for a request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from .in_span import in_span_score, request_precision
from .moments import shrunk_covariance
from .pace import reversed_paces
from .regression import RequestFeatures, fit_coefficients, novelty

# More demonstrations are thinned out evenly: the time to fit grows with the cube of their number.
_MAX_DEMONSTRATIONS = 300

# Predicted durations stay within this many standard deviations of the demonstrated ones.
_MAX_DEVIATIONS = 3.0


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
        How far outside the demonstrations the request lies: the Mahalanobis distance of its
        end points (and duration, if given), divided by the square root of their number;
        about 1 for a request like the demonstrations.
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
    ranked by left-out motions and by left-out activities. The second fit counts for requests
    that are unlike all demonstrations.

    Attributes
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of the demonstrations that the model is fitted to.
    shape_coefficients : array, shape (n_fits, n_lengths, 2, n_demonstrations, n_weights)
        Of weights less the straight ones, see :func:`.fit_coefficients`.
    straight_weights : array, shape (n_weights,)
        Weights of a minimum-jerk motion, which is the prior mean.
    pace_coefficients : array, shape (n_fits, n_lengths, 2, n_demonstrations, n_pace)
        Of time scalings.
    duration_coefficients : array, shape (1, n_lengths, 2, n_demonstrations, 1)
        Of log T less its mean, by the end points alone.
    weight_covariance, weight_precision : array, shape (n_weights, n_weights)
        Covariance of what is left of the weights of left-out demonstrations, and its inverse.
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
        weights: FloatArray,
        reversed_weights: FloatArray,
        straight_weights: FloatArray,
        paces: FloatArray,
        labels: Sequence[str],
    ) -> ConditionalModel:
        """Fit a model to demonstrations.

        Parameters
        ----------
        requests, straight_weights :
            See the attributes.
        weights, reversed_weights : array, shape (n_demonstrations, n_weights)
            Weights of the demonstrations, and of the same motions in reversed time.
        paces : array, shape (n_demonstrations, n_pace)
            Their time scalings.
        labels : sequence of str
            Activity of each.
        """
        kept = slice(None, None, -(-len(requests) // _MAX_DEMONSTRATIONS))
        used, activities = requests[kept], np.asarray(labels)[kept]
        partitions = [list(np.arange(len(used))[:, None])]
        if np.any(activities != activities[0]):
            partitions.append([np.flatnonzero(activities == x) for x in np.unique(activities)])
        features, ends = RequestFeatures(used), RequestFeatures(used[:, :-1])
        roots = np.sqrt(features.distances(used))[:, None]
        there, back = ((x[kept] - straight_weights) / roots for x in (weights, reversed_weights))
        similar = [features.similarities(request) for request in used]
        shape, residuals = fit_coefficients(similar, there, back, partitions)
        pace, _ = fit_coefficients(similar, paces[kept], reversed_paces(paces[kept]), partitions)
        similar = [ends.similarities(request) for request in used[:, :-1]]
        times = used[:, -1:] - used[:, -1].mean() - np.log(roots)
        duration, _ = fit_coefficients(similar, times, times, partitions[:1])
        covariance = shrunk_covariance(residuals * roots)
        return cls(
            used,
            shape,
            straight_weights,
            pace,
            duration,
            covariance,
            np.asarray(np.linalg.inv(covariance)),
            request_precision(requests),
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
        ends = np.concatenate([start, goal])
        given = ends if duration is None else np.append(ends, np.log(duration))
        if duration is None:
            duration = self._expected_duration(ends)
        request = np.append(ends, np.log(duration))
        similar = self._features.similarities(request)
        shape, pace = (
            np.tensordot(similar, x[0] + novelty(similar) * (x[-1] - x[0]), axes=3)
            for x in (self.shape_coefficients, self.pace_coefficients)
        )
        return ConditionalDistribution(
            self.straight_weights + np.sqrt(self._features.distances(request)) * shape,
            self.weight_covariance,
            self.weight_precision,
            pace,
            duration,
            in_span_score(given, self.mean, self.request_precision),
        )

    @cached_property
    def mean(self) -> FloatArray:
        """Mean request, shape (2 n_joints + 1,)."""
        return np.asarray(self.requests.mean(axis=0))

    @cached_property
    def _features(self) -> RequestFeatures:
        return RequestFeatures(self.requests)

    def _expected_duration(self, ends: FloatArray) -> float:
        features = RequestFeatures(self.requests[:, :-1])
        similar = features.similarities(ends)
        residual = np.tensordot(similar, self.duration_coefficients[0], axes=3).item()
        deviation = residual + np.log(features.distances(ends)) / 2.0
        # A request far away must not make a motion of hours out of a trend.
        reach = _MAX_DEVIATIONS * self.requests[:, -1].std()
        return float(np.exp(self.mean[-1] + np.clip(deviation, -reach, reach)))
