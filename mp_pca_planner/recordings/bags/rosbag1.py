# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bag files of ROS 1 (format 2.0), read from front to back."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Container, Iterator
from pathlib import Path

from ..byte_layout import NS_PER_S
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

MAGIC = b"#ROSBAG V2.0\n"

# Codes of records.
_MESSAGE, _CHUNK, _CHUNK_INFO, _CONNECTION = b"\x02", b"\x05", b"\x06", b"\x07"

_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")

Fields = dict[bytes, bytes]


class Rosbag1File:
    """A bag file of ROS 1, see :class:`.StorageFile`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._channels: dict[int, Channel] = {}
        self._chunks: dict[int, set[int]] = {}

    def index(self) -> Counter[Channel]:
        """Count messages by the records behind the last chunk."""
        counts: Counter[int] = Counter()
        with mapped(self._path) as content:
            header, _, _, _ = next(_records(content, _start(content)))
            (position,) = struct.unpack("<Q", header[b"index_pos"])
            if not position:
                raise DamageError("it has no index")
            for fields, _, start, end in _records(content, position):
                if fields[b"op"] == _CONNECTION:
                    self._channels[_number(fields)] = _channel(fields, content[start:end])
                elif fields[b"op"] == _CHUNK_INFO:
                    in_chunk = dict(struct.iter_unpack("<II", content[start:end]))
                    (chunk,) = struct.unpack("<Q", fields[b"chunk_pos"])
                    self._chunks[chunk] = set(in_chunk)
                    counts.update(in_chunk)
        expected = tuple(_U32.unpack(header[name])[0] for name in (b"conn_count", b"chunk_count"))
        if (len(self._channels), len(self._chunks)) != expected:
            raise DamageError("its index is cut off")
        return total(self._channels, counts)

    def messages(self, keys: Container[Key] | None = None) -> Iterator[StoredMessage]:
        """Messages up to the damage, or to the end; those of a chunk in order of reception."""
        with mapped(self._path) as content:
            state = Pass(keys, ChunkUnpacker(len(content)))
            for number, channel in self._channels.items():
                state.add(number, channel)
            yield from self._messages(content, _start(content), state)

    def _messages(self, content: Buffer, position: int, state: Pass) -> Iterator[StoredMessage]:
        for fields, place, start, end in _records(content, position):
            kind = fields.get(b"op")
            if kind == _MESSAGE:
                channel = state.channels.get(_number(fields))
                if channel is not None:
                    seconds, nanoseconds = _TIME.unpack(fields[b"time"])
                    yield channel, seconds * NS_PER_S + nanoseconds, content[start:end]
            elif kind == _CONNECTION:
                state.add(_number(fields), _channel(fields, content[start:end]))
            elif kind == _CHUNK and (
                place not in self._chunks or self._chunks[place] & state.channels.keys()
            ):
                yield from self._chunk(fields, content[start:end], state)

    def _chunk(self, fields: Fields, stored: bytes, state: Pass) -> Iterator[StoredMessage]:
        (size,) = _U32.unpack(fields[b"size"])
        records = state.unpack(fields[b"compression"].decode(), stored, size)
        yield from by_reception(self._messages(records, 0, state))


def _start(content: Buffer) -> int:
    if content[: len(MAGIC)] != MAGIC:
        raise DamageError("it does not begin as a bag of ROS 1")
    return len(MAGIC)


def _records(content: Buffer, position: int) -> Iterator[tuple[Fields, int, int, int]]:
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


def _channel(fields: Fields, data: bytes) -> Channel:
    about = _fields(data)
    return Channel(
        re.sub("//+", "/", fields[b"topic"].decode()),
        ros2_type(about[b"type"].decode()),
        about.get(b"message_definition", b"").decode(),
    )
