# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the demonstrations say about a request: weights, pace and duration to expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import PrimitiveFileError
from .regression import Kernel, Regression, choose_kernel

# Of more demonstrations, so many are asked, evenly spread: the time to choose a kernel grows
# with the cube of their number.
_MOST_ASKED = 300

# Expected durations stay within this many standard deviations of the demonstrated ones.
_MOST_DEVIATIONS = 3.0

# Deviation that a request may have even in a direction in which the demonstrations don't
# vary, 1 degree (or 17 mm, or 1.7 % of the duration): keeps the in-span score finite.
_FLOOR_DEVIATION = np.deg2rad(1.0)


@dataclass(frozen=True, eq=False)
class Conditional:
    """What is expected of a motion with given end points.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        Expected weights ŵ.
    covariance : array, shape (n_weights, n_weights)
        Their covariance Λ, positive definite.
    pace : array, shape (n_pace,)
        Expected pace, see :mod:`.pace`; zero: even.
    duration : float
        The duration asked for, or else the expected one [s].
    in_span_score : float
        How far outside the demonstrations the request lies: the Mahalanobis distance of its
        end points (and duration, if given), divided by the square root of their number;
        about 1 for a request like the demonstrations.
    """

    weights: FloatArray
    covariance: FloatArray
    pace: FloatArray
    duration: float
    in_span_score: float

    @property
    def precision(self) -> FloatArray:
        """Λ⁻¹, shape (n_weights, n_weights)."""
        return np.asarray(np.linalg.inv(self.covariance))


class RequestStatistics:
    """Requests (q0, qT, log T) that the demonstrations answer, and how they do.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of each.
    weights : array, shape (n_demonstrations, n_weights)
        Weights of each.
    common_weights : array, shape (n_weights,)
        Weights that come nearest to the mean shape: what is added to those of each to tell its
        shape from minimum-jerk rather than from the mean.
    paces : array, shape (n_demonstrations, n_pace)
        Pace of each.
    kernels : array, shape (3, 3)
        The :class:`.Kernel` of the regressions of the shape, the pace and the duration.

    Attributes
    ----------
    mean : array, shape (2 n_joints + 1,)
        Mean request.
    covariance : array, shape (2 n_joints + 1, 2 n_joints + 1)
        Covariance of the requests (zero for a single demonstration).
    """

    def __init__(
        self,
        requests: FloatArray,
        weights: FloatArray,
        common_weights: FloatArray,
        paces: FloatArray,
        kernels: FloatArray,
    ) -> None:
        kernels = frozen_array(kernels, (3, 3), "kernels", PrimitiveFileError)
        if np.any(kernels < 0.0) or np.any(kernels[:, 1] == 0.0):
            raise PrimitiveFileError(
                f"kernels must not be negative, and their noise positive: {kernels.tolist()}"
            )
        shape, pace, duration = (Kernel(*map(float, row)) for row in kernels)
        self.kernels = kernels
        self.mean = requests.mean(axis=0)
        centred = requests - self.mean
        self.covariance = centred.T @ centred / max(len(requests) - 1, 1)
        asked = asked_demonstrations(len(requests))
        self._shape = Regression(requests[asked], shape)
        self._pace = Regression(requests[asked], pace)
        self._duration = Regression(requests[asked, :-1], duration)
        self._log_durations = centred[asked, -1]
        self._weights = weights[asked] + common_weights
        self._common_weights = common_weights
        self._paces = paces[asked]
        self._weight_covariance = _covariance(self._shape.left_out(self._weights))

    def condition(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> Conditional:
        """Condition on a request.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            End points [rad or m].
        duration : float, optional
            Duration [s]; the expected one unless given.
        """
        ends = np.concatenate([start, goal])
        if duration is None:
            deviation = self._duration.shares(ends) @ self._log_durations
            # A request far away must not make a motion of hours out of a linear trend.
            reach = _MOST_DEVIATIONS * np.sqrt(self.covariance[-1, -1])
            expected = self.mean[-1] + np.clip(deviation, -reach, reach)
            score = self._score(ends)
            duration = float(np.exp(expected))
            request = np.append(ends, expected)
        else:
            request = np.append(ends, np.log(duration))
            score = self._score(request)
        weights = self._shape.shares(request) @ self._weights - self._common_weights
        pace = self._pace.shares(request) @ self._paces
        return Conditional(weights, self._weight_covariance, pace, duration, score)

    def request_precision(self, size: int) -> FloatArray:
        """Inverse of the covariance of the first entries of requests, as scores use it.

        Parameters
        ----------
        size : int
            Number of entries: 2 n_joints for the end points, one more for the duration, too.
        """
        variance = self.covariance[:size, :size] + _FLOOR_DEVIATION**2 * np.eye(size)
        return np.asarray(np.linalg.inv(variance))

    def _score(self, given: FloatArray) -> float:
        """Distance of the first entries of a request from the demonstrated ones."""
        deviation = given - self.mean[: given.size]
        variance = self.covariance[: given.size, : given.size]
        distance = deviation @ np.linalg.solve(
            variance + _FLOOR_DEVIATION**2 * np.eye(given.size), deviation
        )
        return float(np.sqrt(distance / given.size))


def choose_kernels(
    requests: FloatArray, shapes: FloatArray, aligned_phases: FloatArray
) -> FloatArray:
    """Choose the kernels by leave-one-out errors.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of each.
    shapes : array, shape (n_demonstrations, n_features)
        Shapes, such that distances between features are those between shapes.
    aligned_phases : array, shape (n_demonstrations, n_shares)
        Aligned phases at evenly spaced shares of the duration, less those shares.

    Returns
    -------
    kernels : array, shape (3, 3)
        As :class:`RequestStatistics` takes them.
    """
    asked = asked_demonstrations(len(requests))
    requests = requests[asked]
    log_durations = requests[:, -1:] - requests[:, -1].mean()
    return np.array(
        [
            choose_kernel(requests, shapes[asked]),
            choose_kernel(requests, aligned_phases[asked]),
            choose_kernel(requests[:, :-1], log_durations),
        ]
    )


def asked_demonstrations(n_demonstrations: int) -> list[int]:
    """Indices of those that are asked, evenly spread."""
    n = min(n_demonstrations, _MOST_ASKED)
    return [i * n_demonstrations // n for i in range(n)]


def _covariance(errors: FloatArray) -> FloatArray:
    """Covariance of errors about zero, shrunk to its diagonal the more the fewer there are."""
    n, size = errors.shape
    if size == 0:
        return np.zeros((0, 0))
    covariance = errors.T @ errors / n
    diagonal = np.diag(np.diag(covariance))
    shrunk = (n * covariance + size * diagonal) / (n + size)
    floor = 1e-6 * float(diagonal.max())
    return np.asarray(shrunk + max(floor, 1e-12) * np.eye(size))
