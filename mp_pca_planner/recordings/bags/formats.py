# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of bags: the readers of rosbags, and scans that read from front to back up to damage.

rosbags sorts messages by their times of reception. The scan of .mcap keeps the order of writing,
which shows where a clock was set back. Both scans read a file that is cut off; that of ROS 1 also a
.bag.active, which a recorder did not finish.
"""

from __future__ import annotations

import mmap
import struct
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import quote
from zlib import crc32

from lz4.frame import decompress as decompress_lz4  # type: ignore[import-untyped]
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import Header, RecordType, decompressors, normalize
from rosbags.rosbag1.reader import Reader as Rosbag1Reader
from rosbags.rosbag1.reader import read_uint32 as read_u32
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

if sys.version_info >= (3, 14):
    from compression import zstd as zstd
else:
    from backports import zstd as zstd

Buffer = bytes | mmap.mmap

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Connection(NamedTuple):
    """What a scan finds of a topic; the first fields that rosbags gives its own connections."""

    id: int
    topic: str
    msgtype: str
    msgdef: MessageDefinition
    msgcount: int = 0


Found = tuple[Connection, int, bytes]
"""Connection, time of reception [ns] and the message as stored."""

Scan = Callable[[Path], Iterator[Found]]
"""Reads a file from front to back, and raises an error at its damage."""


def opened(path: Path) -> Any:
    """The reader of rosbags for a file, opened."""
    reader: Rosbag1Reader | Sqlite3Reader | McapReader
    if path.suffix == ".db3":
        reader = Sqlite3Reader(Path(quote(str(path.absolute()))))  # read as a URL
    else:
        reader = McapReader(path) if path.suffix == ".mcap" else Rosbag1Reader(path)
    reader.open()
    return reader


class ScannedFile:
    """A file that is scanned, which offers what readers of rosbags do.

    Parameters
    ----------
    path :
        The file.
    scan :
        Reads it.
    connections :
        Its topics by its index; by default those with messages before its damage.

    Attributes
    ----------
    connections : sequence of Connection
        Its topics.
    damage : str
        Its damage, if it is read without an index.
    """

    def __init__(self, path: Path, scan: Scan, connections: Sequence[Any] | None = None) -> None:
        self._path, self._scan, self._has_index = path, scan, connections is not None
        self.damage = ""
        counts = Counter(one for one, _, _ in self.messages()) if connections is None else {}
        self.connections = connections or [x._replace(msgcount=n) for x, n in counts.items()]

    def messages(self, connections: Collection[Any] | None = None) -> Iterator[Found]:
        """Messages of some connections (all by default), in order of writing up to the damage."""
        wanted = None if connections is None else {found.id: found for found in connections}
        try:
            for connection, stamp, data in self._scan(self._path):
                if wanted is None or connection.id in wanted:
                    yield connection, stamp, data
        # Damage shows as errors of many libraries.
        except Exception as error:
            if self._has_index:
                raise
            self.damage = str(error) or type(error).__name__


def scan_rosbag1(path: Path) -> Iterator[Found]:
    """Scan a bag of ROS 1."""
    with path.open("rb") as file:
        if not file.readline().startswith(b"#ROSBAG V2.0"):
            raise ValueError("it does not begin as a bag of ROS 1")
        yield from _rosbag1_messages(file, path.stat().st_size, {})


def _rosbag1_messages(
    file: BinaryIO, size: int, connections: dict[int, Connection]
) -> Iterator[Found]:
    while file.tell() < size:
        header = Header.read(file)
        kind, length = header.get_uint8("op"), read_u32(file)
        data = file.read(length)
        is_cut_off = len(data) < length
        if is_cut_off and kind != RecordType.CHUNK:
            raise ValueError("a record is cut off")
        if kind == RecordType.CONNECTION:
            about = _about(data)
            number, name = header.get_uint32("conn"), about.get_string("type")
            text = about.get_string("message_definition")
            connections[number] = Connection(
                number,
                normalize(header.get_string("topic")),
                name if name.count("/") > 1 else name.replace("/", "/msg/"),
                MessageDefinition(MessageDefinitionFormat.MSG, text),
            )
        elif kind == RecordType.CHUNK:
            content = decompressors[header.get_string("compression")](data)
            yield from _rosbag1_messages(BytesIO(content), len(content), connections)
            if is_cut_off:
                raise ValueError("a chunk is cut off")
        elif kind == RecordType.MSGDATA:
            yield connections[header.get_uint32("conn")], header.get_time("time"), data


def _about(data: bytes) -> Header:
    return Header.read(BytesIO(struct.pack("<I", len(data)) + data))


MCAP_MAGIC = b"\x89MCAP0\r\n"
MCAP_HEAD = struct.Struct("<BQ")
MCAP_MESSAGE_HEAD = struct.Struct("<HIQQ")
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15
"""Codes of records of mcap."""

_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "": lambda data: data,
    "lz4": decompress_lz4,
    "zstd": zstd.decompress,
}


def scan_mcap(path: Path) -> Iterator[Found]:
    """Scan a file of mcap."""
    access = mmap.ACCESS_READ
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=access) as content:
        if content[: len(MCAP_MAGIC)] != MCAP_MAGIC:
            raise ValueError("it does not begin as mcap")
        yield from _mcap_messages(content, len(MCAP_MAGIC), {}, {})


def _mcap_messages(
    content: Buffer,
    position: int,
    schemas: dict[int, tuple[str, MessageDefinition]],
    channels: dict[int, Connection],
) -> Iterator[Found]:
    for kind, start, end in mcap_records(content, position):
        if kind == MESSAGE:
            number, _, stamp, _ = MCAP_MESSAGE_HEAD.unpack_from(content, start)
            yield channels[number], stamp, content[start + MCAP_MESSAGE_HEAD.size : end]
        elif kind == SCHEMA:
            (number,) = struct.unpack_from("<H", content, start)
            name, place = mcap_text(content, start + 2)
            encoding, place = mcap_text(content, place)
            is_text = encoding == "ros2msg"
            text = mcap_text(content, place)[0] if is_text else ""
            format_ = MessageDefinitionFormat.MSG if is_text else MessageDefinitionFormat.NONE
            schemas[number] = name, MessageDefinition(format_, text)
        elif kind == CHANNEL:
            number, schema = struct.unpack_from("<HH", content, start)
            topic, _ = mcap_text(content, start + 4)
            channels[number] = Connection(number, topic, *schemas[schema])
        elif kind == CHUNK:
            yield from _mcap_chunk(content, start, schemas, channels)
        elif kind == DATA_END:
            return


def _mcap_chunk(content: Buffer, start: int, *known: Any) -> Iterator[Found]:
    """Messages of a chunk in order of writing."""
    size, checksum = struct.unpack_from("<QI", content, start + 16)
    compression, place = mcap_text(content, start + 28)
    (stored,) = struct.unpack_from("<Q", content, place)
    records = _UNPACK[compression](content[place + 8 : place + 8 + stored])
    if len(records) == size and checksum and crc32(records) != checksum:
        raise ValueError(f"the chunk at byte {start} is not as written")
    with suppress(ValueError, struct.error):  # one that is cut off
        yield from _mcap_messages(records, 0, *known)
    if len(records) != size:
        raise ValueError(f"the chunk at byte {start} is cut off")


def mcap_records(content: Buffer, position: int) -> Iterator[tuple[int, int, int]]:
    """Code of each record, start and end of its content.

    A truncated chunk is yielded before the error, because an uncompressed part can be read.
    """
    while position < len(content):
        kind, size = MCAP_HEAD.unpack_from(content, position)
        start = position + MCAP_HEAD.size
        is_cut_off = start + size > len(content)
        if not is_cut_off or kind == CHUNK:
            yield kind, start, start + size
        if is_cut_off:
            raise ValueError(f"the record at byte {position} is cut off")
        position = start + size


def mcap_text(content: Buffer, position: int) -> tuple[str, int]:
    """The text after its length, and the position of its end."""
    (size,) = struct.unpack_from("<I", content, position)
    end = position + 4 + size
    return content[position + 4 : end].decode(), end
