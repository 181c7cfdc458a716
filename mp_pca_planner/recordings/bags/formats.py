# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Readers of the storage formats: ROS 1 (format 2.0), mcap (https://mcap.dev/spec) and sqlite3.

The library `mcap` was measured to read a quarter as many messages a second, to lose all messages
of a chunk that is cut off, and to unpack lz4 without a bound.
"""

from __future__ import annotations

import bz2
import mmap
import re
import shutil
import sqlite3
import struct
import sys
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zlib import crc32

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from ...input_limits import INPUT_LIMITS
from ..joint_states import NS_PER_S

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Buffer = bytes | mmap.mmap


Channel = tuple[str, str]
"""A topic and the type of its messages, as ROS 2 writes it (``pkg/msg/Name``)."""


StoredMessage = tuple[Channel, int, bytes]
"""Channel, time of reception [ns] and the message as stored."""


CLOCK_STEP = 50_000_000
"""A clock was set back if the times of reception of a topic step back by more than this [ns]."""


class DamageError(Exception):
    """A file that can't be read from here on, such as one that unpacks to too many bytes."""


def by_reception(messages: Iterator[StoredMessage]) -> Iterator[StoredMessage]:
    """Messages of a chunk in order of reception; those before the damage come before its error.

    Where the clock was set back, its times don't show the order: the messages are left as written.
    """
    found: list[StoredMessage] = []
    try:
        for message in messages:
            found.append(message)
    finally:
        yield from found if _was_set_back(found) else sorted(found, key=itemgetter(1))


def _was_set_back(messages: Sequence[StoredMessage]) -> bool:
    """Whether the times of reception step back between messages of a topic."""
    if all(before[1] <= message[1] for before, message in pairwise(messages)):
        return False
    latest: dict[Channel, int] = {}
    for channel, stamp, _ in messages:
        if stamp < latest.get(channel, stamp) - CLOCK_STEP:
            return True
        latest[channel] = stamp
    return False


def total(channels: Mapping[int, Channel], counts: Mapping[int, int]) -> Counter[Channel]:
    """Number of messages of each channel, from those by identifier; also of empty channels."""
    found: Counter[Channel] = Counter()
    for identifier, channel in channels.items():
        found[channel] += counts.get(identifier, 0)
    return found


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap]:
    """Map a file into memory."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def ros2_type(name: str) -> str:
    """Name of a type as ROS 2 writes it: ROS 1 leaves out the part between the slashes."""
    package, slash, kind = name.partition("/")
    return name if not slash or "/" in kind else f"{package}/msg/{kind}"


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_DECOMPRESSORS: Mapping[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


def unpacked(kind: str, data: bytes, declared: int | None = None) -> bytes:
    """Unpack a chunk or a message.

    Parameters
    ----------
    kind :
        Name of the compression; "" and "none" are no compression.
    data :
        The stored bytes.
    declared :
        Unpacked size as stated in the file [bytes].

    Raises
    ------
    DamageError
        If the compression is unknown, the content is cut off, or it is larger than declared or
        than is accepted.
    """
    if kind in ("", "none"):
        return data
    if kind not in _DECOMPRESSORS:
        raise DamageError(f"compression '{kind}' is not known")
    accepted = INPUT_LIMITS.unpacked_bytes
    limit = accepted if declared is None else declared
    if limit > accepted:
        raise DamageError(f"{limit:,} bytes are declared; accepted are {accepted:,}")
    parts, size = [], 0
    while data:
        decompressor = _DECOMPRESSORS[kind]()
        parts.append(decompressor.decompress(data, max_length=limit - size + 1))
        size += len(parts[-1])
        if size > limit:
            raise DamageError(f"it unpacks to more than {limit:,} bytes")
        if not decompressor.eof:
            raise DamageError("the compressed content is cut off")
        data = decompressor.unused_data
    return b"".join(parts)


def copy_unpacked(source: Path, target: Path) -> None:
    """Unpack a zstd file to another file, which stays incomplete if this fails.

    Raises
    ------
    DamageError
        If the content is too large for its file, or for the disk.
    """
    stored = source.stat().st_size
    room = int(INPUT_LIMITS.disk_share * shutil.disk_usage(target.parent).free)
    size = 0
    with zstd.open(source, "rb") as packed, target.open("wb") as file:
        while block := packed.read(1 << 16):
            size += len(block)
            check_size(size, stored)
            if size > room:
                raise DamageError(
                    f"it unpacks to more than {room:,} bytes, too many for '{target.parent}'"
                )
            file.write(block)


def check_size(size: int, stored: int) -> None:
    """Raise a DamageError if `stored` bytes unpack to so many that no recording does."""
    limit = max(INPUT_LIMITS.unpacked_bytes, INPUT_LIMITS.unpacked_ratio * stored)
    if size > limit:
        raise DamageError(
            f"its {stored:,} bytes unpack to {size:,} or more; accepted are {limit:,}"
        )


class StorageFile:
    """A file of a recording.

    Parameters
    ----------
    path :
        The file.

    Attributes
    ----------
    definitions : dict
        Definitions of the types of channels as .msg text, of those that the file defines.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.definitions: dict[Channel, str] = {}

    def index(self) -> Counter[Channel]:
        """Number of messages of each channel, by the index of the file."""
        raise NotImplementedError

    def messages(self, keys: Container[Channel] | None = None) -> Iterator[StoredMessage]:
        """Messages of some channels (all by default), in order of writing up to the damage."""
        raise NotImplementedError

    def _define(self, channel: Channel, definition: str) -> None:
        if definition:
            self.definitions[channel] = definition


class ChunkedFile(StorageFile):
    """A file of records, some of which are chunks of others, read from front to back."""

    MAGIC = b""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._channels: dict[int, Channel] = {}
        # Of the present reading: its channels, all those to be read by number, and the size of the
        # file and of its chunks so far, unpacked [bytes].
        self._keys: Container[Channel] | None = None
        self._read: dict[int, Channel] = {}
        self._stored = self._unpacked = 0

    def messages(self, keys: Container[Channel] | None = None) -> Iterator[StoredMessage]:
        """Messages up to the damage, or to the end; those of a chunk in order of reception."""
        with mapped(self._path) as content:
            self._keys, self._read = keys, {}
            self._stored, self._unpacked = len(content), 0
            for number, channel in self._channels.items():
                self._add(number, channel)
            yield from self._messages(content, self._start(content))

    def _start(self, content: Buffer) -> int:
        if content[: len(self.MAGIC)] != self.MAGIC:
            raise DamageError(f"it does not begin with {self.MAGIC!r}")
        return len(self.MAGIC)

    def _add(self, number: int, channel: Channel) -> None:
        """Read the messages of a channel, if it is to be read."""
        if self._keys is None or channel in self._keys:
            self._read[number] = channel

    def _unpack(self, compression: str, stored: bytes, size: int) -> bytes:
        """Unpack a chunk within a bound on the size of all."""
        self._unpacked += size
        check_size(self._unpacked, self._stored)
        return unpacked(compression, stored, size)

    def _messages(self, content: Buffer, position: int) -> Iterator[StoredMessage]:
        raise NotImplementedError


# Codes of records of ROS 1.
_MESSAGE, _CHUNK, _CHUNK_INFO, _CONNECTION = b"\x02", b"\x05", b"\x06", b"\x07"

_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")

Fields = dict[bytes, bytes]


class Rosbag1File(ChunkedFile):
    """A bag file of ROS 1."""

    MAGIC = b"#ROSBAG V2.0\n"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._chunks: dict[int, set[int]] = {}

    def index(self) -> Counter[Channel]:
        """Count messages by the records behind the last chunk."""
        counts: Counter[int] = Counter()
        with mapped(self._path) as content:
            header, _, _, _ = next(_rosbag1_records(content, self._start(content)))
            (position,) = struct.unpack("<Q", header[b"index_pos"])
            if not position:
                raise DamageError("it has no index")
            for fields, _, start, end in _rosbag1_records(content, position):
                if fields[b"op"] == _CONNECTION:
                    self._channels[_number(fields)] = self._connection(fields, content[start:end])
                elif fields[b"op"] == _CHUNK_INFO:
                    in_chunk = dict(struct.iter_unpack("<II", content[start:end]))
                    (chunk,) = struct.unpack("<Q", fields[b"chunk_pos"])
                    self._chunks[chunk] = set(in_chunk)
                    counts.update(in_chunk)
        expected = tuple(_U32.unpack(header[name])[0] for name in (b"conn_count", b"chunk_count"))
        if (len(self._channels), len(self._chunks)) != expected:
            raise DamageError("its index is cut off")
        return total(self._channels, counts)

    def _messages(self, content: Buffer, position: int) -> Iterator[StoredMessage]:
        for fields, place, start, end in _rosbag1_records(content, position):
            kind = fields.get(b"op")
            if kind == _MESSAGE:
                channel = self._read.get(_number(fields))
                if channel is not None:
                    seconds, nanoseconds = _TIME.unpack(fields[b"time"])
                    yield channel, seconds * NS_PER_S + nanoseconds, content[start:end]
            elif kind == _CONNECTION:
                self._add(_number(fields), self._connection(fields, content[start:end]))
            elif kind == _CHUNK and (
                place not in self._chunks or self._chunks[place] & self._read.keys()
            ):
                yield from self._chunk(fields, content[start:end])

    def _connection(self, fields: Fields, data: bytes) -> Channel:
        about = _fields(data)
        topic = re.sub("//+", "/", fields[b"topic"].decode())
        channel = topic, ros2_type(about[b"type"].decode())
        self._define(channel, about.get(b"message_definition", b"").decode())
        return channel

    def _chunk(self, fields: Fields, stored: bytes) -> Iterator[StoredMessage]:
        (size,) = _U32.unpack(fields[b"size"])
        records = self._unpack(fields[b"compression"].decode(), stored, size)
        yield from by_reception(self._messages(records, 0))


def _rosbag1_records(content: Buffer, position: int) -> Iterator[tuple[Fields, int, int, int]]:
    """Header fields and position of each record, start and end of its data.

    A truncated chunk is yielded before the error, because an uncompressed part can be read.
    """
    while position < len(content):
        head, start = _sized(content, position)
        fields = _fields(head)
        (size,) = _U32.unpack_from(content, start)
        end = start + _U32.size + size
        is_cut_off = end > len(content)
        if not is_cut_off or fields.get(b"op") == _CHUNK:
            yield fields, position, start + _U32.size, end
        if is_cut_off:
            raise DamageError(f"the record at byte {position} is cut off")
        position = end


def _sized(content: Buffer, position: int) -> tuple[bytes, int]:
    """The bytes after their number, and the position of their end."""
    (size,) = _U32.unpack_from(content, position)
    end = position + _U32.size + size
    if end > len(content):
        raise DamageError(f"the record at byte {position} is cut off")
    return content[position + _U32.size : end], end


def _fields(head: bytes) -> Fields:
    fields, position = {}, 0
    while position < len(head):
        field, position = _sized(head, position)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields


def _number(fields: Fields) -> int:
    number: int = _U32.unpack(fields[b"conn"])[0]
    return number


MCAP_HEAD = struct.Struct("<BQ")
MCAP_MESSAGE_HEAD = struct.Struct("<HIQQ")


class McapFile(ChunkedFile):
    """A file of mcap."""

    MAGIC = b"\x89MCAP0\r\n"
    # Codes of records.
    HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
    STATISTICS, DATA_END = 0x0B, 0x0F

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, tuple[str, str]] = {0: ("__schemaless__", "")}

    def index(self) -> Counter[Channel]:
        """Count messages by the statistics at the end, or one by one where there are none."""
        counts: dict[int, int] | None = None
        with mapped(self._path) as content:
            for kind, start, end in mcap_records(content, *self._summary(content)):
                if kind == self.CHANNEL:
                    number, channel = self._channel(content, start)
                    self._channels[number] = channel
                elif kind == self.SCHEMA:
                    self._add_schema(content, start)
                elif kind == self.STATISTICS:
                    counts = dict(struct.iter_unpack("<HQ", content[start + 46 : end]))
        if counts is None or not set(counts) <= set(self._channels):
            return Counter(channel for channel, _, _ in self.messages())
        return total(self._channels, counts)

    def _messages(self, content: Buffer, position: int) -> Iterator[StoredMessage]:
        for kind, start, end in mcap_records(content, position, len(content)):
            if kind == self.MESSAGE:
                number, _, stamp, _ = MCAP_MESSAGE_HEAD.unpack_from(content, start)
                channel = self._read.get(number)
                if channel is not None:
                    if stamp >= 1 << 63:  # Larger numbers are no times.
                        raise DamageError(f"a message was received at {stamp} ns")
                    yield channel, stamp, content[start + MCAP_MESSAGE_HEAD.size : end]
            elif kind == self.SCHEMA:
                self._add_schema(content, start)
            elif kind == self.CHANNEL:
                self._add(*self._channel(content, start))
            elif kind == self.CHUNK:
                yield from self._chunk(content, start)
            elif kind == self.DATA_END:
                return

    def _chunk(self, content: Buffer, start: int) -> Iterator[StoredMessage]:
        size, checksum = struct.unpack_from("<QI", content, start + 16)
        compression, place = mcap_text(content, start + 28)
        (stored,) = struct.unpack_from("<Q", content, place)
        records = self._unpack(compression, content[place + 8 : place + 8 + stored], size)
        yield from by_reception(self._messages(records, 0))
        if len(records) != size or (checksum and crc32(records) != checksum):
            raise DamageError(f"the chunk at byte {start} is not as written")

    def _summary(self, content: Buffer) -> tuple[int, int]:
        """Start and end of the summary, which may be empty."""
        footer = len(content) - MCAP_HEAD.size - 20 - len(self.MAGIC)
        if footer < self._start(content) or content[-len(self.MAGIC) :] != self.MAGIC:
            raise DamageError("it does not end as mcap")
        kind, _, start = struct.unpack_from("<BQQ", content, footer)
        if kind != self.FOOTER or start > footer:
            raise DamageError("its footer is damaged")
        return start or footer, footer

    def _add_schema(self, content: Buffer, start: int) -> None:
        (number,) = struct.unpack_from("<H", content, start)
        name, place = mcap_text(content, start + 2)
        encoding, place = mcap_text(content, place)
        definition = mcap_text(content, place)[0] if encoding == "ros2msg" else ""
        self._schemas[number] = (ros2_type(name), definition)

    def _channel(self, content: Buffer, start: int) -> tuple[int, Channel]:
        number, schema = struct.unpack_from("<HH", content, start)
        kind, definition = self._schemas[schema]
        channel = mcap_text(content, start + 4)[0], kind
        self._define(channel, definition)
        return number, channel


def mcap_records(content: Buffer, position: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Code of each record, start and end of its content.

    A truncated chunk is yielded before the error, because an uncompressed part can be read.
    """
    while position < end:
        kind, size = MCAP_HEAD.unpack_from(content, position)
        start = position + MCAP_HEAD.size
        is_cut_off = start + size > end
        if not is_cut_off or kind == McapFile.CHUNK:
            yield kind, start, start + size
        if is_cut_off:
            raise DamageError(f"the record at byte {position} is cut off")
        position = start + size


def mcap_text(content: Buffer, position: int) -> tuple[str, int]:
    """The text after its length, and the position of its end."""
    (size,) = struct.unpack_from("<I", content, position)
    end = position + 4 + size
    return content[position + 4 : end].decode(), end


class Sqlite3File(StorageFile):
    """An sqlite3 file of rosbag2."""

    def index(self) -> Counter[Channel]:
        """Count the rows of the messages."""
        with _opened(self._path) as database:
            counts = dict(
                database.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")
            )
            return total(self._channels(database), counts)

    def messages(self, keys: Container[Channel] | None = None) -> Iterator[StoredMessage]:
        """Messages up to the damage, or to the end."""
        with _opened(self._path, cut_off=True) as database:
            channels = self._channels(database)
            chosen = {n for n, c in channels.items() if keys is None or c in keys}
            # Data of other topics, such as images, is not read. Columns may hold any type.
            rows = database.execute(
                "SELECT id, topic_id, timestamp, CASE WHEN typeof(timestamp) = 'integer' "
                "AND timestamp >= 0 AND typeof(data) = 'blob' "
                f"AND topic_id IN ({', '.join(map(str, chosen))}) THEN data END "
                "FROM messages ORDER BY id"
            )
            last = 0
            for row, number, stamp, data in rows:
                # A page that is cut off is read as zeros.
                if row <= last or number not in channels or (data is None and number in chosen):
                    raise DamageError(f"there is no message behind row {last}")
                last = row
                if data is not None:
                    yield channels[number], stamp, data

    def _channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        definitions = _definitions(database)
        channels = {}
        for number, name, kind in database.execute("SELECT id, name, type FROM topics"):
            if (type(number), type(name), type(kind)) != (int, str, str):
                raise DamageError(f"topic {number!r:.40} has a name or type that is no text")
            channels[number] = name, ros2_type(kind)
            self._define(channels[number], definitions.get(kind, ""))
        return channels


@contextmanager
def _opened(path: Path, *, cut_off: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a file that has bounded tables only, on request also one that is cut off.

    Raises
    ------
    DamageError
        If it has a view, which may have rows without end.
    """
    # For a file without permission, sqlite3 reports the same error as for a damaged one.
    path.open("rb").close()
    where = f"file:{quote(str(path.resolve()))}?immutable=1"
    with closing(sqlite3.connect(where, uri=True)) as database:
        # A computed column may have any size.
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, INPUT_LIMITS.unpacked_bytes)
        if cut_off:
            # Otherwise sqlite3 rejects files with fewer pages than their header states.
            database.execute("PRAGMA writable_schema=ON")
        views = database.execute("SELECT name FROM sqlite_master WHERE type = 'view' LIMIT 1")
        for (name,) in views:
            raise DamageError(f"'{name}' is a view: bags have tables only")
        yield database


def _definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Definitions of types as .msg text; files of old versions have none."""
    try:
        return dict(
            database.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"
            )
        )
    except sqlite3.OperationalError:
        return {}
