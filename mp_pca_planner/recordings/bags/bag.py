# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An open recording: its files, its topics and their messages."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path, PurePath
from typing import Any, TypeVar

from ...exceptions import DamagedRecordingError, RecordingError, quote_names
from ...files import load_yaml, read_bytes
from ..joint_states import RawJointStates, slice_joint_states
from .discovery import (
    METADATA,
    PACKED_SUFFIXES,
    BagFormat,
    bag_files,
    bag_format,
    translated_os_errors,
)
from .formats import (
    ZSTD_MAGIC,
    Channel,
    DamageError,
    McapFile,
    Rosbag1File,
    Sqlite3File,
    StorageFile,
    StoredMessage,
    copy_unpacked,
    unpacked,
)
from .serialisation import (
    JOINT_STATE,
    Types,
    decoder,
    defined_types,
    encoder,
    field_of_states,
    known_types,
    states_in_field,
)

Result = TypeVar("Result")


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
        Reads the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If it can't be read.
    """
    with _hint_at_salvage(salvage), ExitStack() as stack:
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
        self._files: list[StorageFile] = []
        self._notes_on_files: tuple[str, ...] = ()
        self._salvage, self._has_index = salvage, True
        self._defined: dict[Channel, Types] = {}
        try:
            counts = self._open_by_index(stack)
        except DamagedRecordingError:
            counts = self._open_damaged(stack) if salvage else Counter()
            if not counts:
                raise
            self._has_index = False
        self.topics = tuple(Topic(*channel, count) for channel, count in sorted(counts.items()))

    def _open_by_index(self, stack: ExitStack) -> Counter[Channel]:
        """Open the files; return the number of messages of each channel, by their indices."""
        if self.path.is_file():
            # Errors of the file system do not count as damage of the recording.
            with translated_os_errors(self.path), self.path.open("rb") as file:
                file.read(1)
        counts: Counter[Channel] = Counter()
        with self._damage_reported():
            files = bag_files(self.path)
            if (self.path / METADATA).exists():
                files = _read_metadata(self.path)
            elif self.path.is_dir():
                note = f"{METADATA} is missing: the files are read in the order of their numbers"
                self._notes_on_files = (note,)
            logs = [log.name for file in files for log in _logs(file)]
            if logs:
                left = quote_names(logs)
                note = f"the recorder did not finish: the samples in {left} are also used"
                self._notes_on_files += (note,)
            self._files = [_READERS[part.suffix](part) for part in _plain_files(files, stack)]
            for part in self._files:
                # Channels without messages are included.
                for channel, count in part.index().items():
                    counts[channel] += count
        return counts

    def _open_damaged(self, stack: ExitStack) -> Counter[Channel]:
        """Open the files; return the number of messages of each channel before the damage."""
        files = _plain_files(bag_files(self.path), stack, damaged=True)
        self._files = [_READERS[file.suffix](file) for file in files]
        counts: Counter[Channel] = Counter()
        with suppress(DamagedRecordingError), self._damage_reported():
            for channel, _, _ in self._stored():
                counts[channel] += 1
        return counts

    def read(self, topics: Collection[Topic], use: Callable[[Iterator[Stored]], Result]) -> Result:
        """Call a function with the messages of some topics, up to the damage of a damaged bag.

        Parameters
        ----------
        topics :
            Some of :attr:`topics`.
        use :
            A function of the messages: topic, time of reception [ns], and the message as stored. It
            is called again if damage is detected during reading and `salvage` is enabled.

        Raises
        ------
        RecordingError
            If the messages can't be read, wholly or in part.
        """
        if self._has_index:
            try:
                return use(self._all_messages(topics))
            except DamagedRecordingError:
                if not self._salvage or not any(True for _ in self._before_damage(topics)):
                    raise
        return use(self._before_damage(topics))

    def deserialise(self, topic: Topic, data: bytes) -> Any:
        """Deserialise a message of a common type, or of a type that the bag defines.

        Raises
        ------
        RecordingError
            If it does not hold such a message.
        """
        with self._damage_reported():
            return self._decoded((topic.name, topic.type), data)

    def joint_states(self, topic: str, *, field: str | None = None) -> RawJointStates:
        """Read all joint states of a topic.

        Types of other topics don't matter, known or not: the definition of JointState has never
        changed, so those stored in the bag are not needed, except for `field`.

        Parameters
        ----------
        topic :
            Name of the topic.
        field :
            If the joint states are a field of other messages, its name, with dots where it is a
            field of a field.

        Raises
        ------
        RecordingError
            If the recording can't be read, or there are no joint states of that name.
        """
        named = [item for item in self.topics if item.name == topic]
        chosen = [item for item in named if field or item.type == JOINT_STATE]
        if field is not None and not chosen:
            raise RecordingError(
                f"there is no topic '{topic}'; topics: "
                f"{quote_names(sorted({item.name for item in self.topics}))}"
            )
        extract = {} if field is None else {t: self._field_reader(t, field) for t in chosen}

        def gathered(stored: Iterator[Stored]) -> RawJointStates:
            if extract:
                stored = ((source, t, extract[source](data)) for source, t, data in stored)
            with self._damage_reported():
                raw = slice_joint_states(topic, stored, ros1=self.format == "rosbag1")
            return replace(raw, notes=self.notes)

        return self.read(chosen, gathered)

    def embedded_states(self) -> list[tuple[str, str]]:
        """Topics whose messages have joint states in a field, and the name of this field."""
        found = []
        for topic in self.topics:
            with suppress(RecordingError), self._damage_reported():
                types = self._own_types((topic.name, topic.type))
                found.append((topic.name, field_of_states(types, topic.type)))
        return [(name, field) for name, field in found if field]

    def _all_messages(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages, whose number must be that of the index."""
        keys = {(topic.name, topic.type): topic for topic in topics}
        count = 0
        with self._damage_reported():
            for channel, stamp, data in self._stored(keys):
                count += 1
                yield keys[channel], stamp, data
        indexed = sum(topic.count for topic in topics)
        if count != indexed:
            raise DamagedRecordingError(
                f"'{self.path}' is damaged: its index says {indexed} messages on the topic, "
                f"{count} can be read"
            )
        self.notes = self._notes_on_files

    def _before_damage(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages before the damage; the damage may also be within a message."""
        keys = {(topic.name, topic.type): topic for topic in topics}
        count, reason = 0, "its index"
        try:
            for channel, stamp, data in self._stored(keys):
                self._decoded(channel, data)
                count += 1
                yield keys[channel], stamp, data
        # Every error in a damaged file counts as damage, see `_damage_reported`.
        except Exception as error:
            reason = f"after message {count}: {error}"
        self.notes = (
            f"it is damaged ({reason}): only the {count} messages before the damage are used",
        )

    def _stored(self, channels: Collection[Channel] | None = None) -> Iterator[StoredMessage]:
        """Messages of some channels (all by default), each unpacked."""
        for file in self._files:
            messages = file.messages(channels)
            # All messages of a file are packed, or none; CDR never begins as zstd does.
            for first in messages:
                whole: Iterator[StoredMessage] = chain([first], messages)
                if first[2].startswith(ZSTD_MAGIC):
                    whole = ((c, stamp, unpacked("zstd", data)) for c, stamp, data in whole)
                yield from whole

    def _decoded(self, channel: Channel, data: bytes) -> Any:
        """A message of a known type, else of a type that the bag defines."""
        types, (_, kind) = known_types(self.format), channel
        if kind not in types.types:
            types = self._own_types(channel)
        return decoder(types, self.format)(data, kind)

    def _own_types(self, channel: Channel) -> Types:
        """Types as the bag itself defines them."""
        topic, kind = channel
        if channel not in self._defined:
            definitions = [file.definitions.get(channel) for file in self._files]
            text = next(filter(None, reversed(definitions)), None)
            if text is None:
                raise RecordingError(
                    f"'{topic}' has messages of type {kind}, which the bag does "
                    "not define as .msg text: only fields of defined messages can be read"
                )
            self._defined[channel] = defined_types(text, kind)
        return self._defined[channel]

    def _field_reader(self, topic: Topic, field: str) -> Callable[[bytes], bytes]:
        """A function from a message to the joint states in a field of it, both serialised."""
        with self._damage_reported():
            decode = decoder(self._own_types((topic.name, topic.type)), self.format)
        encode = encoder(known_types(self.format), self.format)

        def extracted(data: bytes) -> bytes:
            with self._damage_reported():
                return bytes(encode(states_in_field(decode(data, topic.type), field), JOINT_STATE))

        return extracted

    def _damage_reported(self) -> AbstractContextManager[None]:
        return damage_reported(self.path, self.format)


@contextmanager
def _hint_at_salvage(salvage: bool) -> Iterator[None]:
    """Add advice to reports of damage."""
    try:
        yield
    except DamagedRecordingError as error:
        if salvage:
            raise
        hint = (
            "recovering it (--recover; salvage=True in Python) reads the part before the damage, "
            "if there is any"
        )
        raise DamagedRecordingError(f"{error}; {hint}") from error.__cause__


def choose_topic(topics: Sequence[Topic], topic: str | None = None) -> Topic:
    """Choose the topic to read: the given one, else the only one with joint states.

    Raises
    ------
    RecordingError
        If there is no such topic, or there are several and none is given.
    """
    states = {item.name: item for item in topics if item.type == JOINT_STATE}
    if topic in states:
        return states[topic]
    if topic is not None:
        raise RecordingError(
            f"there are no joint states on '{topic}'; topics with joint states: "
            f"{quote_names(states)}"
        )
    if len(states) > 1:
        raise RecordingError(
            f"several topics hold joint states: {quote_names(states)}; choose one of these topics"
        )
    if not states:
        raise RecordingError(
            f"no topic holds joint states ({JOINT_STATE}); topics: "
            + (", ".join(f"'{item.name}' ({item.type})" for item in topics) or "none")
        )
    return next(iter(states.values()))


METADATA_VERSION = 9
"""Newest supported version of metadata.yaml."""

_READERS: dict[str, type[StorageFile]] = {
    ".bag": Rosbag1File,
    ".db3": Sqlite3File,
    ".mcap": McapFile,
}


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
        raise DamagedRecordingError(
            f"'{path}' can't be read: damaged, cut off or no {storage} recording ({reason})"
        ) from error


def _plain_files(
    files: Iterable[Path], stack: ExitStack, *, damaged: bool = False
) -> Iterator[Path]:
    """The files, as temporary ones if compressed or incomplete; a damaged one up to the damage."""
    for file in files:
        logs = _logs(file)
        if file.suffix not in PACKED_SUFFIXES and not logs:
            yield file
            continue
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        target = folder / (file.name if logs else file.stem)
        try:
            if logs:
                for part in (file, *logs):
                    shutil.copyfile(part, folder / part.name)
                with closing(sqlite3.connect(target)) as database:
                    database.execute("PRAGMA journal_mode=DELETE")  # applies the logs
            else:
                copy_unpacked(file, target)
        except Exception:
            if not damaged:
                raise
        yield target


def _logs(file: Path) -> list[Path]:
    """Logs of sqlite3 beside a file, in which a recorder that was killed left messages."""
    beside = [file.with_name(f"{file.name}{end}") for end in ("-wal", "-journal")]
    return [log for log in beside if log.is_file() and log.stat().st_size]


def _read_metadata(folder: Path) -> list[Path]:
    """The storage files that metadata.yaml lists, in order.

    The metadata of rosbags parses YAML in pure Python, which takes longer than reading a short
    recording.

    Raises
    ------
    DamageError
        If a file is missing, or the storage format is unknown.
    """
    content = load_yaml(read_bytes(folder / METADATA))["rosbag2_bagfile_information"]
    if content["version"] > METADATA_VERSION:
        raise DamageError(f"version {content['version']} of {METADATA} is not known")
    for topic in content["topics_with_message_count"]:
        kind = topic["topic_metadata"]["serialization_format"]
        if kind != "cdr":
            raise DamageError(f"messages are stored as {kind}")
    files = [folder / PurePath(name).name for name in content["relative_file_paths"]]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise DamageError(f"files are missing: {quote_names(missing)}")
    mode = (content.get("compression_mode") or "none").lower()
    if mode != "none" and content.get("compression_format") != "zstd":
        raise DamageError(f"compression by {content.get('compression_format')!r} is not known")
    return files
