# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages before the damage of a bag file, found without its index from front to back."""

from __future__ import annotations

import mmap
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from .byte_layout import NS_PER_S
from .unpacking import MAX_UNPACKED

Buffer = bytes | mmap.mmap


class Found(NamedTuple):
    """A message that was found.

    Attributes
    ----------
    topic, type : str
        Its topic and type as written.
    receive_stamp : int
        Time of reception [ns].
    data : bytes
        The message as stored.
    definition : str
        Definition of its type as .msg text ('' if the file has none).
    """

    topic: str
    type: str
    receive_stamp: int
    data: bytes
    definition: str = ""


Decompress = Callable[[str, bytes, int], bytes]
"""From the name of a compression, the bytes stored and their size unpacked to the latter."""

_U32 = struct.Struct("<I")


class DamageError(Exception):
    """Here a file can't be read on."""


def salvaged_rosbag1(path: Path, decompress: Decompress) -> Iterator[Found]:
    """Find messages in a bag of ROS 1 until the damage, or the end."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(b"\n") + 1
        if content[:8] != b"#ROSBAG ":
            raise DamageError("it does not begin as a bag of ROS 1")
        yield from _rosbag1_messages(content, start, {}, decompress)


def _rosbag1_messages(
    content: Buffer,
    position: int,
    topics: dict[bytes, tuple[str, str, str]],
    decompress: Decompress,
) -> Iterator[Found]:
    while position < len(content):
        head, position = _sized(content, position)
        fields = _fields(head)
        kind = fields.get(b"op", b"")
        if kind == b"\x05":
            yield from _rosbag1_chunk(content, position, fields, topics, decompress)
        data, position = _sized(content, position)
        if kind == b"\x07":
            about = _fields(data)
            topics[fields[b"conn"]] = (
                fields[b"topic"].decode(),
                about[b"type"].decode(),
                about.get(b"message_definition", b"").decode(),
            )
        elif kind == b"\x02" and fields.get(b"conn") in topics:
            seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
            topic, type_, definition = topics[fields[b"conn"]]
            stamp = seconds * NS_PER_S + nanoseconds
            yield Found(topic, type_, stamp, data, definition)


def _rosbag1_chunk(
    content: Buffer,
    position: int,
    fields: dict[bytes, bytes],
    topics: dict[bytes, tuple[str, str, str]],
    decompress: Decompress,
) -> Iterator[Found]:
    """Find messages in a chunk; in one that is cut off, too, if it is not compressed."""
    (size,) = _U32.unpack_from(content, position)
    stored = content[position + 4 : position + 4 + size]
    compression = fields[b"compression"].decode()
    (unpacked,) = _U32.unpack(fields[b"size"])
    if compression != "none":
        stored = decompress(compression, stored, unpacked)
    yield from _rosbag1_messages(stored, 0, topics, decompress)


def _sized(content: Buffer, position: int) -> tuple[bytes, int]:
    (size,) = _U32.unpack_from(content, position)
    end = position + 4 + size
    if end > len(content):
        raise DamageError(f"a record at byte {position} ends behind the file")
    return content[position + 4 : end], end


def _fields(head: bytes) -> dict[bytes, bytes]:
    fields, position = {}, 0
    while position < len(head):
        field, position = _sized(head, position)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields


def salvaged_mcap(path: Path, decompress: Decompress) -> Iterator[Found]:
    """Find messages in an mcap file until the damage, or the end of its data."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content[:8] != b"\x89MCAP0\r\n":
            raise DamageError("it does not begin as mcap")
        yield from _mcap_messages(content, 8, len(content), _Channels(), decompress)


class _Channels:
    """Types with their definitions by schema, and topics with their schema by channel."""

    def __init__(self) -> None:
        self.types: dict[int, tuple[str, str]] = {0: ("", "")}
        self.topics: dict[int, tuple[str, int]] = {}


def _mcap_messages(
    content: Buffer, position: int, end: int, channels: _Channels, decompress: Decompress
) -> Iterator[Found]:
    while position < end:
        kind, size = struct.unpack_from("<BQ", content, position)
        position += 9
        if kind == 0x0F:
            return
        if kind == 0x06:
            yield from _mcap_chunk(content, position, channels, decompress)
        if position + size > end:
            raise DamageError(f"a record at byte {position} ends behind the file")
        if kind == 0x03:
            (schema,) = struct.unpack_from("<H", content, position)
            channels.types[schema] = _schema(content, position + 2)
        elif kind == 0x04:
            channel, schema = struct.unpack_from("<HH", content, position)
            channels.topics[channel] = (_text(content, position + 4), schema)
        elif kind == 0x05:
            channel, _, stamp, _ = struct.unpack_from("<HIQQ", content, position)
            if channel in channels.topics:
                data = bytes(content[position + 22 : position + size])
                topic, schema = channels.topics[channel]
                type_, definition = channels.types[schema]
                yield Found(topic, type_, stamp, data, definition)
        position += size


def _mcap_chunk(
    content: Buffer, position: int, channels: _Channels, decompress: Decompress
) -> Iterator[Found]:
    """Find messages in a chunk; in one that is cut off, too, if it is not compressed."""
    (unpacked,) = struct.unpack_from("<Q", content, position + 16)
    compression = _text(content, position + 28)
    start = position + 32 + len(compression)
    (size,) = struct.unpack_from("<Q", content, start)
    records = content[start + 8 : start + 8 + size]
    if compression:
        records = decompress(compression, records, unpacked)
    yield from _mcap_messages(records, 0, len(records), channels, decompress)


def _schema(content: Buffer, position: int) -> tuple[str, str]:
    """Name of a type, and its definition if that is .msg text."""
    parts = []
    for _ in range(3):
        part, position = _sized(content, position)
        parts.append(part.decode())
    name, encoding, definition = parts
    return name, definition if encoding == "ros2msg" else ""


def _text(content: Buffer, position: int) -> str:
    data, _ = _sized(content, position)
    return data.decode()


def salvaged_sqlite3(path: Path) -> Iterator[Found]:
    """Find messages in an sqlite3 file, in the order of writing, until the damage or the end."""
    with opened_sqlite3(path) as database:
        topics = {
            number: (name, kind)
            for number, name, kind in database.execute("SELECT id, name, type FROM topics")
        }
        definitions = _sqlite3_definitions(database)
        last = 0
        for row, number, stamp, data in database.execute(
            "SELECT id, topic_id, timestamp, data FROM messages ORDER BY id"
        ):
            # A page that is cut off is read as zeros.
            if row <= last or number not in topics or not isinstance(data, bytes):
                raise DamageError(f"there is no message behind row {last}")
            last = row
            name, kind = topics[number]
            yield Found(name, kind, stamp, data, definitions.get(kind, ""))


@contextmanager
def opened_sqlite3(path: Path) -> Iterator[sqlite3.Connection]:
    """Open an sqlite3 file, also one that is cut off, that holds nothing but bounded tables.

    Raises
    ------
    DamageError
        If it has a view, which may have rows without end.
    """
    where = f"file:{quote(str(path.resolve()))}?immutable=1"
    with closing(sqlite3.connect(where, uri=True)) as database:
        # A computed column may be as large as it says.
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_UNPACKED)
        # Only so does sqlite3 open a file that has fewer pages than its first one says.
        database.execute("PRAGMA writable_schema=ON")
        views = database.execute("SELECT name FROM sqlite_master WHERE type = 'view' LIMIT 1")
        for (name,) in views:
            raise DamageError(f"'{name}' is a view: bags have tables only")
        yield database


def _sqlite3_definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Definitions of types as .msg text; files of old versions have none."""
    try:
        return dict(
            database.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"
            )
        )
    except sqlite3.Error:
        return {}
