# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""In-span scores: how far requests are from the demonstrations of a primitive."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

UNUSUAL_IN_SPAN_SCORE = 3.0
"""In-span score above which a request is reported as unlike the demonstrations."""

# The prior of the covariance of requests counts as this many demonstrations.
_PRIOR_COUNT = 2.0


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
        A request, or all entries of one but the last.
    mean, precision :
        Of the requests of the demonstrations.
    """
    deviation = given - mean[: given.size]
    if given.size < len(mean):  # the inverse covariance of the first entries
        mixed = precision[-1:, :-1]
        precision = precision[:-1, :-1] - mixed.T * mixed / precision[-1:, -1:]
    return float(np.sqrt(deviation @ precision @ deviation / given.size))
