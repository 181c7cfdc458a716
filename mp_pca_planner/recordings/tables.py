# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states of tables: CSV files, and datasets of LeRobot (Parquet)."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, repeated_names, unique_names
from ..exceptions import RecordingError, listed, quote_names, require, shown, unknown_name
from ..files import open_regular, read_text, reading
from ..input_limits import INPUT_LIMITS
from ..renaming import Rename, new_name, notes_on_rename
from .demonstration import TIME_COLUMNS, other_unit_of_time
from .joint_states import NS_PER_S, JointStates
from .options import LoadOptions
from .recording import Recording

FORMATS = ("csv", "lerobot")
"""Formats of tables among those of recordings."""

STATE = "observation.state"
"""The column of a LeRobot dataset that is read by default."""

_EPISODES = ("episode_index", "episode", "episode_id", "demo", "trial")
# Names of columns that count or time the samples, and of values that are not positions.
_BOOKKEEPING = re.compile(
    r"|unnamed: \d+|index|frame|frame_index|step|task|task_index|reward|done|success|next[._].*"
    rf"|{'|'.join(_EPISODES)}|t|(time|timestamp|stamp)(_\w+)?|/.*/header/.*|field\..*",
    re.IGNORECASE,
)
_QUANTITIES = (
    "(vel|velocity|velocities|acc|accelerations?|efforts?|torques?|speeds?|forces?|currents?"
    "|temperatures?|voltages?|poses?)"
)
# Of joints, of all joints by number (joint_vel_1, actual_current_0), or of one joint.
_DERIVED = re.compile(
    rf".*[._/]{_QUANTITIES}([._/\[]?\d+\]?)?|{_QUANTITIES}([._/].*|\[?\d+\]?)", re.IGNORECASE
)
_RATE_OF_Q = re.compile(r"(\w*_|)(?:d+q|qd+)(_?\w+)")
_ACTION = re.compile(r"(action|target|desired|command(ed)?)([._/ ].*)?", re.IGNORECASE)
_POSITION = re.compile(r"[./](pos|position|positions)$")
_PLOTJUGGLER = re.compile(r"/.+/([^/]+)/(position|velocity|effort)")
_POSE = ("x", "y", "z", "roll", "pitch", "yaw", "rx", "ry", "rz", "qx", "qy", "qz", "qw")
_TIMING = ("episode_index", "timestamp", "frame_index")
_VERSIONS = ("v2.", "v3.")
_INFO = "meta/info.json"
_PAUSE = 10.0  # s between episodes, which have times of their own
_SET_BACK = 0.5  # s by which the time steps back where another episode begins


Episodes = tuple[tuple[float, int | str], ...]
"""Start of each episode, in seconds after the first sample of the table, and its name."""


def read_table(path: Path, options: LoadOptions) -> tuple[JointStates, Episodes]:
    """Read the joint states of a table.

    Parameters
    ----------
    path : Path
        A CSV file, whose first line names the time [s] and the joints, or the folder of a dataset.
    options : LoadOptions
        Of these `topic`, `joints`, `rename`, `max_gap` and `episodes`. `joints` are joints whatever
        their names, and no text elsewhere matters; they also name the values of a dataset whose own
        names don't fit.

    Returns
    -------
    raw : JointStates
        The joint states.
    episodes : Episodes
        The episodes; none of a CSV file without them.

    Raises
    ------
    RecordingError
        If it can't be read, or is no such table.
    """
    return _read_dataset(path, options) if path.is_dir() else _read_csv(path, options)


def _read_csv(path: Path, options: LoadOptions) -> tuple[JointStates, Episodes]:
    if options.topics:
        raise RecordingError("--topic is for bags and LeRobot datasets: a CSV file has no topics")
    header, rows, ticks_per_s = _header_and_rows(path)
    notes = notes_on_rename(options.rename, {"": [*names_of_positions(header), *header]})
    header = _renamed(header, options.rename)
    time, counters, columns, left_out = _columns_to_read(path, header, rows, options.joints)
    form: dict[str, Any] = {"delimiter": ",", "quotechar": '"', "ndmin": 2}
    with reading(f"the table '{path}'", RecordingError):
        # Without a choice of columns, a row of another length is an error.
        used = [time, *columns]
        is_all = len(used) == len(header)
        values = np.loadtxt(io.StringIO(rows), usecols=None if is_all else used, **form)
        values = values[:, used] if is_all else values
        values[:, 0] /= ticks_per_s
        labels = [tuple(row[i] for i in counters) for row in csv.reader(io.StringIO(rows)) if row]
    joints, notes = [header[i] for i in columns], (*left_out, *notes)
    varying = [k for k in range(len(counters)) if len({row[k] for row in labels}) > 1]
    if varying:
        names = _episode_names(["/".join(row[k] for k in varying) for row in labels])
        _check_episodes(path, options, names)
        return _states_of_episodes(path, path.name, joints, values, names, notes, options)
    if options.episodes is not None:
        raise RecordingError(
            f"'{path}' holds no episodes to choose from: a column of one of the names "
            f"{quote_names(_EPISODES)} must number them"
        )
    return _joint_states(path.name, joints, values, notes), ()


def _header_and_rows(path: Path) -> tuple[list[str], str, float]:
    """Names of the columns of a CSV file, its rows, separated by commas, and ticks per second."""
    with reading(f"the table '{path}'", RecordingError):
        text = read_text(path, INPUT_LIMITS.unpacked_bytes)
        while text.startswith("#"):  # comments
            text = text.partition("\n")[2]
        head, _, rows = text.partition("\n")
        delimiter = max(",;\t", key=head.count)
        if delimiter not in head:  # as in tables of UR's RTDE client
            delimiter = " "
            head, rows = head.strip(), re.sub(r"^ +| +$", "", rows, flags=re.MULTILINE)
            head, rows = re.sub(" +", " ", head), re.sub(" +", " ", rows)
        if delimiter != ",":
            # Programs that separate columns so may write decimal commas.
            head = head.replace(delimiter, ",")
            rows = rows.replace(",", ".").replace(delimiter, ",")
        header = [_plain_name(name.strip()) for name in next(csv.reader([head]), [])]
        is_echoed = head.startswith("%time")  # by rostopic echo -p: each row holds the names
        if is_echoed:
            cells = dict(zip(header, _first_row(rows), strict=False))
            joint_of = {x.replace("name", "position"): cells[x] for x in cells if "name" in x}
            header = ["time", *(joint_of.get(x, x) if "position" in x else x for x in header[1:])]
    if len(header) > INPUT_LIMITS.columns:
        raise RecordingError(
            f"'{path}' has {len(header):,} columns, more than the {INPUT_LIMITS.columns:,} accepted"
        )
    # Some programs write an unknown number as an empty cell; repair drops it.
    rows = re.sub(r"(?<=,)(?=[ \t\r]*(?:,|$))", "nan", rows, flags=re.MULTILINE)
    return header, rows, NS_PER_S if is_echoed else 1.0


def _columns_to_read(
    path: Path, header: Sequence[str], rows: str, joints: Sequence[str] | None
) -> tuple[int, list[int], list[int], tuple[str, ...]]:
    """Columns of the time, of episodes and of joints, and notes, by the names and the first row."""
    lower, first = [name.lower() for name in header], _first_row(rows)
    time = next((lower.index(name) for name in TIME_COLUMNS if name in lower), None)
    if time is None or not len(header) == len(first) > 1 or not _is_number(first[time]):
        raise RecordingError(
            f"the first line of '{path}' must name its columns, one of them the time [s] as one of "
            f"{quote_names(TIME_COLUMNS)}, and each line below must hold a number of seconds and "
            f"as many values; it has {len(header)} names, '{','.join(header)[:100]}', and "
            f"{len(first)} values, '{','.join(first)[:100]}'"
        )
    counters = [lower.index(x) for x in _EPISODES if x in lower and x not in (joints or ())]
    columns, notes = _joint_columns(header, joints, (time, *counters))
    named = names_of_positions(header)
    if joints is not None:
        columns = [i for i in columns if named[i] in joints or _is_number(first[i])]
    if texts := [i for i in columns if not _is_number(first[i])]:
        raise RecordingError(
            f"'{path}' can't be read: its column '{header[texts[0]]}' holds text, "
            f"'{first[texts[0]]:.30}'; choose the joints with --joints (joints=[…] in Python)"
        )
    if not columns:
        raise RecordingError(f"no column of '{path}' holds joint positions: {quote_names(header)}")
    return time, counters, columns, notes


def _first_row(rows: str) -> list[str]:
    return next(csv.reader([rows.lstrip().partition("\n")[0]]), [])


def _plain_name(name: str) -> str:
    """The name of a column; those of PlotJuggler, /TOPIC/JOINT/position, without the topic."""
    found = _PLOTJUGGLER.fullmatch(name)
    return f"{found[1]}/{found[2]}" if found else name


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _episode_names(texts: Sequence[str]) -> list[int | str]:
    """Names of the episodes of all samples, as numbers if they are whole numbers."""
    numbers: dict[str, int | str] = {}
    for text in dict.fromkeys(texts):
        if not _is_number(text) or not float(text).is_integer():
            return [one.strip() for one in texts]
        numbers[text] = int(float(text))
    return [numbers[text] for text in texts]


def _read_dataset(path: Path, options: LoadOptions) -> tuple[JointStates, Episodes]:
    columns, joints, rename = options.topics or [STATE], options.joints, options.rename
    with reading(f"'{path / _INFO}'", RecordingError):
        info = json.loads(read_text(path / _INFO))
    try:
        version, features = str(info["codebase_version"]), dict(info["features"])
        vectors = [name for name, one in features.items() if _size(one)]
        recorded = {name: _names(features[name]) for name in columns if name in vectors}
        named = [x for name, own in recorded.items() for x in _renamed(own, rename, name)]
        fps, total = float(info.get("fps") or 0.0), info.get("total_episodes")
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        raise RecordingError(
            f"'{path / _INFO}' does not describe a LeRobot dataset: expected 'codebase_version', "
            "'fps', and 'features' with 'dtype', 'shape' and 'names'"
        ) from None
    if not version.startswith(_VERSIONS):
        raise RecordingError(
            f"'{path}' is a LeRobot dataset of version '{version}': expected v2.0, v2.1 or v3.0"
        )
    for column in columns:
        if column not in vectors:
            unknown = unknown_name("column of numbers", column, vectors)
            raise RecordingError(f"'{path}': {unknown}; choose one with --topic (topic=)")
    indices, frames, damaged = _read_parquet(path, columns, fps, options.episodes)
    n_values, column = frames.shape[1] - 1, ",".join(columns)
    of_joints = {name: [*names_of_positions(own), *own] for name, own in recorded.items()}
    notes = damaged + notes_on_rename(rename, of_joints)
    if len(named) != n_values or _is_ambiguous(named, joints):
        named, note = _given_names(column, named, n_values, joints)
        notes += (note,)
    chosen, left_out = _joint_columns(named, joints)
    if chosen:
        named, frames = [named[i] for i in chosen], frames[:, [0, *(i + 1 for i in chosen)]]
        notes += left_out
    with reading(f"the column 'episode_index' of '{path}'", RecordingError):
        names: list[int | str] = [int(x) for x in indices.tolist()]
    _check_episodes(path, options, names, damaged)
    if options.episodes is None:
        notes += _missing_episodes(total, names)
    return _states_of_episodes(path, column, named, frames, names, notes, options)


def _check_episodes(
    path: Path, options: LoadOptions, names: Sequence[int | str], damaged: Sequence[str] = ()
) -> None:
    """Reject a choice of episodes that are not among those of all samples."""
    known = dict.fromkeys(names)
    for one in options.episodes or ():
        if not isinstance(one, int | str | np.integer) or one not in known:
            valid = listed([str(name) for name in known])
            wrong = f"'{path}' has no episode {shown(one)}; its episodes: {valid}"
            raise RecordingError("; ".join([wrong, *damaged]))


def _missing_episodes(total: object, names: Sequence[int | str]) -> tuple[str, ...]:
    """A note if a dataset has fewer episodes than it states."""
    if not isinstance(total, int) or not 0 < total <= len(names) + 100_000:
        return ()
    missing = [str(i) for i in sorted({*range(total)} - {*names})]
    if not missing:
        return ()
    return (
        f"{len(missing)} of the {total} episodes that '{_INFO}' states are missing in the data: "
        f"{listed(missing)}; download the whole dataset",
    )


def _read_parquet(
    path: Path, columns: Sequence[str], fps: float, chosen: Sequence[int | str] | None
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Episode, and time [s] with values, of each frame, episode by episode, and notes on files."""
    parquet = require("pyarrow.parquet", "lerobot", "reading a LeRobot dataset")
    files = sorted(path.glob("data/*/*.parquet"))
    if not files:
        raise RecordingError(f"'{path}' holds no data/*/*.parquet: download the whole dataset")
    parts = []
    damaged: list[str] = []
    numbers = [int(x) for x in chosen or () if isinstance(x, int | np.integer)]
    numbers = numbers if len(numbers) == len(chosen or ()) else []
    for file in files:
        try:
            with reading(f"'{file}'", RecordingError), open_regular(file) as stored:
                opened = parquet.ParquetFile(stored)
                known = [x for x in (*_TIMING, *columns) if x in opened.schema_arrow.names]
                _check_size(opened.metadata, known, os.fstat(stored.fileno()).st_size)
                # What the footer shows to hold none of them is not read.
                only = [(_TIMING[0], "in", numbers)] if numbers else None
                table = parquet.read_table(stored, columns=known, filters=only)
                if table.num_rows:
                    parts.append(_frames(table, columns))
        except RecordingError as error:
            damaged.append(f"left out: {error}")
            if len(damaged) == len(files):
                raise
    if not {*numbers} <= {x for part in parts for x in np.unique(part[:, 0])}:
        return _read_parquet(path, columns, fps, None)  # so that the error names all episodes
    if not parts:
        raise RecordingError("; ".join([f"'{path}' holds no samples", *damaged]))
    if len({part.shape[1] for part in parts}) > 1:
        raise RecordingError(
            f"the files of '{path}' differ in the length of {quote_names(columns)}"
        )
    frames = np.concatenate(parts)
    frames = frames[np.argsort(frames[:, 0], kind="stable")]
    same_episode = np.diff(frames[:, 0]) == 0.0
    if (np.diff(frames[:, 1]) > 0.0)[same_episode].any():
        return frames[:, 0], np.delete(frames, [0, 2], axis=1), tuple(damaged)
    if not (fps > 0.0 and (np.diff(frames[:, 2]) > 0.0)[same_episode].any()):
        raise RecordingError(
            f"the column 'timestamp' of '{path}' is missing or constant, and '{_INFO}' and the "
            "column 'frame_index' give no other times: add one of them"
        )
    note = f"timestamps are missing or constant: times are frame_index / fps ({fps:g} Hz)"
    frames[:, 2] /= fps
    return frames[:, 0], frames[:, 2:], (note, *damaged)


def _frames(table: Any, columns: Sequence[str]) -> FloatArray:
    """Episode, time, index and values of the frames of a file; NaN where there is no time."""
    unknown = np.full(table.num_rows, np.nan)
    timing = [
        table[name].to_numpy().astype(float) if name in table.column_names else unknown
        for name in _TIMING
    ]
    parts = []
    for column in columns:
        values = table[column].combine_chunks()
        while hasattr(values.type, "value_type"):
            values = values.flatten()
        parts.append(values.to_numpy(False).astype(float).reshape(table.num_rows, -1))
    return np.column_stack([*timing, *parts])


def _check_size(metadata: Any, columns: Sequence[str], n_bytes: int) -> None:
    """Reject a file that unpacks to far more numbers than files of motions of its size."""
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    chunks = [group.column(i) for group in groups for i in range(group.num_columns)]
    n_values = sum(x.num_values for x in chunks if x.path_in_schema.split(".list")[0] in columns)
    # Half-idle arms with quantised servos reach 3.6 numbers per byte; copies of motions reach 4.5.
    if n_values > max(INPUT_LIMITS.small_table_values, 4 * n_bytes):
        raise ValueError(f"its {n_bytes:,} bytes unpack to {n_values:,} numbers")


def _states_of_episodes(
    path: Path,
    topic: str,
    columns: Sequence[str],
    frames: FloatArray,
    names: Sequence[int | str],
    notes: tuple[str, ...],
    options: LoadOptions,
) -> tuple[JointStates, Episodes]:
    """The chosen episodes one after the other with a pause; time and values of frames, and names.

    An episode begins where the name changes, or where the time is set back.
    """
    if options.episodes is not None:
        rows = [row for row, name in enumerate(names) if name in options.episodes]
        frames, names = frames[rows], [names[row] for row in rows]
    starts = [
        row
        for row, name in enumerate(names)
        if not row or name != names[row - 1] or frames[row, 0] < frames[row - 1, 0] - _SET_BACK
    ]
    start, pause, episodes = 0.0, _PAUSE + 2.0 * (options.max_gap or 0.0), []
    for first, last in zip(starts, [*starts[1:], len(names)], strict=True):
        times = frames[first:last, 0]
        times[:] = start + times - times.min()
        episodes.append((start, names[first]))
        start = float(times.max()) + pause
    return _joint_states(topic, columns, frames, notes), tuple(episodes)


def whole_episodes(recording: Recording, episodes: Episodes) -> Recording:
    """The episodes of a table as motions, without those that gaps or jumps cut.

    Raises
    ------
    RecordingError
        If none is left.
    """
    # Times are rounded to nanoseconds.
    starts = np.array([start for start, _ in episodes]) - 1e-6
    owners = [int(np.searchsorted(starts, piece.times[0])) - 1 for piece in recording.pieces]
    n_pieces = Counter(owners)
    pairs = zip(recording.pieces, owners, strict=True)
    whole = tuple(piece for piece, owner in pairs if n_pieces[owner] == 1)
    if not whole:
        raise RecordingError(
            f"gaps or jumps cut each of its {len(episodes)} episodes: no motion is whole"
        )
    torn = [str(episodes[owner][1]) for owner, n in n_pieces.items() if n > 1]
    empty = [str(name) for i, (_, name) in enumerate(episodes) if i not in n_pieces]
    reasons = {"gaps or jumps cut them": torn, "they hold too few usable samples": empty}
    notes = [
        f"episodes dropped, as {why}: {listed(names)}" for why, names in reasons.items() if names
    ]
    # Borders of episodes are no gaps.
    repairs = {kind: n for kind, n in recording.repairs.items() if kind != "gaps"}
    duration = float(sum(piece.times[-1] - piece.times[0] for piece in whole))
    whole_ones = replace(
        recording, pieces=whole, duration=duration, repairs=repairs, episodes=episodes
    )
    return whole_ones.noted(*notes, gaps=len(owners) - len(n_pieces), cut_off=len(torn))


def _size(feature: Any) -> int:
    """Number of values of a vector of numbers, also of shape [1, n]; 0 of other features."""
    if not isinstance(feature, Mapping) or feature.get("dtype") not in ("float32", "float64"):
        return 0
    shape = [int(n) for n in feature.get("shape", ())]
    return max(shape) if shape and math.prod(shape) == max(shape) else 0


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of the values: a list, nested lists, lists by kind, or an index for each name."""
    names = feature.get("names")
    if isinstance(names, Mapping):
        if names and all(isinstance(index, int) for index in names.values()):
            return [str(name) for name in sorted(names, key=names.__getitem__)]
        names = list(names.values())
    flat: list[Any] = list(names or ())
    while any(isinstance(name, list) for name in flat):
        flat = [x for name in flat for x in (name if isinstance(name, list) else [name])]
    return [str(name) for name in flat if name is not None]


def _is_ambiguous(names: Sequence[str], joints: Sequence[str] | None) -> bool:
    """Whether names are repeated, and the joints are not chosen among the others."""
    known = names_of_positions(names)
    repeated = set(repeated_names(known))
    return bool(repeated) and (joints is None or not set(joints) <= set(known) - repeated)


def _given_names(
    column: str, names: Sequence[str], n_values: int, joints: Sequence[str] | None
) -> tuple[list[str], str]:
    """The joints as names of the values, where the dataset's own names don't fit, and a note."""
    given = (
        f"the dataset's names of the {n_values} values of '{column}' are {quote_names(names)}, not "
        "as many different ones"
    )
    if joints is not None and len(joints) == n_values:
        return list(joints), f"{given}: they are taken to be {quote_names(joints)}, in order"
    refuse_poses(names)
    last = column.rpartition(",")[2]
    raise RecordingError(
        f"{given}: give the names of all values, in order, as --joints"
        + (f", or rename some, as by --rename '{last}/*=second_*'" if "," in column else "")
    )


def refuse_poses(names: Sequence[str]) -> None:
    """Raise a RecordingError if names that nobody chose are those of poses."""
    ends = {re.split(r"[._/ ]", name.lower())[-1]: name for name in names}
    if {"x", "y", "z"} <= ends.keys():
        found = quote_names(name for end, name in ends.items() if end in _POSE)
        raise RecordingError(
            f"{found} are coordinates of poses and not joints: record joint positions; if they "
            "are joints, choose them with --joints (joints=[…] in Python)"
        )


def _joint_columns(
    header: Sequence[str], joints: Sequence[str] | None, taken: Sequence[int] = ()
) -> tuple[list[int], tuple[str, ...]]:
    """Indices of the columns that hold joint positions, and a note on the others.

    Not joints are: counters and times; velocities, accelerations and efforts, by the end (or the
    start) of their names; all but the state where columns are called observation.state.NAME;
    actions beside other columns. Columns that `joints` names are joints in any case.

    Parameters
    ----------
    header :
        Names of the columns.
    joints :
        Names of the joints, if they are chosen.
    taken :
        Columns that have another use.
    """
    chosen = {i for i, name in enumerate(names_of_positions(header)) if name in (joints or ())}
    prefix = f"{STATE}." if any(name.startswith(f"{STATE}.") for name in header) else ""
    free = [i for i in range(len(header)) if i not in taken]
    left = [
        i
        for i in free
        if not _BOOKKEEPING.fullmatch(header[i])
        and not _DERIVED.fullmatch(header[i])
        and not _is_rate_of_q(header[i], header)
        and header[i].startswith(prefix)
    ]
    states = [i for i in left if not _ACTION.fullmatch(header[i])]
    columns = sorted(chosen.union(states or left).intersection(free))
    if joints is None:
        refuse_poses([header[i] for i in columns])
    others = [header[i] for i in free if i not in columns and header[i]]
    if not others or joints is not None:
        return columns, ()
    return columns, (f"columns left out, as they are not joint positions: {quote_names(others)}",)


def _is_rate_of_q(name: str, header: Sequence[str]) -> bool:
    """Whether a column is called dq1 or qd1 beside q1, or actual_qd_0 beside actual_q_0."""
    found = _RATE_OF_Q.fullmatch(name)
    return found is not None and f"{found[1]}q{found[2]}" in header


def _renamed(header: Sequence[str], rename: Rename, source: str = "") -> list[str]:
    """Columns by the new names of their joints; patterns are of the whole name, or of the joint."""
    names = []
    for name, joint in zip(header, names_of_positions(header), strict=True):
        prefix = f"{STATE}." if name.startswith(f"{STATE}.") else ""
        new = new_name(name, rename, source)
        of_joint = prefix + new_name(joint, rename, source)
        names.append(of_joint if new == name and rename else new)
    return names


def names_of_positions(header: Sequence[str]) -> list[str]:
    """Names of joints: columns may be called NAME.pos, NAME/position or observation.state.NAME."""
    return [_POSITION.sub("", name.removeprefix(f"{STATE}.")) for name in header]


def _joint_states(
    topic: str, columns: Sequence[str], frames: FloatArray, notes: tuple[str, ...]
) -> JointStates:
    """Joint states of frames, which are a time [s] and values."""
    names = unique_names(names_of_positions(columns), "columns of the table", RecordingError)
    times, positions = frames[:, 0], frames[:, 1:]
    if not times.size:
        raise RecordingError(f"'{topic}' holds no samples")
    if not np.isfinite(times).all():
        raise RecordingError(f"the times of '{topic}' must be finite numbers of seconds")
    if note := other_unit_of_time(topic, times):
        raise RecordingError(note)
    if np.ptp(times) > INPUT_LIMITS.segment_time:
        raise RecordingError(
            f"the times of '{topic}' span more than {INPUT_LIMITS.segment_time:g} s"
        )
    # A stamp of 0 would mean that it is not set.
    stamps = np.rint((times - times.min()) * NS_PER_S).astype(np.int64) + NS_PER_S
    listed = np.ones(positions.shape, dtype=bool)
    return JointStates(topic, names, stamps, stamps, positions, listed, notes=notes)
