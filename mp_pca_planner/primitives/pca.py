# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Principal component analysis, [P] eq. (1)–(5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..rows import row_blocks, row_mean


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Components of a set of vectors.

    Attributes
    ----------
    mean : array, shape (n_features,)
        Sample mean.
    components : array, shape (n_components, n_features)
        Orthonormal eigenvectors of the covariance matrix, [P] eq. (1); in each, the entry
        largest in magnitude is positive, so that a rebuild gives the same file.
    explained_variance : array, shape (n_components,)
        Their eigenvalues λₖ, decreasing: the variances of the components, [P] eq. (3).
    total_variance : float
        Sum of the variances of the features: the sum of all eigenvalues, [P] eq. (4).
    """

    mean: FloatArray
    components: FloatArray
    explained_variance: FloatArray
    total_variance: float

    @property
    def explained_variance_ratio(self) -> FloatArray:
        """Shares of the variance, [P] eq. (5), shape (n_components,)."""
        if self.total_variance == 0.0:
            return np.zeros(0)
        return self.explained_variance / self.total_variance

    def transform(self, samples: FloatArray) -> FloatArray:
        """Weights of samples, [P] eq. (2) after centring, shape (n_samples, n_components)."""
        return np.asarray((samples - self.mean) @ self.components.T)

    def truncated(self, n_components: int) -> PrincipalComponents:
        """The first components only."""
        return PrincipalComponents(
            self.mean,
            self.components[:n_components],
            self.explained_variance[:n_components],
            self.total_variance,
        )


def fit_components(
    samples: FloatArray, rank_tolerance: float = 1e-12, constant: float = 1e-9
) -> PrincipalComponents:
    """Find all principal components that have any variance.

    Parameters
    ----------
    samples : array, shape (n_samples, n_features)
        Constant ones (or a single one) give no components.
    rank_tolerance :
        Components whose variance is below this share of the largest are rounding errors.
    constant :
        Vectors whose entries deviate from their mean by less than this are constant [rad or m].
    """
    mean, n = row_mean(samples), len(samples)
    # With the same singular values and right singular vectors as the deviations from the mean.
    triangle = np.zeros((0, mean.size))
    for (block,) in row_blocks(samples):
        rows = np.concatenate([triangle, block - mean])
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    if n < 2 or np.sqrt(np.sum(triangle**2, axis=0).max() / (n - 1)) < constant:
        return PrincipalComponents(mean, np.zeros((0, mean.size)), np.zeros(0), 0.0)
    _, singular, rows = np.linalg.svd(triangle, full_matrices=False)
    variance = singular**2 / (n - 1)
    keep = variance > rank_tolerance * variance[0]
    rows = rows[keep] * largest_signs(rows[keep])
    return PrincipalComponents(mean, rows, variance[keep], float(variance.sum()))


def largest_signs(components: FloatArray) -> FloatArray:
    """Signs of the entries largest in magnitude, shape (n_components, 1, ...)."""
    rows = components.reshape(len(components), np.prod(components.shape[1:], dtype=int))
    largest = np.abs(rows).argmax(axis=1)
    signs = np.sign(rows[np.arange(len(rows)), largest])
    return np.asarray(signs.reshape(-1, *np.ones(components.ndim - 1, dtype=int)))


def components_for_share(components: PrincipalComponents, share: float) -> int:
    """The fewest components whose shares of the variance add up to `share`."""
    reached = np.cumsum(components.explained_variance_ratio)
    # A sum of shares may miss 1 by rounding.
    return min(int(np.searchsorted(reached, share - 1e-12)) + 1, len(reached))
