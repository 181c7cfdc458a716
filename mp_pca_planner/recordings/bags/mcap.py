# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of mcap (https://mcap.dev/spec), read from front to back.

The library `mcap` was measured to read a quarter as many messages a second, to lose all messages
of a chunk that is cut off, and to unpack lz4 without a bound.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path
from zlib import crc32

from .storage import (
    Buffer,
    Channel,
    DamageError,
    Key,
    Pass,
    StoredMessage,
    by_reception,
    mapped,
    ros2_type,
    total,
)
from .unpacking import ChunkUnpacker

MAGIC = b"\x89MCAP0\r\n"

MAX_STAMP = 1 << 63
"""Times of reception are stored in 64 bits; from this value on they are invalid [ns]."""

# Codes of records.
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, _CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
_STATISTICS, DATA_END = 0x0B, 0x0F

RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER_BYTES = RECORD_HEAD.size + 20 + len(MAGIC)


class McapFile:
    """A file of mcap, see :class:`.StorageFile`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, tuple[str, str]] = {0: ("__schemaless__", "")}
        self._channels: dict[int, Channel] = {}

    def index(self) -> Counter[Channel]:
        """Count messages by the statistics at the end, or one by one where there are none."""
        counts: dict[int, int] | None = None
        with mapped(self._path) as content:
            for kind, start, end in records(content, *_summary(content)):
                if kind == CHANNEL:
                    number, channel = self._channel(content, start)
                    self._channels[number] = channel
                elif kind == SCHEMA:
                    self._add_schema(content, start)
                elif kind == _STATISTICS:
                    counts = dict(struct.iter_unpack("<HQ", content[start + 46 : end]))
        if counts is None or not set(counts) <= set(self._channels):
            return Counter(channel for channel, _, _ in self.messages())
        return total(self._channels, counts)

    def messages(self, keys: Container[Key] | None = None) -> Iterator[StoredMessage]:
        """Messages up to the damage, or to the end; those of a chunk in order of reception."""
        with mapped(self._path) as content:
            if content[: len(MAGIC)] != MAGIC:
                raise DamageError("it does not begin as mcap")
            state = Pass(keys, ChunkUnpacker(len(content)))
            for number, channel in self._channels.items():
                state.add(number, channel)
            yield from self._messages(content, len(MAGIC), state)

    def _messages(self, content: Buffer, position: int, state: Pass) -> Iterator[StoredMessage]:
        for kind, start, end in records(content, position, len(content)):
            if kind == MESSAGE:
                number, _, stamp, _ = MESSAGE_HEAD.unpack_from(content, start)
                channel = state.channels.get(number)
                if channel is not None:
                    if stamp >= MAX_STAMP:
                        raise DamageError(f"a message was received at {stamp} ns")
                    yield channel, stamp, content[start + MESSAGE_HEAD.size : end]
            elif kind == SCHEMA:
                self._add_schema(content, start)
            elif kind == CHANNEL:
                state.add(*self._channel(content, start))
            elif kind == _CHUNK:
                yield from self._chunk(content, start, state)
            elif kind == DATA_END:
                return

    def _chunk(self, content: Buffer, start: int, state: Pass) -> Iterator[StoredMessage]:
        size, checksum = struct.unpack_from("<QI", content, start + 16)
        compression, place = text_at(content, start + 28)
        (stored,) = struct.unpack_from("<Q", content, place)
        records = state.unpack(compression, content[place + 8 : place + 8 + stored], size)
        yield from by_reception(self._messages(records, 0, state))
        if len(records) != size or (checksum and crc32(records) != checksum):
            raise DamageError(f"the chunk at byte {start} is not as written")

    def _add_schema(self, content: Buffer, start: int) -> None:
        (number,) = struct.unpack_from("<H", content, start)
        name, place = text_at(content, start + 2)
        encoding, place = text_at(content, place)
        definition = text_at(content, place)[0] if encoding == "ros2msg" else ""
        self._schemas[number] = (ros2_type(name), definition)

    def _channel(self, content: Buffer, start: int) -> tuple[int, Channel]:
        number, schema = struct.unpack_from("<HH", content, start)
        return number, Channel(text_at(content, start + 4)[0], *self._schemas[schema])


def _summary(content: Buffer) -> tuple[int, int]:
    """Start and end of the summary, which may be empty."""
    footer = len(content) - _FOOTER_BYTES
    if footer < len(MAGIC) or content[: len(MAGIC)] != MAGIC or content[-len(MAGIC) :] != MAGIC:
        raise DamageError("it does not begin and end as mcap")
    kind, _, start = struct.unpack_from("<BQQ", content, footer)
    if kind != FOOTER or start > footer:
        raise DamageError("its footer is damaged")
    return start or footer, footer


def records(content: Buffer, position: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Code of each record, start and end of its content.

    A truncated chunk is yielded before the error, because an uncompressed part can be read.
    """
    while position < end:
        kind, size = RECORD_HEAD.unpack_from(content, position)
        start = position + RECORD_HEAD.size
        is_cut_off = start + size > end
        if not is_cut_off or kind == _CHUNK:
            yield kind, start, start + size
        if is_cut_off:
            raise DamageError(f"the record at byte {position} is cut off")
        position = start + size


def text_at(content: Buffer, position: int) -> tuple[str, int]:
    """The text after its length, and the position of its end."""
    (size,) = struct.unpack_from("<I", content, position)
    end = position + 4 + size
    return content[position + 4 : end].decode(), end
