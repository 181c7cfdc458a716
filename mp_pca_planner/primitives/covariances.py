# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Covariances of errors and of requests, and the in-span score."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


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
    """Inverse covariance of requests of shape (n_demonstrations, n_entries).

    Parameters
    ----------
    requests :
        Starts, goals [rad or m] and logarithms of durations.
    min_deviation :
        Least standard deviation in any direction, 1 degree (or 17 mm, or 1.7 % of the duration):
        keeps the score finite where demonstrations don't vary.
    """
    deviations = requests - requests.mean(axis=0)
    scatter = deviations.T @ deviations / max(len(requests) - 1, 1)
    return np.asarray(np.linalg.inv(scatter + min_deviation**2 * np.eye(len(scatter))))


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
