# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Copies of recordings in other forms, and parts of others, by hashes of runs of their samples."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from zlib import crc32

import numpy as np

from ..arrays import FloatArray

FINGERPRINT_SIZE = 32
"""Largest number of hashes of a fingerprint."""

# Samples of a fingerprint are in steps of this [rad or m], less than noise and more than errors of
# other formats, and in runs of three, so that a joint moves twice.
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
    rows = np.rint(positions[:, order] / _QUANTUM).astype(np.int64)
    moves = (rows[1:] != rows[:-1]).any(axis=1)
    content, size = memoryview(rows.tobytes()), rows.shape[1] * rows.itemsize
    firsts = (size * np.flatnonzero(moves[:-1] & moves[1:])).tolist()
    runs = {crc32(content[first : first + _RUN * size]) for first in firsts}
    return tuple(sorted(runs)[:FINGERPRINT_SIZE])


def parts_of_others(fingerprints: Sequence[Sequence[int]]) -> list[tuple[int, int, bool]]:
    """Recordings whose samples another one has, too.

    Parameters
    ----------
    fingerprints :
        Of each recording.

    Returns
    -------
    :
        For each, its index, that of the other one, and whether it is only a part of that.
    """
    owners = defaultdict[int, list[int]](list)
    for index, hashes in enumerate(fingerprints):
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
