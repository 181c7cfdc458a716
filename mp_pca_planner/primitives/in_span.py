# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""In-span scores: how far requests are from the demonstrations of one primitive, or of many."""

from __future__ import annotations

from math import tau

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

UNUSUAL_IN_SPAN_SCORE = 3.0
"""In-span score above which a request is reported as unlike the demonstrations."""

# The prior of the covariance of requests counts as this many demonstrations.
_PRIOR_COUNT = 2.0

Indices = NDArray[np.intp]


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
    squared = deviation @ _marginal(precision, given.size) @ deviation
    return float(np.sqrt(squared / given.size))


def _marginal(precision: FloatArray, size: int) -> FloatArray:
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


class RequestIndex:
    """In-span scores of requests for many primitives.

    Parameters
    ----------
    means : array, shape (n_primitives, 2 n_joints + 1)
        Mean requests of the primitives: start, goal and the logarithm of the duration.
    precisions : array, shape (n_primitives, 2 n_joints + 1, 2 n_joints + 1)
        Inverse covariances of their requests.
    continuous : array of bool, shape (n_joints,)
        Joints whose demonstrations may be full turns away from the request.
    """

    def __init__(
        self, means: FloatArray, precisions: FloatArray, continuous: NDArray[np.bool_]
    ) -> None:
        self._means, self._continuous = means, continuous
        sizes = means.shape[1] - 1, means.shape[1]
        self._precisions = {size: _marginal(precisions, size) for size in sizes}

    def scores(self, request: FloatArray) -> FloatArray:
        """In-span scores of a request, shape (n_primitives,).

        Parameters
        ----------
        request : array, shape (2 n_joints,) or (2 n_joints + 1,)
            Start and goal [rad or m], and the logarithm of the duration if one is requested.
        """
        n, size = self._continuous.size, request.size
        deviations = request - self._means[:, :size]
        turns = np.round((self._means[:, :n] - request[:n]) / tau)
        deviations[:, : 2 * n] += np.tile(np.where(self._continuous, tau * turns, 0.0), 2)
        products = deviations[:, None] @ self._precisions[size]
        squares = np.einsum("pi,pi->p", products[:, 0], deviations)
        return np.asarray(np.sqrt(squares / size))

    def nearest(self, request: FloatArray, n: int) -> tuple[Indices, FloatArray]:
        """The primitives with the least in-span scores.

        Parameters
        ----------
        request : array, shape (2 n_joints,) or (2 n_joints + 1,)
            See :meth:`scores`.
        n : int
            Their largest number.

        Returns
        -------
        indices : array of int, shape (n_found,)
            Indices of the primitives, the nearest first.
        scores : array, shape (n_found,)
            Their scores.
        """
        scores = self.scores(request)
        nearest = np.argsort(scores, kind="stable")[:n]
        return nearest, scores[nearest]
