# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of the chosen joints while they are repaired."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import RecordingError
from ..joint_states import IntArray
from .options import RepairOptions
from .recording import MIN_SAMPLES

MAX_POSITION = 1e6
"""Drivers mark unknown positions by huge numbers; no joint reaches this one [rad or m]."""


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
        n_samples = np.unique(self.times).size
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
    finite = np.all(np.abs(samples.positions) < MAX_POSITION, axis=1)
    stamped = samples.times > 0
    repairs["non_finite"] += count(~finite)
    repairs["unstamped"] += count(finite & ~stamped)
    return samples.taken(np.flatnonzero(finite & stamped))
