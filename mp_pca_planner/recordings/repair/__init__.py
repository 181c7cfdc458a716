# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of recorded joint states, of messages and of the motion in them.

A recording is read whole, then the repairs are applied in a fixed order. Each is counted under its
name in `REPAIRS`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..joint_states import NS_PER_S, RawJointStates
from .messages import (
    choose_clock,
    choose_joints,
    drop_equal_stamps,
    drop_unusable,
    drop_zeros,
    joined_notes,
    left_out_notes,
    order_by_time,
    refuse_late_contradictions,
    take_joints,
)
from .motion import averaged, cut_at_gaps, cut_at_jumps, long_pieces, unwrap, velocity_notes
from .recording import (
    REPAIRS,
    CleanRecording,
    Piece,
    RepairOptions,
    Samples,
    findings,
    findings_on_refusal,
    motion_findings,
)

__all__ = ["REPAIRS", "CleanRecording", "Piece", "RepairOptions", "repair"]

SAMPLE_REPAIRS = (
    drop_unusable,
    order_by_time,
    refuse_late_contradictions,
    drop_equal_stamps,
    drop_zeros,
)
"""Repairs before the recording is cut, in order."""


def repair(
    raw: RawJointStates, joints: Sequence[str] | None = None, options: RepairOptions | None = None
) -> CleanRecording:
    """Repair joint states, with a count of every repair.

    Parameters
    ----------
    raw :
        Joint states as recorded.
    joints :
        Names of the joints to take; by default those that all messages list, in the order of
        the first.
    options :
        Thresholds; by default those of :class:`RepairOptions`.

    Raises
    ------
    UnusableRecordingError
        If a joint is unknown, the time is unusable, samples are too few, publishers contradict
        each other, or nothing moves.
    """
    options = options or RepairOptions()
    repairs: Counter[str] = Counter(malformed=raw.n_malformed)
    with findings_on_refusal(raw, repairs):
        names = choose_joints([layout.joint_names for layout in raw.layouts], raw.topic, joints)
        samples, clock_notes = _samples(raw, names, options, repairs)
        for repair_samples in SAMPLE_REPAIRS:
            samples = repair_samples(samples, options, repairs)
            samples.refuse_few(options)
        pieces = cut_at_gaps(samples, options, repairs)
        pieces = cut_at_jumps(unwrap(pieces, options, repairs), options, repairs)
        checked = velocity_notes(raw, names)
        rate = NS_PER_S / samples.period
        # A rate that jitter puts just below a multiple still counts as that multiple.
        n_averaged = max(1, int(rate * 1.001 // options.enough_rate))
        pieces = long_pieces([averaged(piece, n_averaged) for piece in pieces], options, repairs)
        left_out = left_out_notes(raw, names) if joints is None else ()
        still, of_motions = motion_findings(names, pieces, options)
        notes = (*left_out, *clock_notes, *checked, *of_motions)
        return CleanRecording(
            joint_names=names,
            pieces=tuple(pieces),
            rate=rate,
            sample_rate=rate / n_averaged,
            still_joints=still,
            **findings(raw, repairs, notes),
        )


def _samples(
    raw: RawJointStates, names: tuple[str, ...], options: RepairOptions, repairs: Counter[str]
) -> tuple[Samples, tuple[str, ...]]:
    """Positions of the joints by stamp, with notes on the stamps."""
    messages, positions = take_joints(raw, names, options, repairs)
    stamps, notes = choose_clock(raw, messages)
    notes = (*joined_notes(raw, names), *notes)
    first_stamp = int(stamps[np.argmax(stamps > 0)])
    return Samples(stamps, positions, np.arange(stamps.size), first_stamp, names), notes
