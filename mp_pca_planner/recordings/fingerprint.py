# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fingerprints of recordings, by which copies are recognised in other files and at other times.

A fingerprint is the smallest hashes of short runs of samples, without their times. Runs that two
recordings have in common are in both fingerprints, and noise makes others differ.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

SIZE = 32
"""Largest number of hashes of a fingerprint."""

MIN_COMMON = 3
"""Fewer common hashes are no evidence."""

MIN_SHARE = 0.7
"""Share of a recording's runs that another one has, from which on it is a copy or a part of it."""

_QUANTUM = 1e-4  # rad or m; less than noise, and more than errors of other formats
_RUN = 3


def fingerprint(positions: FloatArray, joint_names: Sequence[str]) -> tuple[int, ...]:
    """Smallest hashes of runs of samples in which a joint moves.

    Parameters
    ----------
    positions : array, shape (n_samples, n_joints)
        Samples in order [rad or m].
    joint_names :
        Names of the joints; their order does not matter.
    """
    order = np.argsort(np.array(joint_names, dtype=object), kind="stable")
    steps = np.rint(positions[:, order] / _QUANTUM).astype(np.int64).view(np.uint64)
    factors = np.random.default_rng(1).integers(1 << 62, size=len(order), dtype=np.uint64) * 2 + 1
    rows = _mixed((steps * factors.astype(np.uint64)).sum(axis=1, dtype=np.uint64))
    moves = rows[1:] != rows[:-1]
    n = rows.size - _RUN + 1
    if n < 1:
        return ()
    runs, moving = np.zeros(n, dtype=np.uint64), np.ones(n, dtype=bool)
    for k in range(_RUN):
        runs = _mixed(runs ^ rows[k : k + n])
        if k:
            moving &= moves[k - 1 : k - 1 + n]
    return tuple(np.unique(runs[moving] >> np.uint64(1))[:SIZE].tolist())


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Values whose bits are spread evenly, by the finaliser of SplitMix64."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(values ^ (values >> np.uint64(31)))


def common_shares(
    values: NDArray[np.int64], owners: NDArray[np.int64]
) -> dict[tuple[int, int], tuple[float, float]]:
    """Shares of the runs of two recordings that the other one has, too.

    Parameters
    ----------
    values : array, shape (n_hashes,)
        The fingerprints of all recordings, one after the other.
    owners : array, shape (n_hashes,)
        The index of the recording of each, not decreasing.

    Returns
    -------
    :
        By the indices of the recordings, the first one less than the second one.
    """
    order = np.argsort(values, kind="stable")
    is_new = np.append(True, np.diff(values[order]) != 0)
    starts = np.flatnonzero(is_new)
    ends = np.append(starts[1:], values.size)
    pairs = Counter[tuple[int, int]]()
    for start, end in zip(starts[ends - starts > 1], ends[ends - starts > 1], strict=True):
        found = owners[order[start:end]].tolist()
        # Of many copies, each is compared with the first ones.
        pairs.update((one, other) for i, one in enumerate(found[:4]) for other in found[i + 1 :])
    shares = {}
    for pair, n_common in pairs.items():
        both = [values[slice(*np.searchsorted(owners, (i, i + 1)))] for i in pair]
        # The hashes of a longer recording reach less far.
        reach = min(own[-1] if own.size == SIZE else np.inf for own in both)
        if n_common >= MIN_COMMON:
            first, second = (n_common / np.count_nonzero(own <= reach) for own in both)
            shares[pair] = (float(first), float(second))
    return shares
