# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a second publisher: zeros are dropped, contradicting positions are rejected."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from ...exceptions import RecordingError
from .samples import RepairOptions, Samples, count


def refuse_late_contradictions(
    samples: Samples, options: RepairOptions, repairs: Counter[str]
) -> Samples:
    """Reject late messages whose positions differ from those of the messages in order.

    Two publishers whose stamps differ by their delays cause such messages. Late messages of a
    single publisher agree with the others.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    times, positions, received = samples.times, samples.positions, samples.received
    earliest_behind = np.minimum.accumulate(received[::-1])[::-1]
    late = np.append(received[:-1] > earliest_behind[1:], False)
    if count(late) <= options.min_conflicts:
        return samples
    on_time = times[~late]
    differs = np.zeros(count(late), dtype=bool)
    for position in positions.T:
        expected = np.interp(times[late], on_time, position[~late])
        error = np.abs(position[late] - expected)
        differs |= np.abs(error - 2.0 * np.pi * np.round(error / (2.0 * np.pi))) > options.conflict
    # Zeros between positions are a second publisher's, too, but they can be dropped.
    differs &= np.any(positions[late] != 0.0, axis=1)
    # Where a block of messages is late, no message in order is near enough to compare with.
    behind = np.clip(np.searchsorted(on_time, times[late]), 1, on_time.size - 1)
    differs &= on_time[behind] - on_time[behind - 1] <= 3 * np.median(np.diff(on_time))
    _refuse_conflicts(differs, times.size, options, "those that came before them")
    return samples


def drop_equal_stamps(samples: Samples, options: RepairOptions, repairs: Counter[str]) -> Samples:
    """Keep one sample for each stamp: the first received, but none of zeros beside others.

    Drivers that start before their robot publish zeros; such a second publisher is recognised.
    For other contradictions the correct message is unknown; only a small number is accepted.

    Raises
    ------
    RecordingError
        If too many samples contradict others.
    """
    zero = np.all(samples.positions == 0.0, axis=1)
    # Within equal stamps samples of zeros are last; the stable sort leaves the others as received.
    order = np.lexsort((zero, samples.times))
    same_stamp = np.flatnonzero(np.diff(samples.times) == 0) + 1
    sample, before = order[same_stamp], order[same_stamp - 1]
    differs = np.any(samples.positions[sample] != samples.positions[before], axis=1)
    _refuse_conflicts(
        differs & ~zero[sample], zero.size, options, "another one with the same stamp"
    )
    repairs["contradicting"] += count(differs)
    repairs["repeated_stamps"] += count(~differs)
    return samples.taken(np.delete(order, same_stamp))


def _refuse_conflicts(
    conflicts: NDArray[np.bool_], n_messages: int, options: RepairOptions, what: str
) -> None:
    n_conflicts = count(conflicts)
    if n_conflicts > max(options.min_conflicts, options.max_conflicts * n_messages):
        raise RecordingError(
            f"{n_conflicts} messages contradict {what}: two publishers of the same joints; record "
            "one of them"
        )


def drop_zeros(samples: Samples, options: RepairOptions, repairs: Counter[str]) -> Samples:
    """Drop the zeros that a second publisher puts between positions."""
    zero = np.all(samples.positions == 0.0, axis=1)
    changes = np.flatnonzero(zero[1:] != zero[:-1])
    # A robot that passes its zero is near it before and after.
    beside = samples.positions[changes + zero[changes]]
    alternations = count(np.max(np.abs(beside), axis=1) > options.far_from_zero)
    if alternations < options.min_alternations:
        return samples
    repairs["zeros"] += count(zero)
    return samples.taken(np.flatnonzero(~zero))
