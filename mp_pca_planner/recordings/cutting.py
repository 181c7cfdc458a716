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
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..exceptions import RecordingError, listed, quote_names, unknown_name
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from .demonstration import Demonstration
from .options import MIN_REST, LoadOptions
from .recording import Recording
from .segmentation import (
    MIN_EXTENT,
    MOVING_RATIO,
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


@dataclass(frozen=True)
class Segment:
    """A row of a table of segments.

    Attributes
    ----------
    start, end : float
        Times since the recording's first message [s].
    label : str
        Its label ('' if there is none).
    where : str
        File and line, for messages.
    """

    start: float
    end: float
    label: str
    where: str


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
    def is_cut_off(self) -> tuple[bool, bool]:
        """Whether the piece begins, and whether it ends, within the motion."""
        speed = joint_speed(self.piece.velocities[self.first : self.last + 1])
        begins, ends = (speed[[0, -1]] > MOVING_RATIO * speed.max()).tolist()
        return self.first == 0 and begins, self.last == self.piece.times.size - 1 and ends

    def demonstration(self, joint_names: tuple[str, ...], **about: Any) -> Demonstration:
        """The motion as a demonstration, see :meth:`.Demonstration.of_piece`."""
        span = self.piece, self.first, self.last
        return Demonstration.of_piece(joint_names, *span, label=self.label, **about)


def cut_recording(
    recording: Recording, rows: Sequence[Segment] | None, options: LoadOptions
) -> Recording:
    """Cut a recording into motions; the result has these in place of the samples.

    Parameters
    ----------
    recording :
        The repaired recording.
    rows :
        The motions of a table of segments, if there is one.
    options :
        How it is cut otherwise.

    Raises
    ------
    RecordingError
        If it holds no whole motion.
    """
    pieces, thresholds = smoothed(recording)
    if rows is None:
        cuts, recording = cut_motions(recording, pieces, thresholds, options)
        if not recording.episodes:
            cuts, n_lost = _without_cut_off(cuts, pieces, thresholds, options)
            recording = recording.noted(cut_off=n_lost)
        elif still := [x for x in pieces if all(cut.piece is not x for cut in cuts)]:
            names = listed([str(recording.episode_at(x.times[0])) for x in still])
            recording = recording.noted(f"episodes without motion: {names}")
    else:
        cuts = [_cut_row(pieces, row) for row in rows]
    if not cuts:
        raise RecordingError("no motion was found in it")
    motions = tuple(
        x.demonstration(
            recording.joint_names,
            recording=recording.name,
            checksum=recording.checksum,
            episode=recording.episode_at(x.piece.times[0]),
        )
        for x in cuts
    )
    return replace(
        recording,
        pieces=(),
        notes=recording.all_notes,
        motions=motions,
        thresholds=thresholds,
        overview=_overview(pieces),
    )


def smoothed(recording: Recording) -> tuple[list[SmoothPiece], SpeedThresholds]:
    """The smoothed pieces of a repaired recording, and the speeds of its rests and motions."""
    pieces = [smooth(piece, recording.sample_rate) for piece in recording.pieces]
    speed = np.concatenate([joint_speed(piece.velocities) for piece in pieces])
    return pieces, speed_thresholds(speed)


def cut_motions(
    recording: Recording,
    pieces: Sequence[SmoothPiece],
    thresholds: SpeedThresholds,
    options: LoadOptions,
) -> tuple[list[Cut], Recording]:
    """Cut a recording into its motions, also those that lack their start or end.

    Parameters
    ----------
    recording :
        The repaired recording.
    pieces, thresholds :
        Its smoothed pieces, and the speeds of its rests and motions, see :func:`smoothed`.
    options :
        Of these `segment`, `cut` and `min_rest`.

    Returns
    -------
    cuts : list of Cut
        The motions.
    recording : Recording
        With notes on what is left out.

    Raises
    ------
    RecordingError
        If all movements are within the extent of noise and sway.
    """
    if _is_whole(recording, options):
        spans = [(piece, trim(piece, thresholds)) for piece in pieces]
        large = [Cut(piece, *span) for piece, span in spans if span is not None]
        recording = recording.noted(*_rests_at_ends(large))
    else:
        valleys = (options.cut or ("rests" if recording.episodes else "valleys")) == "valleys"
        min_rest = options.min_rest or MIN_REST
        every = [
            Cut(piece, *span)
            for piece in pieces
            for span in find_motions(piece, thresholds, min_rest, valleys=valleys)
        ]
        largest = max((cut.extent for cut in every), default=0.0)
        large = [cut for cut in every if cut.extent > _EXTENT_RATIO * largest]
        if n_small := len(every) - len(large):
            recording = recording.noted(
                f"{n_small} motions over less than {_EXTENT_RATIO:.0%} of the extent of the "
                "largest are left out"
            )
    least = least_extent(recording.pieces)
    moved = [cut for cut in large if cut.extent > least]
    if large and not moved:
        why = "as an arm that is held still sways" if least <= MIN_EXTENT else "by its noise"
        raise no_motion([cut.extent for cut in large], least, why)
    return moved, recording.noted(rest=len(large) - len(moved))


def no_motion(extents: Sequence[float], least: float, why: str) -> RecordingError:
    """The error for a recording whose movements [rad or m] all count as rest."""
    return RecordingError(
        f"it holds no motion: its joints move over {max(extents):.2g} rad (or m) at most, and up "
        f"to {least:.2g} counts as rest, {why}; give a table of segments if these movements are "
        "motions"
    )


def _is_whole(recording: Recording, options: LoadOptions) -> bool:
    """Whether each piece is one motion, without the stillness at both ends."""
    return options.segment == "none" or (bool(recording.episodes) and not options.cuts)


def _rests_at_ends(cuts: Sequence[Cut]) -> tuple[str, ...]:
    """A note on the rests that are cut at the ends of pieces."""
    rests = [
        (x.piece.times[-1] - x.piece.times[0]) - (x.last - x.first) / x.piece.rate for x in cuts
    ]
    n = sum(rest > 0.5 / x.piece.rate for rest, x in zip(rests, cuts, strict=True))
    if not n:
        return ()
    return (f"rests cut at the ends of {n} of {len(cuts)} motions: {max(rests):.2g} s at most",)


def _without_cut_off(
    cuts: Sequence[Cut],
    pieces: Sequence[SmoothPiece],
    thresholds: SpeedThresholds,
    options: LoadOptions,
) -> tuple[list[Cut], int]:
    """The motions that have their start and end, and the number of those that lack one.

    Raises
    ------
    RecordingError
        If none is left.
    """
    # A recording that is not to be cut, or that is one motion from its first to its last sample,
    # begins and ends with the motion, at any speed. Only gaps and jumps cut it off.
    is_one = len(pieces) == 1 and [(x.first, x.last) for x in cuts] == [
        (0, pieces[0].times.size - 1)
    ]
    whole = is_one or options.segment == "none"
    kept = []
    for x in cuts:
        begins, ends = x.is_cut_off
        begins = begins and not (whole and x.piece is pieces[0])
        ends = ends and not (whole and x.piece is pieces[-1])
        if not begins and not ends:
            kept.append(x)
    if cuts and not kept:
        raise RecordingError(
            f"an end of the recording, a gap or a jump cuts off each of its motions ({len(cuts)}): "
            "record from rest to rest; if the recording is one motion without rests, pass "
            "--segment none (segment='none' in Python)"
        )
    n_lost = len(cuts) - len(kept)
    if options.segment != "none":
        # Of some, too little is left at the end of a piece to be one of the cuts.
        known = {(id(x.piece), step) for x in cuts for step in (x.first, x.last)}
        for piece in pieces:
            speed = joint_speed(piece.velocities)
            ends_of_piece = [step for step in (0, speed.size - 1) if (id(piece), step) not in known]
            n_lost += int((speed[ends_of_piece] > thresholds.moving).sum())
    return kept, n_lost


def _cut_row(pieces: Sequence[SmoothPiece], row: Segment) -> Cut:
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


Overview = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""A whole recording in few samples, for a figure.

Its times since the first message [s], shape (n_samples,), NaN between the pieces; its joint
positions [rad or m], shape (n_samples, n_joints); the highest norm of the joint velocities up to
the next sample [rad/s or m/s], shape (n_samples,). All in single precision.
"""


def _overview(pieces: Sequence[SmoothPiece]) -> Overview:
    """At most 1000 samples of a long recording, the resolution of a figure, see `Overview`."""
    k = ceil(sum(piece.times.size for piece in pieces) / 1000)
    parts = []
    for piece in pieces:
        chosen = np.arange(0, piece.times.size, k)
        speed = np.maximum.reduceat(joint_speed(piece.velocities), chosen)
        columns = (piece.times[chosen], piece.positions[chosen], speed)
        parts.append(np.column_stack(columns))
        parts.append(np.full((1, parts[0].shape[1]), np.nan))
    table = np.concatenate(parts).astype(np.float32)
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
    return Segment(start, end, row.get("label") or "", where)


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
