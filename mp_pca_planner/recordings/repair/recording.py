# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repaired recordings: their pieces, the counted repairs and notes on what was found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...exceptions import RecordingError, UnusableRecordingError, quote_names

REPAIRS = {
    "malformed": "message dropped: not one position for each name, a name listed twice, or "
    "points whose times don't increase",
    "missing_joints": "message dropped: it lacks a chosen joint (another publisher's, for example)",
    "reordered": "message that lists the joints in another order than the first: taken by name",
    "non_finite": "message dropped: a position of a chosen joint (or the duration of a commanded "
    "motion) is NaN, infinite or absurd",
    "unstamped": "message dropped: no header stamp, while most have one",
    "stray_stamps": "message dropped: its stamp is far from those before and after it",
    "clock_jumps": "stamps step back by more than the longest gap: cut there",
    "out_of_order": "message with an earlier stamp than one before it: sorted in",
    "repeated_stamps": "message dropped: another one has the same stamp and positions",
    "contradicting": "message dropped: another one has the same stamp and other positions",
    "gaps": "no message for longer than the longest gap: cut there",
    "zeros": "message dropped: zeros that alternate with positions (a driver without data)",
    "wrapped": "jump of a joint by full turns: removed",
    "spikes": "message dropped: a joint is farther away in it than a motor could move it",
    "jumps": "a joint moves faster than a motor could: cut there",
    "replaced": "commanded motion cut short: another one started before its end",
    "single_points": "single-point trajectory without a known start: dropped",
    "short_pieces": "piece between cuts dropped: too few samples",
    "rest": "movement dropped: within the extent of noise and sway, taken for rest",
}
"""Kinds of repairs, by the name under which they are counted."""

MIN_SAMPLES = 10
"""Least number of samples of a motion."""

MIN_TRAVEL = 1e-3
"""A joint that travels less than this is still; it is about the noise of encoders [rad or m]."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Samples without interruption.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times since the recording's first message [s], strictly increasing.
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m], unwrapped.
    """

    times: FloatArray
    positions: FloatArray

    def cut(self, places: Sequence[int]) -> list[Piece]:
        """Parts of the piece, each from one of the places (indices of samples) to the next."""
        parts = zip(np.split(self.times, places), np.split(self.positions, places), strict=True)
        return [Piece(times, positions) for times, positions in parts]


@dataclass(frozen=True, eq=False)
class CleanRecording:
    """Repaired samples of the chosen joints.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    pieces : tuple of Piece
        The samples between gaps and clock jumps, in order of time.
    rate : float
        The usual rate [Hz]: one over the median period.
    sample_rate : float
        Rate of the samples in the pieces [Hz]; lower than `rate` where samples were averaged.
    duration : float
        Time from the first to the last sample [s].
    repairs : dict
        Counts of the repairs that were made, by their names in :data:`REPAIRS`.
    notes : tuple of str
        Findings that needed no repair, one sentence each.
    topic : str
        The topic that was read.
    n_messages : int
        Number of its messages.
    listed_joints : tuple of str
        All joints that its messages list.
    pieces_are_motions : bool
        Whether each piece is one motion, which is not segmented.
    """

    joint_names: tuple[str, ...]
    pieces: tuple[Piece, ...]
    rate: float
    sample_rate: float
    duration: float
    repairs: dict[str, int]
    notes: tuple[str, ...]
    topic: str
    n_messages: int
    listed_joints: tuple[str, ...]
    pieces_are_motions: bool = False


@contextmanager
def findings_on_refusal(raw: Any, repairs: Counter[str]) -> Iterator[None]:
    """Add the facts on the messages and the repairs until then to an error."""
    try:
        yield
    except RecordingError as error:
        raise UnusableRecordingError(
            str(error),
            counted(repairs),
            raw.topic,
            raw.n_messages,
            raw.listed_joints,
            raw.notes,
        ) from None


def counted(repairs: Counter[str]) -> dict[str, int]:
    """Counts of the repairs that were made, in the order of :data:`REPAIRS`."""
    return {kind: repairs[kind] for kind in REPAIRS if repairs[kind]}


def motion_notes(names: tuple[str, ...], pieces: Sequence[Piece]) -> tuple[str, ...]:
    """Notes on joints that never move, and on motions that are cut off at an end."""
    low = np.min([piece.positions.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.positions.max(axis=0) for piece in pieces], axis=0)
    still = [name for name, travel in zip(names, high - low, strict=True) if travel < MIN_TRAVEL]
    notes = [f"joints that never move: {quote_names(still)}"] if still else []
    speeds = [_window_speeds(piece) for piece in pieces]
    # At a fifth of the highest speed a joint is within its motion.
    fast = 0.2 * max(float(speed.max()) for speed in speeds)
    for speed, what in ((speeds[0][0], "begins"), (speeds[-1][-1], "ends")):
        if speed > fast:
            notes.append(f"the recording {what} in a motion, which may be cut off there")
    return tuple(notes)


def _window_speeds(piece: Piece) -> FloatArray:
    """Norm of the joint speeds over windows of about 0.1 s, in order of time [/s]."""
    n_windows = max(1, round((piece.times[-1] - piece.times[0]) / 0.1))
    edges = np.linspace(0, piece.times.size - 1, min(n_windows, piece.times.size - 1) + 1)
    marks = edges.round().astype(np.int64)
    distance = np.linalg.norm(np.diff(piece.positions[marks], axis=0), axis=1)
    return np.asarray(distance / np.diff(piece.times[marks]), dtype=np.float64)


def refuse_stillness(pieces: Sequence[Piece]) -> None:
    """Reject pieces in which no joint moves.

    Raises
    ------
    RecordingError
        If no joint travels `MIN_TRAVEL`.
    """
    travel = max(float(np.ptp(piece.positions, axis=0).max()) for piece in pieces)
    if travel < MIN_TRAVEL:
        raise RecordingError(
            f"nothing moves: no chosen joint travels more than {travel:.2g} rad (or m)"
        )
