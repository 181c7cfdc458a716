# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Copies of recordings in other forms, and parts of others, by hashes of runs of their samples."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

FINGERPRINT_SIZE = 32
"""Largest number of hashes of a fingerprint."""

# Samples of a fingerprint are in steps of this [rad or m], less than noise and more than errors of
# other formats, and in runs of so many.
_QUANTUM = 1e-4
_RUN = 3
# Fewer common hashes of fingerprints are no evidence.
_MIN_COMMON = 3
# Share of a recording's runs that another one has, from which on it is a copy or a part of it.
_MIN_SHARE = 0.7


def fingerprint(positions: FloatArray, joint_names: Sequence[str]) -> tuple[int, ...]:
    """Smallest hashes of short runs of samples, without their times, in which a joint moves.

    Runs that two recordings have in common are in both fingerprints, whatever their formats and
    times. Noise makes others differ.

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
    return tuple(np.unique(runs[moving] >> np.uint64(1))[:FINGERPRINT_SIZE].tolist())


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Values whose bits are spread evenly, by the finaliser of SplitMix64."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(values ^ (values >> np.uint64(31)))


def parts_of_others(fingerprints: Mapping[int, Sequence[int]]) -> list[tuple[int, int, bool]]:
    """Recordings whose samples another one has, too.

    Parameters
    ----------
    fingerprints :
        By the index of the recording, increasing.

    Returns
    -------
    :
        For each, its index, that of the other one, and whether it is only a part of that.
    """
    owners = defaultdict[int, list[int]](list)
    for index, hashes in fingerprints.items():
        for value in hashes:
            owners[value].append(index)
    # Of many copies, each is compared with the first ones.
    pairs = Counter(
        (several[i], other)
        for several in owners.values()
        for i in range(min(4, len(several)))
        for other in several[i + 1 :]
    )
    gone: dict[int, tuple[int, bool]] = {}
    for pair, n_common in sorted(pairs.items()):
        both = [fingerprints[index] for index in pair]
        # The hashes of a longer recording reach less far.
        reach = min(max(x) if len(x) == FINGERPRINT_SIZE else np.inf for x in both)
        first, second = (n_common / sum(value <= reach for value in x) for x in both)
        is_copy = n_common >= _MIN_COMMON and max(first, second) >= _MIN_SHARE
        if is_copy and not gone.keys() & set(pair):
            # Of equal ones, the first is kept.
            part, whole = pair if first > second + 0.3 else pair[::-1]
            gone[part] = whole, min(first, second) < _MIN_SHARE
    return [(part, *other) for part, other in gone.items()]
