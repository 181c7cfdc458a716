# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mean and covariance of vectors, as statistics that can be merged.

What a part of the vectors tells is kept in a size that doesn't depend on how many there are, so
that parts are looked at one by one, in whatever process, and merged: the pairwise update of Chan,
Golub and LeVeque, The American Statistician 37(3), 1983, eq. (2.1). The scatter matrix S = FᵀF is
kept as its factor F, as in square-root filters: S would lose half of the digits of the small
variances, and few vectors have a small factor.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from ..arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Moments:
    """Count, mean and scatter of vectors.

    Attributes
    ----------
    count : int
        How many vectors, at least one.
    mean : array, shape (n_features,)
        Their mean.
    factor : array, shape (n_rows, n_features)
        F, with FᵀF = Σ (x − mean)(x − mean)ᵀ; at most 2 n_features rows.
    """

    count: int
    mean: FloatArray
    factor: FloatArray

    @classmethod
    def of(cls, samples: FloatArray) -> Moments:
        """Take the moments of samples of shape (n_samples, n_features), at least one."""
        mean = samples.mean(axis=0)
        # One vector has no scatter, so there is nothing to send to another process.
        factor = samples - mean if len(samples) > 1 else np.zeros((0, mean.size))
        return cls(len(samples), mean, _short(factor))

    @classmethod
    def merged(cls, parts: Iterable[Moments]) -> Moments:
        """Merge parts, at least one, in their order: the same order gives the same bits."""
        return reduce(cls.merge, parts)

    def merge(self, other: Moments) -> Moments:
        """Moments of the vectors of both."""
        count = self.count + other.count
        step = other.mean - self.mean
        between = np.sqrt(self.count * other.count / count) * step
        return Moments(
            count,
            self.mean + other.count / count * step,
            _short(np.vstack([self.factor, other.factor, between])),
        )

    def transform(self, matrix: FloatArray) -> Moments:
        """Moments of x M, for M of shape (n_features, n_new_features)."""
        return Moments(self.count, self.mean @ matrix, self.factor @ matrix)

    def select(self, features: slice) -> Moments:
        """Moments of some of the features."""
        return Moments(self.count, self.mean[features], self.factor[:, features])

    @property
    def variances(self) -> FloatArray:
        """Sample variances of the features, shape (n_features,); zero for one vector."""
        return np.asarray(np.sum(self.factor**2, axis=0) / max(self.count - 1, 1))


def shrunk_covariance(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance of errors about zero, and its inverse, shape (n_features, n_features).

    It is shrunk to its diagonal the more the fewer errors there are, and positive definite.

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


def _short(factor: FloatArray) -> FloatArray:
    """A factor of the same scatter with no more than twice as many rows as columns."""
    if len(factor) <= 2 * factor.shape[1]:
        return factor
    return np.asarray(np.linalg.qr(factor, mode="r"))
