# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Choice between primitives of several kinds and one primitive of all motions.

A planner is not given the kind of a motion: it chooses the primitive with the least in-span score
of the request. Where kinds share ends and durations, it often chooses a wrong one, and one
primitive of all motions predicts better. Both are compared on motions that are left out before
their kinds are found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from ...arrays import FloatArray
from ..in_span import RequestIndex, request_precision
from ..motion_statistics import MotionStatistics, thinned
from ..prediction import left_out_squares
from .find import OUTLIER, Indices, KindOptions, Kinds, find_kinds

# At most this share of the motions is left out at once, and this number in all.
_SHARE = 0.1
_MAX_LEFT_OUT = 200


@dataclass(frozen=True)
class KindErrors:
    """RMS errors in path of left-out motions, with kinds and with one primitive [rad or m].

    Attributes
    ----------
    n_kinds, n_outliers : int
        Number of kinds, and of motions that belong to none.
    known : float
        Each motion is predicted by the primitive of its kind.
    chosen : float
        Each is predicted by the primitive that a planner chooses from its ends and its duration.
    pooled : float
        Each is predicted by one primitive of all motions.
    """

    n_kinds: int
    n_outliers: int
    known: float
    chosen: float
    pooled: float

    @property
    def one_is_best(self) -> bool:
        """Whether one primitive of all motions predicts better than a planner chooses."""
        return self.pooled <= self.chosen


def choose_kinds(
    statistics: MotionStatistics, n_phases: int, options: KindOptions
) -> tuple[Kinds, KindErrors | None]:
    """Find kinds of motions, and keep them if a planner predicts better with them.

    Parameters
    ----------
    statistics, n_phases, options :
        See :func:`.find_kinds`.

    Returns
    -------
    kinds : Kinds
        The kinds, or a single kind of all motions.
    errors : KindErrors or None
        Errors with the kinds that were found, kept or not; None if all motions are of one kind.
    """
    found = find_kinds(statistics, n_phases, options)
    if not found.assigned.any():
        return found, None
    errors = _left_out_errors(statistics, n_phases, options, found)
    if errors.one_is_best:
        whole = np.zeros_like(found.assigned)
        found = replace(found, assigned=whole, explained_by=whole[:, None] == 0)
    return found, errors


def _left_out_errors(
    statistics: MotionStatistics, n_phases: int, options: KindOptions, kinds: Kinds
) -> KindErrors:
    requests = statistics.requests()
    # The same folds whatever the order of the motions.
    order = np.lexsort(requests.T[::-1])
    left_out = order[:: -(-len(order) // _MAX_LEFT_OUT)]
    n_folds = min(ceil(len(left_out) / (_SHARE * len(order))), len(left_out))
    squares = []
    for tests in (left_out[first::n_folds] for first in range(n_folds)):
        rest = np.setdiff1d(np.arange(len(requests)), tests)
        refound = find_kinds(statistics.chosen(rest), n_phases, options)
        members = [rest[refound.members(k)] for k in range(refound.assigned.max() + 1)]
        by_kind = np.array([_squares(statistics, x, tests) for x in members])
        chosen = by_kind[_nearest(requests, members, tests), np.arange(len(tests))]
        pooled, known = _squares(statistics, rest, tests), chosen.copy()
        for kind in set(kinds.assigned[tests].tolist()) - {OUTLIER}:
            here = kinds.assigned[tests] == kind
            others = np.setdiff1d(kinds.members(kind), tests)
            if len(others):
                known[here] = _squares(statistics, others, tests[here])
        squares.append([known, chosen, pooled])
    means = np.concatenate(squares, axis=1).mean(axis=1)
    rms = np.sqrt(means / (n_phases * len(statistics.joint_names)))
    n_outliers = int(np.sum(kinds.assigned == OUTLIER))
    return KindErrors(int(kinds.assigned.max()) + 1, n_outliers, *map(float, rms))


def _squares(statistics: MotionStatistics, used: Indices, tests: Indices) -> FloatArray:
    """Squared errors of some motions that are predicted by others, shape (n_tests,)."""
    used = used[thinned(statistics.chosen(used).requests())]
    both, n = statistics.chosen(np.concatenate([used, tests])), len(used)
    labels = [motion.label for motion in both.motions][:n]
    squares = left_out_squares(both.requests(), both.both_shapes(), np.arange(n), labels)
    return np.asarray(squares[n:] + both.shape_remainders[n:].sum(axis=1))


def _nearest(requests: FloatArray, members: list[Indices], tests: Indices) -> Indices:
    """The kind with the least in-span score for each of some requests, shape (n_tests,)."""
    index = RequestIndex(
        np.array([requests[x].mean(axis=0) for x in members]),
        np.array([request_precision(requests[x]) for x in members]),
        np.zeros(requests.shape[1] // 2, dtype=bool),
    )
    return np.array([index.scores(requests[i]).argmin() for i in tests])
