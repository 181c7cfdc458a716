# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Search for the primitives whose demonstrations are nearest to a request.

The square of an in-span score is a polynomial of second degree of the request. Its coefficients are
a row of a matrix, so that one product of the matrix, in single precision, with the monomials of a
request approximates the scores of all primitives. The least ones are then computed in double
precision. A tree of the mean requests takes less time among very many primitives, but misses the
nearest one where primitives overlap, because each has a metric of its own
(benchmarks/selection.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import tau

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .conditional_model import marginal_precision

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _Quadratics:
    """Squared distances of primitives from a request as polynomials of the request.

    Attributes
    ----------
    coefficients : float32 array, shape (n_primitives, n_monomials)
        Of the products of two entries, of the entries, and of 1.
    centre : array, shape (n_entries,)
        Requests count from here, against rounding.
    """

    coefficients: NDArray[np.float32]
    centre: FloatArray

    @classmethod
    def of(
        cls, means: FloatArray, precisions: FloatArray, size: int, n_at_once: int = 4096
    ) -> _Quadratics:
        """Coefficients for requests of a size; of few primitives at a time, to bound the memory."""
        centre = means[:, :size].mean(axis=0)
        upper = np.triu_indices(size)
        n_squares = upper[0].size
        coefficients = np.empty((len(means), n_squares + size + 1), dtype=np.float32)
        for first in range(0, len(means), n_at_once):
            block = slice(first, first + n_at_once)
            precision = marginal_precision(precisions[block], size)
            mean = means[block, :size] - centre
            moment = np.einsum("pij,pj->pi", precision, mean)
            twice = np.where(upper[0] == upper[1], 1.0, 2.0)
            coefficients[block, :n_squares] = precision[:, upper[0], upper[1]] * twice
            coefficients[block, n_squares:-1] = -2.0 * moment
            coefficients[block, -1] = np.sum(moment * mean, axis=1)
        return cls(coefficients, centre)

    def values(self, requests: FloatArray) -> NDArray[np.float32]:
        """Squared distances from requests of shape (n_requests, n_entries); one column for each."""
        x = requests - self.centre
        rows, columns = np.triu_indices(x.shape[1])
        monomials = np.hstack([x[:, rows] * x[:, columns], x, np.ones((len(x), 1))])
        return np.asarray(self.coefficients @ monomials.T.astype(np.float32))


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
    n_exact : int
        Number of scores that are computed in double precision, at least.
    """

    def __init__(
        self,
        means: FloatArray,
        precisions: FloatArray,
        continuous: NDArray[np.bool_],
        n_exact: int = 64,
    ) -> None:
        self._means, self._precisions, self._continuous = means, precisions, continuous
        self._n_exact = n_exact
        self._quadratics = lru_cache(self._make_quadratics)
        if len(means) > n_exact:
            self._quadratics(means.shape[1] - 1)

    def turns(self, start: FloatArray, among: Indices | slice = slice(None)) -> FloatArray:
        """Angles from a start to the nearest full turns of the demonstrations.

        Parameters
        ----------
        start : array, shape (n_joints,)
            Positions [rad or m].
        among : array of int or slice
            Indices of the n_among primitives; all by default.

        Returns
        -------
        turns : array, shape (n_among, n_joints)
            Multiples of 2π [rad] to be added to the start and the goal.
        """
        turns = np.round((self._means[among, : start.size] - start) / tau)
        return np.where(self._continuous, tau * turns, 0.0)

    def scores(self, request: FloatArray, among: Indices | slice = slice(None)) -> FloatArray:
        """In-span scores of a request, shape (n_among,).

        Parameters
        ----------
        request : array, shape (2 n_joints,) or (2 n_joints + 1,)
            Start and goal [rad or m], and the logarithm of the duration if one is requested.
        among : array of int or slice
            Indices of the n_among primitives; all by default.
        """
        n, size = self._continuous.size, request.size
        deviations = request - self._means[among, :size]
        deviations[:, : 2 * n] += np.tile(self.turns(request[:n], among), 2)
        precisions = marginal_precision(self._precisions[among], size)
        squares = np.einsum("pi,pij,pj->p", deviations, precisions, deviations)
        return np.asarray(np.sqrt(squares / size))

    def nearest(self, request: FloatArray, n: int) -> tuple[Indices, FloatArray]:
        """The primitives with the least in-span scores.

        Parameters
        ----------
        request : array, shape (2 n_joints,) or (2 n_joints + 1,)
            See :meth:`scores`.
        n : int
            Their largest number, at most `n_exact`.

        Returns
        -------
        indices : array of int, shape (n_found,)
            Indices of the primitives, the nearest first.
        scores : array, shape (n_found,)
            Their scores.
        """
        if len(self._means) > self._n_exact:
            found = np.argpartition(self._approximate(request), self._n_exact)[: self._n_exact]
            found.sort()
        else:
            found = np.arange(len(self._means))
        scores = self.scores(request, found)
        order = np.argsort(scores, kind="stable")[:n]
        return found[order], scores[order]

    def _make_quadratics(self, size: int) -> _Quadratics:
        n, means = self._continuous.size, self._means.copy()
        means[:, : 2 * n] -= self._whole_turns(means[:, :n])
        return _Quadratics.of(means, self._precisions, size)

    def _whole_turns(self, starts: FloatArray) -> FloatArray:
        """Angles by which requests are moved so that they start between 0 and 2π."""
        turns = np.where(self._continuous, tau * np.floor(starts / tau), 0.0)
        return np.tile(turns, 2)

    def _approximate(self, request: FloatArray) -> NDArray[np.float32]:
        """Approximate squared distances of all primitives."""
        n = self._continuous.size
        request = request.copy()
        request[: 2 * n] -= self._whole_turns(request[:n])
        turning = np.flatnonzero(self._continuous)
        turns = np.where(request[turning] < np.pi, tau, -tau)
        further = np.array(list(product((0.0, 1.0), repeat=turning.size))) * turns
        requests = np.tile(request, (len(further), 1))
        requests[:, turning] += further
        requests[:, n + turning] += further
        values = self._quadratics(request.size).values(requests)
        # Primitives whose demonstrations are nearer after one more turn, or one less.
        starts = self._means[:, turning] - self._whole_turns(self._means[:, :n])[:, turning]
        is_further = np.abs(starts - request[turning]) > np.pi
        columns = is_further @ 2 ** np.arange(turning.size)[::-1]
        return np.asarray(np.take_along_axis(values, columns[:, None], axis=1)[:, 0])
