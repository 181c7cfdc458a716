# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of recorded joint states, of messages and of the motion in them.

A recording is read whole, then its defects are repaired in a fixed order. A new defect is a
:class:`Defect`, with its name in `OF_SAMPLES` or `OF_PIECES`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..joint_states import NS_PER_S, RawJointStates
from .messages import (
    COUNTS,
    DISORDER,
    EQUAL_STAMPS,
    LATE,
    UNUSABLE,
    ZEROS,
    choose_clock,
    choose_joints,
    joined_notes,
    left_out_notes,
    take_joints,
)
from .motion import GAPS, JUMPS, UNITS, WRAPS, averaged, long_pieces, velocity_notes
from .recording import (
    CleanRecording,
    Piece,
    Samples,
    findings,
    findings_on_refusal,
    fingerprint,
    motion_findings,
)

__all__ = ["DROPPED", "REPAIRS", "CleanRecording", "Piece", "repair"]

OF_SAMPLES = (UNUSABLE, DISORDER, LATE, EQUAL_STAMPS, ZEROS)
"""Defects that are repaired before the recording is cut, in order."""

OF_PIECES = (WRAPS, UNITS, JUMPS)
"""Defects that are repaired once it is cut at gaps, in order."""

REPAIRS = {
    **COUNTS,
    **{kind: text for one in (*OF_SAMPLES, GAPS, *OF_PIECES) for kind, text in one.counts.items()},
    "short_pieces": "piece between cuts dropped: too few samples",
    "cut_off": "motion dropped: an end of the recording, a gap or a jump cuts it off",
    "rest": "movement dropped: within the extent of noise and sway, taken for rest",
    "turns": "motion shifted by full turns of a continuous joint, to the other motions' turn",
}
"""Kinds of repairs, by the name under which they are counted. The last four are counted where
motions are cut, or compared."""

DROPPED = {"short_pieces", "cut_off", "rest"}
"""Kinds of repairs that leave a motion out."""

# Arm motions need no higher sample rate [Hz]. Of a recording with at least twice this rate,
# consecutive samples are averaged.
_ENOUGH_RATE = 100.0


def repair(
    raw: RawJointStates, joints: Sequence[str] | None = None, max_gap: float | None = None
) -> CleanRecording:
    """Repair joint states, with a count of every repair.

    Parameters
    ----------
    raw :
        Joint states as recorded.
    joints :
        Names of the joints to take; by default those that all messages list, in the order of
        the first.
    max_gap :
        Longest time without messages that is no gap [s], see :func:`.recording.longest_gap`.

    Raises
    ------
    UnusableRecordingError
        If a joint is unknown, the time is unusable, samples are too few, publishers contradict
        each other, or nothing moves.
    """
    repairs: Counter[str] = Counter(malformed=raw.n_malformed)
    with findings_on_refusal(raw, repairs):
        names = choose_joints([layout.joint_names for layout in raw.layouts], raw.topic, joints)
        samples, clock_notes = _samples(raw, names, max_gap, repairs)
        for defect in OF_SAMPLES:
            samples = defect.repair(samples, repairs)
            samples.refuse_few()
        pieces: list[Piece] = GAPS.repair(samples, repairs)
        for defect in OF_PIECES:
            pieces = defect.repair(pieces, repairs)
        checked = velocity_notes(raw, names)
        rate = NS_PER_S / samples.period
        # A rate that jitter puts just below a multiple still counts as that multiple.
        n_averaged = max(1, int(rate * 1.001 // _ENOUGH_RATE))
        pieces = long_pieces([averaged(piece, n_averaged) for piece in pieces], repairs)
        left_out = left_out_notes(raw, names) if joints is None else ()
        still, of_motions = motion_findings(names, pieces)
        notes = (*left_out, *clock_notes, *checked, *of_motions)
        return CleanRecording(
            joint_names=names,
            pieces=tuple(pieces),
            rate=rate,
            sample_rate=rate / n_averaged,
            still_joints=still,
            fingerprint=fingerprint(samples.positions, names),
            **findings(raw, repairs, notes),
        )


def _samples(
    raw: RawJointStates, names: tuple[str, ...], max_gap: float | None, repairs: Counter[str]
) -> tuple[Samples, tuple[str, ...]]:
    """Positions of the joints by stamp, with notes on the stamps."""
    messages, positions = take_joints(raw, names, max_gap, repairs)
    stamps, notes = choose_clock(raw, messages)
    notes = (*joined_notes(raw, names), *notes)
    first_stamp = int(stamps[np.argmax(stamps > 0)])
    order = np.arange(stamps.size)
    return Samples(stamps, positions, order, first_stamp, names, max_gap), notes
