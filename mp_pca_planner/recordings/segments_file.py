# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of motions cut by hand: CSV files with columns recording,start_time_s,end_time_s."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..exceptions import RecordingError, quote_names, unknown_name
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS

COLUMNS = ("recording", "start_time_s", "end_time_s")


@dataclass(frozen=True)
class SegmentRow:
    """Row of a table of segments.

    Attributes
    ----------
    start, end : float
        Times since the recording's first message [s].
    label : str
        Content of the column `label` ('' if there is none).
    where : str
        File and line, for messages.
    """

    start: float
    end: float
    label: str
    where: str


def read_segments(path: str | Path, recordings: Collection[str]) -> dict[str, list[SegmentRow]]:
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
        If the file can't be read, lacks a column, or a row names no given recording, holds no
        time span, or repeats another one; with the number of the line.
    """
    segments: dict[str, list[SegmentRow]] = {}
    seen: dict[tuple[str, float, float, str], str] = {}
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
            segment = _segment(row, where)
            first = seen.setdefault((name, segment.start, segment.end, segment.label), where)
            if first != where:
                raise RecordingError(f"{where}: this row repeats {first}: remove one")
            segments.setdefault(name, []).append(segment)
    return segments


def _segment(row: dict[str, str], where: str) -> SegmentRow:
    start, end = (_seconds(row[name], name, where) for name in COLUMNS[1:])
    latest = INPUT_LIMITS.segment_time
    if not 0.0 <= start < end <= latest:
        raise RecordingError(
            f"{where}: a motion must start at 0 s or later and end after its start, "
            f"at {latest:g} s at the latest, got {start:g} s to {end:g} s"
        )
    return SegmentRow(start, end, row.get("label") or "", where)


def _seconds(text: str | None, column: str, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordingError(f"{where}: '{column}' must be a number of seconds, got '{text or ''}'")
    return value


def segments_table(motions: Iterable[Any]) -> bytes:
    """Write a table of motions that :func:`read_segments` reads and people can edit.

    Parameters
    ----------
    motions :
        The motions, in the order of the rows, with `recording`, `start_time`, `end_time` [s] and
        `label`; demonstrations, for example.

    Raises
    ------
    RecordingError
        If the name of a recording can't be written in UTF-8.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, "label"])
    # Samples are 5 ms apart or more, so a microsecond finds the same ones again.
    writer.writerows(
        [m.recording, f"{m.start_time:.6f}", f"{m.end_time:.6f}", m.label] for m in motions
    )
    try:
        return text.getvalue().encode()
    except UnicodeEncodeError as error:
        raise RecordingError(f"a table of segments can't be written in UTF-8: {error}") from None


def segments_by_hand(
    path: str | Path | None, labels: Sequence[str] | None, names: Sequence[str]
) -> dict[str, list[SegmentRow]] | None:
    """The rows of a table with some labels, by recording; None if there is no table.

    Parameters
    ----------
    path :
        The table, see :func:`read_segments`.
    labels :
        The labels; all by default.
    names :
        Names of the recordings.

    Raises
    ------
    RecordingError
        If the table is malformed, or no row has one of the labels.
    """
    if path is None:
        if labels is not None:
            raise RecordingError("labels select motions of a table of segments: also give one")
        return None
    by_hand = read_segments(path, names)
    if labels is None:
        return by_hand
    known = sorted({row.label for rows in by_hand.values() for row in rows} - {""})
    for label in labels:
        if label not in known:
            raise RecordingError(f"'{path}': {unknown_name('label', label, known)}")
    return {name: [row for row in rows if row.label in labels] for name, rows in by_hand.items()}
