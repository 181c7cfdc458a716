# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An open recording: its files, its topics and their messages."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat

from ...exceptions import RecordingError, quote_names
from ...files import load_yaml, open_regular, read_bytes, reading
from ..joint_states import JointStates, collect_joint_states
from .discovery import (
    METADATA,
    PACKED_SUFFIXES,
    BagFormat,
    bag_files,
    bag_format,
)
from .formats import ZSTD_MAGIC, ScannedFile, opened, scan_mcap, scan_rosbag1, zstd
from .serialisation import (
    JOINT_STATE,
    Types,
    decoder,
    defined_types,
    field_of_states,
    known_types,
    states_in_field,
)


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; one that carries several types appears once for each.

    Attributes
    ----------
    name, type : str
        Its name, and the type of its messages as ROS 2 writes it (``pkg/msg/Name``).
    count : int
        Number of messages.
    """

    name: str
    type: str
    count: int


Stored = tuple[Topic, int, bytes]
"""Topic, time of reception [ns] and a message as it is stored."""


@contextmanager
def open_bag(path: Path, *, salvage: bool = False) -> Iterator[Bag]:
    """Open a recording.

    Parameters
    ----------
    path :
        The recording.
    salvage :
        Reads the messages of an .mcap file up to its damage.

    Raises
    ------
    RecordingError
        If it can't be read.
    """
    with ExitStack() as stack:
        yield Bag(path, stack, salvage=salvage)


class Bag:
    """An open recording, see :func:`open_bag`.

    Attributes
    ----------
    path : Path
        The recording.
    format : str
        Its storage format.
    topics : tuple of Topic
        Its topics, in order of name; of a damaged one those with messages before the damage.
    notes : tuple of str
        Notes on the last reading of messages, one sentence each.
    """

    def __init__(self, path: Path, stack: ExitStack, *, salvage: bool) -> None:
        self.path, self.format = path, bag_format(path)
        self.notes: tuple[str, ...] = ()
        self._decode = decoder(known_types(self.format), self.format)
        # Errors of the file system do not count as damage of the recording.
        with reading(f"'{path}'", RecordingError):
            for file in bag_files(path):
                open_regular(file).close()
        with self._damage_reported():
            named, self._disorder = _storage_files(path)
            self._files = [
                _opened(file, stack, salvage=salvage) for file in _plain_files(named, stack)
            ]
        self._connections = [found for file in self._files for found in file.connections]
        counts = Counter[tuple[str, str]]()
        for found in self._connections:
            counts[found.topic, found.msgtype] += found.msgcount
        damaged = [file.damage for file in self._files if isinstance(file, ScannedFile)]
        is_unfinished = path.suffix == ".active"
        if not counts and (is_unfinished or any(damaged)):
            hint = f"; its recorder did not finish it: run rosbag reindex {path.name}"
            reason = damaged[0] or "it holds no whole part"
            raise RecordingError(f"'{path}' can't be read: {reason}{hint if is_unfinished else ''}")
        self.topics = tuple(Topic(*channel, count) for channel, count in sorted(counts.items()))

    def messages(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages of some of :attr:`topics`, in order of reception.

        Raises
        ------
        RecordingError
            If they can't be read, wholly or in part.
        """
        keys = {(topic.name, topic.type): topic for topic in topics}
        self.notes = self._disorder
        with self._damage_reported():
            for file in self._files:
                chosen = [x for x in file.connections if (x.topic, x.msgtype) in keys]
                count = 0
                for found, stamp, data in file.messages(chosen) if chosen else ():
                    count += 1
                    # Messages may be packed one by one; CDR never begins as zstd does.
                    whole = zstd.decompress(data) if data[:4] == ZSTD_MAGIC else data
                    yield keys[found.topic, found.msgtype], stamp, whole
                indexed = sum(found.msgcount for found in chosen)
                if count != indexed:
                    raise ValueError(
                        f"its index says {indexed} messages on the topic, {count} can be read"
                    )
                if isinstance(file, ScannedFile) and file.damage:
                    self.notes += (
                        f"it is damaged ({file.damage}): only the {count} messages before the "
                        "damage are used",
                    )

    def deserialise(self, topic: Topic, data: bytes) -> Any:
        """Deserialise a message of a common type.

        Raises
        ------
        RecordingError
            If it does not hold such a message.
        """
        with self._damage_reported():
            return self._decode(data, topic.type)

    def joint_states(self, topic: str, field: str | None = None) -> JointStates:
        """Read all joint states of a topic.

        Types of other topics don't matter, known or not: the definition of JointState has never
        changed, so those stored in the bag are not needed, except for `field`.

        Parameters
        ----------
        topic :
            Name of the topic.
        field :
            The field of other messages that is a JointState, with dots where it is a field of a
            field.

        Raises
        ------
        RecordingError
            If the recording can't be read, or there are no joint states of that name.
        """
        named = [x for x in self.topics if x.name == topic and (field or x.type == JOINT_STATE)]
        if field and not named:
            names = quote_names(sorted({x.name for x in self.topics}))
            raise RecordingError(f"there is no topic '{topic}'; topics: {names}")
        with self._damage_reported():
            if field:
                read = {x: decoder(self._own_types(x), self.format) for x in named}
                stored = (
                    (t, states_in_field(read[x](data, x.type), field))
                    for x, t, data in self.messages(named)
                )
            else:
                stored = ((t, self._decode(x, JOINT_STATE)) for _, t, x in self.messages(named))
            raw = collect_joint_states(topic, stored)
        return replace(raw, notes=self.notes)

    def embedded_states(self) -> list[tuple[str, str]]:
        """Topics whose messages have joint states in a field, and the name of this field."""
        found = []
        for topic in self.topics:
            with suppress(RecordingError), self._damage_reported():
                found.append((topic.name, field_of_states(self._own_types(topic), topic.type)))
        return [(name, field) for name, field in found if field]

    def _own_types(self, topic: Topic) -> Types:
        """Types as the bag itself defines them."""
        texts = [
            found.msgdef.data
            for found in self._connections
            if found.msgtype == topic.type and found.msgdef.format == MessageDefinitionFormat.MSG
        ]
        if not texts:
            raise RecordingError(
                f"'{topic.name}' has messages of type {topic.type}, which the bag does not define "
                "as .msg text: only fields of defined messages can be read"
            )
        return defined_types(texts[-1], topic.type)

    def _damage_reported(self) -> AbstractContextManager[None]:
        return damage_reported(self.path, self.format)


def choose_topic(topics: Sequence[Topic], topic: str | None = None) -> Topic:
    """Choose the topic to read: the given one, else the only one with joint states.

    Raises
    ------
    RecordingError
        If there is no such topic, or there are several and none is given.
    """
    states = {item.name: item for item in topics if item.type == JOINT_STATE}
    chosen = [*states] if topic is None else [topic]
    if len(chosen) == 1 and chosen[0] in states:
        return states[chosen[0]]
    if not states:
        others = ", ".join(f"'{item.name}' ({item.type})" for item in topics) or "none"
        raise RecordingError(f"no topic holds joint states ({JOINT_STATE}); topics: {others}")
    problem = f"there are no joint states on '{topic}'"
    if topic is None:
        problem = "several topics hold joint states"
    raise RecordingError(f"{problem}; choose one of these topics: {quote_names(states)}")


@contextmanager
def damage_reported(path: Path, storage: BagFormat) -> Iterator[None]:
    """Convert all errors of reading to a RecordingError that names the recording."""
    try:
        yield
    except RecordingError:
        raise
    except PermissionError as error:
        raise RecordingError(f"'{path}' can't be read: {error.strerror}") from None
    # Damage shows as errors of many libraries: struct, lz4, zstd, sqlite3, yaml, KeyError,
    # MemoryError for a huge length … That list is open, so all exceptions are caught; the block
    # only reads.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        hint = "recovering it (--recover; salvage=True in Python) reads the part before the damage"
        raise RecordingError(
            f"'{path}' can't be read: damaged, cut off or no {storage} recording ({reason})"
            + (f"; {hint}, if there is any" if storage != "sqlite3" else "")
        ) from error


def _opened(file: Path, stack: ExitStack, *, salvage: bool) -> Any:
    """A reader of a file."""
    if file.suffix == ".active" or (salvage and file.suffix == ".bag"):
        return ScannedFile(file, scan_rosbag1)
    if salvage and file.suffix == ".mcap":
        return ScannedFile(file, scan_mcap)
    reader = opened(file)
    stack.callback(reader.close)
    return ScannedFile(file, scan_mcap, reader.connections) if file.suffix == ".mcap" else reader


def _storage_files(path: Path) -> tuple[list[Path], tuple[str, ...]]:
    """The storage files of a recording in order, and a note if their order is that of their names.

    Raises
    ------
    ValueError
        If one is missing.
    """
    files, why = bag_files(path), "is missing"
    if (path / METADATA).exists():
        content = load_yaml(read_bytes(path / METADATA))["rosbag2_bagfile_information"]
        # Each once, however often it is named.
        names = dict.fromkeys(PurePath(name).name for name in content["relative_file_paths"])
        named = [path / name for name in names]
        missing = [file.name for file in named if not file.is_file()]
        if not missing:
            return named, ()
        if len(missing) < len(named) or not files:  # else they were renamed
            raise ValueError(f"files are missing: {quote_names(missing)}")
        why = "names other files"
    if not path.is_dir():
        return files, ()
    return files, (f"{METADATA} {why}: the files are read in the order of their numbers",)


def _plain_files(files: Sequence[Path], stack: ExitStack) -> Iterator[Path]:
    """Storage files; those that are compressed as temporary files.

    Raises
    ------
    ValueError
        If the recorder of one did not finish it.
    """
    for file in files:
        for log in (file.with_name(f"{file.name}{end}") for end in ("-wal", "-journal")):
            if log.is_file() and log.stat().st_size:
                raise ValueError(
                    f"the recorder did not finish, and left '{log.name}': complete it with "
                    f"sqlite3 {file.name} 'PRAGMA journal_mode=DELETE'"
                )
        if file.suffix not in PACKED_SUFFIXES:
            yield file
            continue
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        target = Path(folder, file.stem)
        with zstd.open(file, "rb") as packed, target.open("wb") as plain:
            shutil.copyfileobj(packed, plain)
        yield target
