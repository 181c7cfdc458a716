# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What some demonstrations teach, and which motions they say least about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..primitives.cross_validation import leave_one_out
from ..primitives.options import PrimitiveOptions
from ..primitives.prediction import OFFSET, RequestFeatures
from ..recordings.demonstration import Demonstration
from ..robot.limits import JointLimits

# Variance of the noise of a demonstration.
_NOISE = 0.02


@dataclass(frozen=True)
class LearnedOptions:
    """How it is found out what was learned.

    Attributes
    ----------
    n_suggested : int
        Number of suggested motions.
    max_unknown : float
        A motion is covered while this share of the variance of its shape, or less, is unknown.
    beyond : float
        Suggested goals are at most this share of the distance from the mean goal beyond the
        demonstrated ones.
    min_distance : float
        A suggested motion is longer than this share of the shortest demonstrated one.
    max_candidates, max_left_out : int
        Largest numbers of motions that are compared, and of demonstrations that are left out.
    """

    n_suggested: int = 2
    max_unknown: float = 0.5
    beyond: float = 0.25
    min_distance: float = 0.5
    max_candidates: int = 200
    max_left_out: int = 20


@dataclass(frozen=True, eq=False)
class Learned:
    """What demonstrations teach.

    Attributes
    ----------
    error, straight_error : float
        RMS distance of left-out demonstrations from their prediction by the others, and from
        the minimum-jerk motion between their ends [rad or m].
    low, high : array, shape (n_joints,)
        Range of the demonstrated goals.
    covered : float
        Share of the motions from a demonstrated start to the goal of another demonstration of
        which more is known than unknown.
    suggested : array, shape (n_suggested, 2, n_joints)
        Starts and goals of the motions of which least is known, each given those before it.
    """

    error: float
    straight_error: float
    low: FloatArray
    high: FloatArray
    covered: float
    suggested: FloatArray

    @classmethod
    def of(
        cls,
        motions: Sequence[Demonstration],
        limits: JointLimits | None = None,
        options: LearnedOptions = LearnedOptions(),
    ) -> Learned:
        """Find out what demonstrations teach.

        Parameters
        ----------
        motions :
            Demonstrations of the same joints, at least two.
        limits :
            Suggested goals are within these.
        options :
            See :class:`LearnedOptions`.

        Raises
        ------
        PrimitiveError
            If no primitive can be built from them.
        """
        every = -(-len(motions) // options.max_left_out)
        errors = leave_one_out(motions, PrimitiveOptions(), range(0, len(motions), every)).rms()
        ends = np.array([motion.positions[[0, -1]] for motion in motions])
        shown, new = _requests(ends, limits, options)
        demonstrated = ends.reshape(len(ends), -1)
        requests = np.concatenate([shown, new])
        covariance = remaining_covariance(demonstrated, requests)
        suggested = requests[_least_known(covariance, options.n_suggested)]
        is_covered = np.diag(covariance)[: len(shown)] <= options.max_unknown
        return cls(
            error=float(errors[2, 0]),
            straight_error=float(errors[0, 0]),
            low=ends[:, 1].min(axis=0),
            high=ends[:, 1].max(axis=0),
            covered=float(is_covered.mean()) if len(shown) else 0.0,
            suggested=suggested.reshape(-1, *ends.shape[1:]),
        )


def _requests(
    ends: FloatArray, limits: JointLimits | None, options: LearnedOptions
) -> tuple[FloatArray, FloatArray]:
    """Requests from demonstrated starts to the goals of other demonstrations, and to new goals.

    New goals are halfway between two demonstrated ones, and beyond them.

    Parameters
    ----------
    ends : array, shape (n_demonstrations, 2, n_joints)
        Starts and goals.

    Returns
    -------
    shown, new : array, shape (n_requests, 2 n_joints)
        Start and goal of each request.
    """
    starts, goals = ends.transpose(1, 0, 2)
    n, most = len(ends), options.max_candidates
    halfway = 0.5 * np.sum(goals[_some(np.argwhere(np.tri(n, k=-1)), most)], axis=1)
    further = np.concatenate([halfway, goals + options.beyond * (goals - goals.mean(axis=0))])
    least = options.min_distance * np.linalg.norm(goals - starts, axis=1).min()

    def requests(to: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
        first, second = _some(pairs, most).T
        start, goal = starts[first], to[second]
        kept = np.linalg.norm(goal - start, axis=1) > least
        if limits is not None:
            kept &= np.all((goal >= limits.lower) & (goal <= limits.upper), axis=1)
        return np.asarray(np.concatenate([start, goal], axis=1)[kept])

    others = np.argwhere(~np.eye(n, dtype=bool))
    return requests(goals, others), requests(further, np.argwhere(np.ones((n, len(further)))))


def _some(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """All rows, or at most so many of them at random, always the same ones."""
    return rows[np.random.default_rng(0).permutation(len(rows))[:most]]


def remaining_covariance(demonstrated: FloatArray, requests: FloatArray) -> FloatArray:
    """Covariance of the shapes of requests that demonstrations leave, in units of the prior's.

    That of a Gaussian process with the least noise (Rasmussen and Williams, equation 2.24). The
    common offset of all shapes counts as known. It does not depend on the shapes, so it is known
    before a motion is demonstrated.

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
    every, n = np.concatenate([demonstrated, requests]), len(demonstrated)
    similar, _ = RequestFeatures(every)(every)
    prior = similar[0, 0] - OFFSET
    gram = prior[:n, :n] + _NOISE * np.eye(n)
    return np.asarray(prior[n:, n:] - prior[n:, :n] @ np.linalg.solve(gram, prior[:n, n:]))


def _least_known(covariance: FloatArray, n: int) -> list[int]:
    """Requests of largest variance, each given the demonstration of those before it.

    Parameters
    ----------
    covariance : array, shape (n_requests, n_requests)
        See :func:`remaining_covariance`.
    n : int
        Largest number of requests.
    """
    chosen: list[int] = []
    for _ in range(min(n, len(covariance))):
        best = int(np.argmax(np.diag(covariance)))
        column = covariance[:, best]
        covariance = covariance - np.outer(column, column) / (column[best] + _NOISE)
        chosen.append(best)
    return chosen
