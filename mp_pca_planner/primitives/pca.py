# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Principal component analysis, [P] eq. (1)–(5): of vectors, and of the shapes of motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .motion_statistics import MotionStatistics, shape_functions, shape_smoother

if TYPE_CHECKING:
    from .build import PrimitiveOptions


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

    def transform(self, samples: FloatArray) -> FloatArray:
        """Weights of samples, [P] eq. (2) after centring, shape (n_samples, n_components)."""
        return np.asarray((samples - self.mean) @ self.components.T)


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
    mean, n = samples.mean(axis=0), len(samples)
    # With the same singular values and right singular vectors as the deviations from the mean.
    triangle = np.asarray(np.linalg.qr(samples - mean, mode="r"))
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
    """The fewest components whose shares of the variance, [P] eq. (5), add up to `share`."""
    reached = np.cumsum(components.explained_variance / components.total_variance)
    # A sum of shares may miss 1 by rounding.
    return min(int(np.searchsorted(reached, share - 1e-12)) + 1, len(reached))


def fit_shapes(
    statistics: MotionStatistics, options: PrimitiveOptions
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Find the components of the shapes, and the weights of the demonstrations.

    Shapes are given by the coefficients of :func:`.shape_functions`.

    Returns
    -------
    mean : array, shape (n_joints, n_functions)
        Mean shape.
    directions : array, shape (n_components, n_joints, n_functions)
        The components.
    explained_variance : array, shape (n_components,)
        Their variances.
    total_variance : array, shape (n_joints,)
        Variance of the shapes.
    weights : array, shape (n_demonstrations, n_components)
        Weights of the demonstrations.
    fit_residual : array, shape (n_demonstrations, n_joints)
        RMS over the phases of what the weights leave of each, with smoothed components.
    """
    shapes, remainders = statistics.shapes, statistics.shape_remainders
    n, n_joints, n_functions = shapes.shape
    mean = shapes.mean(axis=0)
    values, _ = shape_functions(options.degree, options.n_phases)
    together = n_joints if options.coupling == "arm" else 1
    parts, variances = [], []
    for first in range(0, n_joints, together):
        block = slice(first, first + together)
        # Distances between coefficients equal those between samples.
        components = fit_components(shapes[:, block].reshape(n, -1))
        kept = options.n_components or components_for_share(components, options.variance)
        directions_kept = components.components[:kept].reshape(-1, together, n_functions)
        parts.append(np.zeros((len(directions_kept), n_joints, n_functions)))
        parts[-1][:, block] = directions_kept * largest_signs(directions_kept @ values.T)
        variances.append(components.explained_variance[:kept])
    directions, total = np.concatenate(parts), total_variance(shapes, remainders)
    smoother = shape_smoother(options.degree, options.n_phases)
    weights = np.tensordot(shapes - mean, directions, axes=((-2, -1), (1, 2)))
    rest = shapes - (mean + np.tensordot(weights, directions, axes=1)) @ smoother
    residual = np.sqrt((np.sum(rest**2, axis=2) + remainders) / options.n_phases)
    return mean, directions, np.concatenate(variances), total, weights, residual


def angle_shares(statistics: MotionStatistics) -> dict[str, list[float]]:
    """Shares of the variance of the first four components of joint angles: [P], Table 2."""
    total = total_variance(statistics.angles, statistics.angle_remainders)
    shares = {}
    for joint, name in enumerate(statistics.joint_names):
        pca = fit_components(statistics.angles[:, joint])
        shares[name] = (pca.explained_variance[:4] / total[joint]).tolist()
    return shares


def total_variance(coefficients: FloatArray, remainders: FloatArray) -> FloatArray:
    """Variance of curves about their mean polynomial, shape (n_joints,).

    Parameters
    ----------
    coefficients : array, shape (n_demonstrations, n_joints, n_functions)
        Of the polynomials.
    remainders : array, shape (n_demonstrations, n_joints)
        Sums of squares of the residuals of the coefficients.
    """
    squares = np.sum((coefficients - coefficients.mean(axis=0)) ** 2, axis=(0, 2))
    return np.asarray((squares + remainders.sum(axis=0)) / max(len(coefficients) - 1, 1))
