# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels of the conditional model: likeness of requests, and what demonstrations leave open."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray

INVERSE_LENGTHS = (0.25, 1.0, 2.0)
"""Inverse lengths of the kernels in units of the spread of the requests."""

CONSTANT = 10.0
"""Variance of the common offset of all outputs, in units of that which depends on the request."""

LEAST_NOISE = 0.02
"""Least variance of the noise, in units of that of the outputs which depends on the request."""

# Share of the mean squared distance from start to goal that is added to each squared distance.
_MIN_SQUARE = 0.09


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
        squares = self._squared_distance(requests)
        self._floor = _MIN_SQUARE * float(squares.mean()) or 1.0
        self._unit = float(np.exp(np.mean(np.log(squares + self._floor))))

    def __call__(self, request: FloatArray) -> tuple[FloatArray, float]:
        """Prior covariances with the demonstrations, and the distance from start to goal.

        The covariances are those of Matérn with smoothness 5/2 (Rasmussen and Williams, equation
        4.17) and a constant. Squared exponentials, which are smoother, overshoot between and beyond
        demonstrations.

        Parameters
        ----------
        request : array, shape (n_entries,)
            Any request.

        Returns
        -------
        similarities : array, shape (n_lengths, 2, n_demonstrations)
            By inverse length, of motions and of reversed ones.
        distance : float
            Bounded from below, in units of the geometric mean of all.
        """
        deviations = self._both_directions - request
        apart = np.sqrt(np.einsum("dni,dni->dn", deviations, deviations)) / self._spread
        ratios = np.sqrt(5.0) * np.multiply.outer(INVERSE_LENGTHS, apart)
        square = (self._squared_distance(request) + self._floor) / self._unit
        covariances = (1.0 + ratios + ratios**2 / 3.0) * np.exp(-ratios) + CONSTANT
        return covariances, math.sqrt(square)

    def _squared_distance(self, requests: FloatArray) -> FloatArray:
        # Each joint counts twice, which only changes the unit.
        change = requests - requests[..., self._swapped]
        return np.asarray(np.einsum("...i,...i->...", change, change))


def remaining_covariance(demonstrated: FloatArray, requests: FloatArray) -> FloatArray:
    """Covariance of the shapes of requests that demonstrations leave, in units of the prior's.

    That of a Gaussian process with the middle one of the kernels and the least noise (Rasmussen and
    Williams, equation 2.24), without the common offset. It does not depend on the shapes, so it is
    known before a motion is demonstrated.

    Parameters
    ----------
    demonstrated : array, shape (n_demonstrations, 2 n_joints)
        Start and goal of each demonstration [rad or m].
    requests : array, shape (n_requests, 2 n_joints)
        Start and goal of each request.

    Returns
    -------
    covariance : array, shape (n_requests, n_requests)
        On its diagonal, 0 is at a demonstration and 1 far from all.
    """
    every = np.concatenate([demonstrated, requests])
    features, n = RequestFeatures(every), len(demonstrated)
    prior = np.array([features(one)[0][1, 0] - CONSTANT for one in every])
    gram = prior[:n, :n] + LEAST_NOISE * np.eye(n)
    return np.asarray(prior[n:, n:] - prior[n:, :n] @ np.linalg.solve(gram, prior[:n, n:]))
