# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states of tables: CSV files, and datasets of LeRobot (Parquet)."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, unique_names
from ..exceptions import RecordingError, quote_names, require, unknown_name
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from .demonstration import milliseconds_note
from .joint_states import NS_PER_S, JointLayout, RawJointStates
from .repair import CleanRecording

FORMATS = ("csv", "lerobot")
"""Formats of tables among those of recordings."""

STATE = "observation.state"
"""The column of a LeRobot dataset that is read by default."""

_TIMES = ("time", "t", "time_s", "timestamp", "stamp")
_POSITIONS = (".positions", ".position", ".pos")
_OTHERS = (".velocities", ".accelerations", ".efforts", ".velocity", ".effort")
_VERSIONS = ("v2.", "v3.")
_INFO = "meta/info.json"
_PAUSE = 10.0  # s between episodes, which have times of their own


def read_table(
    path: Path,
    table_format: str,
    column: str | None = None,
    joints: Sequence[str] | None = None,
    max_gap: float = 0.0,
) -> RawJointStates:
    """Read the joint states of a table.

    Parameters
    ----------
    path : Path
        A CSV file, whose first line names the time [s] and the joints, or the folder of a dataset.
    table_format : str
        One of `FORMATS`.
    column : str, optional
        Column of a LeRobot dataset, see :data:`STATE`.
    joints : sequence of str, optional
        Names for the values of a dataset that names none.
    max_gap : float
        Longest time without samples that is no gap [s]. The episodes of a dataset follow each other
        with a gap between them.

    Raises
    ------
    RecordingError
        If it can't be read, or is no such table.
    """
    if table_format == "lerobot":
        return _read_dataset(path, column or STATE, joints, _PAUSE + 2.0 * max_gap)
    if column is not None:
        raise RecordingError("--topic is for bags and LeRobot datasets: a CSV file has no topics")
    return _read_csv(path)


def _read_csv(path: Path) -> RawJointStates:
    with reading(f"the table '{path}'", RecordingError):
        head, _, rows = read_text(path, INPUT_LIMITS.unpacked_bytes).partition("\n")
    header = [name.strip().strip('"') for name in head.split(",")]
    if header[0].lower() not in _TIMES or len(header) < 2:
        raise RecordingError(
            f"the first line of '{path}' must name its columns, the first of them one of "
            f"{quote_names(_TIMES)}, then the joints; it is '{head[:100]}'"
        )
    if not rows.strip():
        raise RecordingError(f"'{path}' holds no samples")
    # Some programs write an unknown number as an empty cell; repair drops it.
    rows = re.sub(r"(?<=,)(?=[ \t\r]*(?:,|$))", "nan", rows, flags=re.MULTILINE)
    with reading(f"the table '{path}'", RecordingError):
        values = np.loadtxt(io.StringIO(rows), delimiter=",", ndmin=2, dtype=np.float64)
    if values.shape[1] != len(header):
        raise RecordingError(
            f"'{path}' has {len(header)} names in its first line, but {values.shape[1]} columns"
        )
    columns = [i for i, name in enumerate(header) if i > 0 and not name.endswith(_OTHERS)]
    names = _without_suffix([header[i] for i in columns])
    return _joint_states(path.name, names, values[:, 0], values[:, columns])


def _read_dataset(
    path: Path, column: str, joints: Sequence[str] | None, pause: float
) -> RawJointStates:
    with reading(f"'{path / _INFO}'", RecordingError):
        info = json.loads(read_text(path / _INFO))
        version, features = str(info["codebase_version"]), dict(info["features"])
    if not version.startswith(_VERSIONS):
        raise RecordingError(
            f"'{path}' is a LeRobot dataset of version '{version}': expected v2.0, v2.1 or v3.0"
        )
    vectors = [name for name, one in features.items() if _is_vector(one)]
    if column not in vectors:
        raise RecordingError(f"'{path}': {unknown_name('column of numbers', column, vectors)}")
    episodes, times, positions = _read_parquet(path, column)
    named = _names(features[column])
    notes: tuple[str, ...] = ()
    if named is None:
        named, notes = _given_names(column, positions.shape[1], joints)
    if len(named) != positions.shape[1]:
        raise RecordingError(
            f"'{path}' names {len(named)} joints of '{column}', but it has {positions.shape[1]} "
            "values"
        )
    times = _one_after_the_other(episodes, times, pause)
    return _joint_states(column, _without_suffix(named), times, positions, notes)


def _read_parquet(path: Path, column: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Episode, time [s] and values of each frame, episode by episode."""
    parquet = require("pyarrow.parquet", "lerobot", "reading a LeRobot dataset")
    files = sorted(path.glob("data/*/*.parquet"))
    if not files:
        raise RecordingError(f"'{path}' holds no data/*/*.parquet: download the whole dataset")
    parts = []
    for file in files:
        with reading(f"'{file}'", RecordingError):
            table = parquet.read_table(file, columns=["episode_index", "timestamp", column])
            rows = np.array(table[column].to_pylist(), dtype=np.float64)
            keys = [table[name].to_numpy() for name in ("episode_index", "timestamp")]
            parts.append(np.column_stack([*keys, rows.reshape(len(keys[0]), -1)]))
    if len({part.shape[1] for part in parts}) > 1:
        raise RecordingError(f"the files of '{path}' differ in the length of '{column}'")
    frames = np.concatenate(parts)
    frames = frames[np.argsort(frames[:, 0], kind="stable")]
    return frames[:, 0], frames[:, 1], frames[:, 2:]


def _one_after_the_other(episodes: FloatArray, times: FloatArray, pause: float) -> FloatArray:
    """Times of episodes that follow each other with a pause [s]."""
    starts = np.flatnonzero(np.diff(episodes, prepend=np.nan))
    result, end = np.empty(len(times)), -pause
    for first, last in zip(starts, [*starts[1:], len(times)], strict=True):
        own = times[first:last]
        result[first:last] = end + pause + own - own[0]
        end = float(np.max(result[first:last]))
    return result


def whole_episodes(clean: CleanRecording) -> CleanRecording:
    """The episodes of a dataset as motions, without those that gaps or jumps cut.

    Raises
    ------
    RecordingError
        If none is left.
    """
    pieces = clean.pieces
    pauses = [b.times[0] - a.times[-1] for a, b in pairwise(pieces)]
    # Times are rounded to nanoseconds.
    ends = [True, *(pause > _PAUSE - 1e-6 for pause in pauses), True]
    whole = [piece for i, piece in enumerate(pieces) if ends[i] and ends[i + 1]]
    if not whole:
        raise RecordingError(
            f"gaps or jumps cut each of its {sum(ends) - 1} episodes: no motion is whole"
        )
    n_torn = sum(ends) - 1 - len(whole)
    counts = {**clean.repairs, "gaps": ends.count(False), "cut_off": n_torn}
    repairs = {kind: n for kind, n in counts.items() if n}
    return replace(clean, pieces=tuple(whole), repairs=repairs, pieces_are_motions=True)


def _is_vector(feature: Any) -> bool:
    is_known = isinstance(feature, Mapping) and feature.get("dtype") in ("float32", "float64")
    return is_known and len(feature.get("shape", ())) == 1


def _names(feature: Mapping[str, Any]) -> list[str] | None:
    """Names of the values, which are a list or lists by kind; None if they have none."""
    names = feature.get("names")
    if isinstance(names, Mapping):
        names = [name for group in names.values() for name in group]
    return [str(name) for name in names] if names else None


def _given_names(
    column: str, n_values: int, joints: Sequence[str] | None
) -> tuple[list[str], tuple[str, ...]]:
    if joints is None or len(joints) != n_values:
        raise RecordingError(
            f"the dataset doesn't name the {n_values} values of '{column}': give their names, in "
            "order, as --joints"
        )
    note = f"'{column}' has no names: its values are taken to be {quote_names(joints)}, in order"
    return list(joints), (note,)


def _without_suffix(names: Sequence[str]) -> tuple[str, ...]:
    """Names of joints: columns may be called NAME.pos, as LeRobot's, or NAME.positions."""
    for suffix in _POSITIONS:
        names = [name.removesuffix(suffix) for name in names]
    return unique_names(names, "columns of the table", RecordingError)


def _joint_states(
    topic: str,
    names: tuple[str, ...],
    times: FloatArray,
    positions: FloatArray,
    notes: tuple[str, ...] = (),
) -> RawJointStates:
    if not times.size:
        raise RecordingError(f"'{topic}' holds no samples")
    if not (np.isfinite(times).all() and np.ptp(times) < INPUT_LIMITS.segment_time):
        raise RecordingError(f"the times of '{topic}' must be finite numbers of seconds")
    notes += tuple(filter(None, [milliseconds_note(topic, times)]))
    # A stamp of 0 would mean that it is not set.
    stamps = np.rint((times - times.min()) * NS_PER_S).astype(np.int64) + NS_PER_S
    layout = JointLayout(names, np.arange(len(times), dtype=np.int64), positions)
    return RawJointStates(topic, stamps, stamps, (layout,), 0, notes, computed=True)
