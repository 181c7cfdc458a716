# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of the chosen joints while they are repaired, and the options of the repairs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import RecordingError
from ...input_limits import INPUT_LIMITS
from ..byte_layout import NS_PER_S
from ..joint_states import IntArray
from .recording import MIN_SAMPLES


@dataclass(frozen=True)
class RepairOptions:
    """Thresholds of the repairs; the defaults suit arms recorded at 5 to 1000 Hz.

    Attributes
    ----------
    max_gap : float or None
        Longest time without messages that is no gap [s], over 0. By default `gap_time`, or
        `gap_periods` usual periods where these are longer.
    gap_time, gap_periods : float
        See `max_gap` [s, periods].
    enough_rate : float
        Arm motions need no higher sample rate [Hz]. Of a recording with at least twice this rate,
        consecutive samples are averaged.
    max_conflicts, min_conflicts : float, int
        A second publisher is present if more than this share of the messages, and more than this
        number, contradict others.
    conflict : float
        A late message contradicts the others if it is farther than this from their positions at
        its time [rad or m].
    max_turn_error : float
        A jump is a full turn if it differs from one by less than this [rad].
    min_jump, jump_ratio : float
        A jump is longer than `min_jump` [rad or m] and than `jump_ratio` usual steps.
    jump_speed, jump_isolation : float
        A jump is faster than `jump_speed` [/s] and longer than `jump_isolation` times the steps
        before and after it. A spike, which returns in the next sample, need not be as fast.
    max_jumps : float
        From this share of jumping samples on there are two publishers.
    min_alternations : int
        A publisher of zeros is present from this number of changes between zeros and positions on.
    far_from_zero : float
        Positions beside zeros are another publisher's if they exceed this [rad or m].
    """

    max_gap: float | None = None
    gap_time: float = 0.5
    gap_periods: float = 5
    enough_rate: float = 100.0
    max_conflicts: float = 0.01
    min_conflicts: int = 10
    conflict: float = 0.01
    max_turn_error: float = 1.0
    min_jump: float = 0.05
    jump_ratio: float = 10.0
    jump_speed: float = 20.0
    jump_isolation: float = 5.0
    max_jumps: float = 0.05
    min_alternations: int = 10
    far_from_zero: float = 0.05

    def longest_gap(self, period: float) -> float:
        """Longest time between messages of this usual period that is no gap, both in [ns]."""
        if self.max_gap is not None:
            return self.max_gap * NS_PER_S
        return max(self.gap_time * NS_PER_S, self.gap_periods * period)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one recording.

    Attributes
    ----------
    times : array of int, shape (n_samples,)
        Stamps, or times since the first message once they are in order [ns].
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m].
    received : array of int, shape (n_samples,)
        Place of each sample in the order of reception.
    first_stamp : int
        Stamp of the recording's first message [ns].
    """

    times: IntArray
    positions: FloatArray
    received: IntArray
    first_stamp: int

    @property
    def period(self) -> float:
        """Median period [ns], whatever the order of the samples."""
        steps = np.diff(np.sort(self.times))
        return float(np.median(steps[steps > 0]))

    def taken(self, rows: IntArray) -> Samples:
        """Some of the samples, in the order of `rows`."""
        return Samples(
            taken(rows, self.times),
            taken(rows, self.positions),
            taken(rows, self.received),
            self.first_stamp,
        )

    def refuse_few(self) -> None:
        """Refuse fewer than `MIN_SAMPLES` different times.

        Raises
        ------
        RecordingError
            If they are too few.
        """
        # Sorting is several times faster than np.unique, which hashes.
        n_samples = min(1, self.times.size) + count(np.diff(np.sort(self.times)))
        if n_samples < MIN_SAMPLES:
            raise RecordingError(
                f"there are {n_samples} usable samples, at least {MIN_SAMPLES} are needed"
            )


def count(mask: NDArray[Any]) -> int:
    """Number of entries that are not zero."""
    return int(np.count_nonzero(mask))


def taken(rows: IntArray, values: NDArray[Any]) -> NDArray[Any]:
    """Some rows of an array; the array itself where these are all, since it may be large."""
    if rows.size == len(values) and np.array_equal(rows, np.arange(rows.size)):
        return values
    return values[rows]


def drop_unusable(samples: Samples, options: RepairOptions, repairs: Counter[str]) -> Samples:
    """Drop samples without a stamp or with an unusable position."""
    # NaN compares false, too.
    finite = np.all(np.abs(samples.positions) < INPUT_LIMITS.position, axis=1)
    stamped = samples.times > 0
    repairs["non_finite"] += count(~finite)
    repairs["unstamped"] += count(finite & ~stamped)
    return samples.taken(np.flatnonzero(finite & stamped))
