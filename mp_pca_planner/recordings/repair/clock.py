# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repairs of stamps: the choice of the clock, stray stamps, clocks set back, late messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from ...exceptions import RecordingError
from ...input_limits import INPUT_LIMITS
from ..byte_layout import NS_PER_S
from ..joint_states import IntArray, RawJointStates
from .samples import RepairOptions, Samples, count

YEAR_NS = 365 * 24 * 3600 * NS_PER_S

SIMULATION_TIME = (
    "header stamps are not the time of day (simulation time, for example): they are used"
)


def choose_clock(raw: RawJointStates, messages: IntArray) -> tuple[IntArray, tuple[str, ...]]:
    """Take the header stamps, or the times of reception if most messages have no stamp.

    Returns
    -------
    stamps : array of int, shape (n_messages,)
        Stamps of these messages [ns], 0 for those that have none.
    notes : tuple of str
        Notes on the stamps.

    Raises
    ------
    RecordingError
        If neither is a plausible time.
    """
    headers, received = raw.header_stamps[messages], raw.receive_stamps[messages]
    stamped = headers > 0
    if 2 * count(stamped) > stamped.size and _plausible(headers[stamped]):
        if abs(int(headers[stamped][0] - received[stamped][0])) > YEAR_NS:
            return headers, (SIMULATION_TIME,)
        return headers, ()
    if _plausible(received):
        return received, ("no usable header stamps: times of reception are used",)
    why = "span no plausible time" if stamped.any() else "are not set"
    raise RecordingError(
        f"there is no usable time: the header stamps {why}, and the {messages.size} messages were "
        f"received within {np.ptp(received) / 1e6:.3g} ms; record them with stamps, or as they "
        "happen"
    )


def _plausible(stamps: IntArray) -> bool:
    """Whether joint states can have been recorded at these times."""
    return bool(
        stamps.size < 2 or stamps.size <= np.ptp(stamps) / NS_PER_S * INPUT_LIMITS.state_rate
    )


def order_by_time(samples: Samples, options: RepairOptions, repairs: Counter[str]) -> Samples:
    """Sort samples by stamp; where the clock was set back, time continues from its last value.

    Returns
    -------
    :
        Samples with times since the recording's first message [ns], not decreasing.
    """
    max_gap = options.longest_gap(samples.period)
    samples = _without_strays(samples, max_gap, repairs)
    jumps = np.flatnonzero(np.diff(samples.times) < -max_gap) + 1
    repairs["clock_jumps"] += jumps.size
    times: list[IntArray] = []
    rows: list[IntArray] = []
    for part in np.split(np.arange(samples.times.size), jumps):
        own = samples.times[part]
        repairs["out_of_order"] += count(own < np.maximum.accumulate(own))
        order = np.argsort(own, kind="stable")
        start = -min(samples.first_stamp, int(own.min()))
        if times:
            # One nanosecond more than the longest gap, so that the pieces remain separate.
            start = int(times[-1][-1]) + int(max_gap) + 1 - int(own.min())
        times.append(own[order] + start)
        rows.append(part[order])
    return replace(samples.taken(np.concatenate(rows)), times=np.concatenate(times))


def _without_strays(samples: Samples, max_gap: float, repairs: Counter[str]) -> Samples:
    """Drop samples with a single wrong stamp between good ones, which would fake two jumps."""
    stamps = samples.times
    far = np.abs(np.diff(stamps)) > max_gap
    near_across = np.abs(stamps[2:] - stamps[:-2]) <= max_gap
    stray = np.zeros(stamps.size, dtype=bool)
    stray[1:-1] = far[:-1] & far[1:] & near_across
    repairs["stray_stamps"] += count(stray)
    kept = samples.taken(np.flatnonzero(~stray))
    kept.refuse_few()
    return kept
