# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions cut out of a recording, by their speeds or by a table that a person made.

Such a table is a CSV file with columns recording,start_time_s,end_time_s and perhaps label.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names, unknown_name
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from .demonstration import Demonstration
from .recording import Recording, Samples, Segment
from .segmentation import (
    MIN_EXTENT,
    MOVING_RATIO,
    SegmentationOptions,
    SmoothPiece,
    SpeedThresholds,
    extent,
    find_motions,
    joint_speed,
    least_extent,
    smooth,
    speed_thresholds,
    trim,
)

# A motion covers more than this share of the extent of the recording's largest.
_EXTENT_RATIO = 0.1


@dataclass(frozen=True, eq=False)
class Cut:
    """A motion: the piece that contains it, its first and last step, its label."""

    piece: SmoothPiece
    first: int
    last: int
    label: str = ""

    @property
    def extent(self) -> float:
        """Norm over the joints of the distance that each of them covers [rad or m]."""
        return extent(self.piece.positions[self.first : self.last + 1])

    @property
    def is_cut_off(self) -> bool:
        """Whether the piece begins or ends within the motion."""
        return self.begins_cut_off or self.ends_cut_off

    @property
    def begins_cut_off(self) -> bool:
        """Whether the piece begins within the motion."""
        return self.first == 0 and self._moves_at(self.first)

    @property
    def ends_cut_off(self) -> bool:
        """Whether the piece ends within the motion."""
        return self.last == self.piece.times.size - 1 and self._moves_at(self.last)

    def _moves_at(self, step: int) -> bool:
        speed = joint_speed(self.piece.velocities[self.first : self.last + 1])
        return bool(speed[step - self.first] > MOVING_RATIO * speed.max())

    def demonstration(self, joint_names: tuple[str, ...], **about: Any) -> Demonstration:
        """The motion as a demonstration, see :meth:`.Demonstration.of_piece`."""
        span = self.piece, self.first, self.last
        return Demonstration.of_piece(joint_names, *span, label=self.label, **about)


def smoothed(recording: Recording) -> tuple[list[SmoothPiece], SpeedThresholds]:
    """The smoothed pieces of a repaired recording, and the speeds of its rests and motions."""
    pieces = [smooth(piece, recording.sample_rate) for piece in recording.pieces]
    speed = np.concatenate([joint_speed(piece.velocities) for piece in pieces])
    return pieces, speed_thresholds(speed)


def cut_motions(
    recording: Recording,
    pieces: Sequence[SmoothPiece],
    thresholds: SpeedThresholds,
    options: SegmentationOptions,
    least_of_set: float = 0.0,
    *,
    is_whole: bool = False,
) -> tuple[list[Cut], tuple[str, ...], dict[str, int]]:
    """Cut a recording into its motions.

    Parameters
    ----------
    recording :
        The repaired recording.
    pieces, thresholds :
        Its smoothed pieces, and the speeds of its rests and motions, see :func:`smoothed`.
    options :
        Shortest rest and motion.
    least_of_set :
        Smallest extent of a motion by those of all recordings [rad or m].
    is_whole :
        Whether each piece is one motion, without the stillness at both ends.

    Returns
    -------
    cuts : list of Cut
        The motions.
    notes : tuple of str
        What is left out, and where hesitations cut.
    counts : dict
        How many movements are rest.

    Raises
    ------
    RecordingError
        If all movements are within the extent of noise and sway.
    """
    notes: tuple[str, ...] = ()
    if is_whole:
        spans = [(piece, trim(piece, thresholds)) for piece in pieces]
        large = [Cut(piece, *span) for piece, span in spans if span is not None]
        notes = _rests_at_ends(large)
    else:
        every = [
            Cut(piece, *span)
            for piece in pieces
            for span in find_motions(piece, thresholds, options)
        ]
        largest = max((cut.extent for cut in every), default=0.0)
        large = [cut for cut in every if cut.extent > _EXTENT_RATIO * largest]
        if len(large) < len(every):
            notes = (
                f"{len(every) - len(large)} motions over less than {_EXTENT_RATIO:.0%} of the "
                "extent of the largest are left out",
            )
    moved = _without_rest(large, recording.pieces, least_of_set)
    return moved, (*notes, *_hesitations(moved)), {"rest": len(large) - len(moved)}


def _rests_at_ends(cuts: Sequence[Cut]) -> tuple[str, ...]:
    """A note on the rests that are cut at the ends of pieces."""
    rests = [
        (x.piece.times[-1] - x.piece.times[0]) - (x.last - x.first) / x.piece.rate for x in cuts
    ]
    n = sum(rest > 0.5 / x.piece.rate for rest, x in zip(rests, cuts, strict=True))
    if not n:
        return ()
    return (f"rests cut at the ends of {n} of {len(cuts)} motions: {max(rests):.2g} s at most",)


def _hesitations(cuts: Sequence[Cut]) -> tuple[str, ...]:
    """A note on the cuts between motions without a rest between them."""
    pairs = [(a, b) for a, b in pairwise(cuts) if a.piece is b.piece and a.last == b.first]
    if not pairs:
        return ()
    shortest = min((one.last - one.first) / one.piece.rate for pair in pairs for one in pair)
    return (
        f"{len(pairs)} cuts at hesitations, where the speed has a valley (shortest motion beside "
        f"them {shortest:.2g} s): to cut at rests alone, pass --cut rests",
    )


def without_cut_off(
    cuts: Sequence[Cut], pieces: Sequence[SmoothPiece], *, whole: bool
) -> list[Cut]:
    """Leave out motions that lack their start or their end.

    Parameters
    ----------
    cuts :
        The motions of a recording.
    pieces :
        Its pieces.
    whole :
        Whether each piece is one motion. It begins and ends with the recording then, at any speed,
        and only gaps and jumps cut it off.

    Raises
    ------
    RecordingError
        If none is left.
    """
    # Of a recording without gaps that is one motion from its first to its last sample, both ends
    # are those of the motion.
    spans = [(cut.first, cut.last) for cut in cuts if len(pieces) == 1]
    whole = whole or spans == [(0, pieces[0].times.size - 1)]
    kept = []
    for cut in cuts:
        at_start = whole and cut.piece is pieces[0]
        at_end = whole and cut.piece is pieces[-1]
        is_torn = cut.begins_cut_off and not at_start
        if not is_torn and (at_end or not cut.ends_cut_off):
            kept.append(cut)
    if cuts and not kept:
        raise RecordingError(
            f"an end of the recording, a gap or a jump cuts off each of its motions ({len(cuts)}): "
            "record from rest to rest; if the recording is one motion without rests, pass "
            "--segment none (segment='none' in Python)"
        )
    return kept


def count_short_halves(
    pieces: Sequence[SmoothPiece], thresholds: SpeedThresholds, cuts: Sequence[Cut]
) -> int:
    """Number of motions at ends of pieces of which too little is left to be one of the cuts."""
    ends = {(id(cut.piece), step) for cut in cuts for step in (cut.first, cut.last)}
    n = 0
    for piece in pieces:
        speed = joint_speed(piece.velocities)
        for step in (0, speed.size - 1):
            n += bool(speed[step] > thresholds.moving and (id(piece), step) not in ends)
    return n


def cut_row(pieces: Sequence[SmoothPiece], row: Segment) -> Cut:
    """Cut the motion of a row of a table of segments.

    Raises
    ------
    RecordingError
        If it is not within a piece.
    """
    for piece in pieces:
        first, last = (
            round((time - float(piece.times[0])) * piece.rate) for time in (row.start, row.end)
        )
        # A last time that was rounded up may be a little behind the last sample.
        if first >= 0 and first < last <= piece.times.size:
            return Cut(piece, first, min(last, piece.times.size - 1), row.label)
    spans = ", ".join(f"{p.times[0]:.3f} s to {p.times[-1]:.3f} s" for p in pieces)
    raise RecordingError(
        f"{row.where}: {row.start:g} s to {row.end:g} s is not within the "
        f"recording, which has samples from {spans}"
    )


def _without_rest(cuts: Sequence[Cut], pieces: Sequence[Samples], least_of_set: float) -> list[Cut]:
    """Leave out movements within the extent of noise and sway, or small beside the set's motions.

    Raises
    ------
    RecordingError
        If none is left.
    """
    least = max(least_extent(pieces), least_of_set)
    kept = [cut for cut in cuts if cut.extent > least]
    if cuts and not kept:
        if least == least_of_set:
            why = "by the extent of the other recordings' motions"
        else:
            sways = least <= MIN_EXTENT
            why = "as an arm that is held still sways" if sways else "by its noise"
        raise RecordingError(
            f"it holds no motion: its joints move over {max(cut.extent for cut in cuts):.2g} rad "
            f"(or m) at most, and up to {least:.2g} counts as rest, {why}; give a table of "
            "segments if these movements are motions"
        )
    return kept


Overview = tuple[FloatArray, FloatArray, FloatArray]
"""A whole recording in few samples, for a figure.

Its times since the first message [s], shape (n_samples,), NaN between the pieces; its joint
positions [rad or m], shape (n_samples, n_joints); the highest norm of the joint velocities up to
the next sample [rad/s or m/s], shape (n_samples,).
"""


def overview(pieces: Sequence[SmoothPiece]) -> Overview:
    """About 1000 samples of a recording, the resolution of a figure, see `Overview`."""
    k = max(1, sum(piece.times.size for piece in pieces) // 1000)
    parts = []
    for piece in pieces:
        chosen = np.arange(0, piece.times.size, k)
        speed = np.maximum.reduceat(joint_speed(piece.velocities), chosen)
        columns = (piece.times[chosen], piece.positions[chosen], speed)
        parts.append(np.column_stack(columns))
        parts.append(np.full((1, parts[0].shape[1]), np.nan))
    table = np.concatenate(parts)
    return table[:, 0], table[:, 1:-1], table[:, -1]


COLUMNS = ("recording", "start_time_s", "end_time_s")


def read_segments(path: str | Path, recordings: Collection[str]) -> dict[str, list[Segment]]:
    """Read the segments of each recording.

    Parameters
    ----------
    path :
        A CSV file with a header line. Other columns than those needed and `label` are ignored.
    recordings :
        The names that may occur.

    Returns
    -------
    :
        Segments by the name of the recording, in the order of the rows.

    Raises
    ------
    RecordingError
        If the file can't be read, lacks a column, or a row names no given recording or holds no
        time span; with the number of the line.
    """
    segments: dict[str, list[Segment]] = {}
    with reading(f"'{path}'", RecordingError):
        rows = csv.DictReader(io.StringIO(read_text(path), newline=""))
        missing = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
        if missing:
            raise RecordingError(
                f"'{path}' lacks the columns {quote_names(missing)}: its first line must name "
                f"{quote_names(COLUMNS)}"
            )
        for number, row in enumerate(rows):
            if number == INPUT_LIMITS.segments:
                raise RecordingError(f"'{path}' has more than {number:,} rows: split it")
            where = f"'{path}', line {rows.line_num}"
            name = row["recording"] or ""
            if name not in recordings:
                raise RecordingError(f"{where}: {unknown_name('recording', name, recordings)}")
            segments.setdefault(name, []).append(_segment(row, where))
    return segments


def _segment(row: dict[str, str], where: str) -> Segment:
    texts, latest = [row[name] or "" for name in COLUMNS[1:]], INPUT_LIMITS.segment_time
    try:
        start, end = map(float, texts)
    except ValueError:
        start = end = math.nan
    if not 0.0 <= start < end <= latest:
        raise RecordingError(
            f"{where}: {quote_names(COLUMNS[1:])} must be numbers of seconds, the second one "
            f"larger, from 0 to {latest:g}, got {quote_names(texts)}"
        )
    return Segment(start, end, row.get("label") or "", where=where)


def segments_table(motions: Iterable[tuple[str, float, float, str]]) -> bytes:
    """Write a table of motions that :func:`read_segments` reads and people can edit.

    Parameters
    ----------
    motions :
        The recording, start [s], end [s] and label of each motion, in the order of the rows.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, "label"])
    # Samples are 5 ms apart or more, so a microsecond finds the same ones again.
    writer.writerows(
        [recording, f"{start:.6f}", f"{end:.6f}", label] for recording, start, end, label in motions
    )
    return text.getvalue().encode(errors="replace")
