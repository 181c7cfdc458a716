# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A bag that is written while a robot moves, and is complete after every write."""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Iterable
from pathlib import Path

from ..exceptions import RecordingError
from ..recordings.bags.formats import (
    MCAP_HEAD,
    MCAP_MESSAGE_HEAD,
    McapFile,
    mcap_records,
    mcap_text,
)
from ..recordings.bags.serialisation import JOINT_STATE, message_definition
from ..recordings.bags.storage import Buffer, DamageError, mapped

_ONE = struct.pack("<H", 1)
"""Identifier of the only schema and of the only channel."""


def _text(content: str) -> bytes:
    data = content.encode()
    return struct.pack("<I", len(data)) + data


def _record(kind: int, *content: bytes) -> bytes:
    data = b"".join(content)
    return MCAP_HEAD.pack(kind, len(data)) + data


_START = McapFile.MAGIC + _record(McapFile.HEADER, _text("ros2"), _text("mp_pca_planner teach"))
_END = _record(McapFile.DATA_END, bytes(4)) + _record(McapFile.FOOTER, bytes(20)) + McapFile.MAGIC


class GrowingBag:
    """An mcap file of joint states, which another process may continue.

    Messages are written without chunks, and the end of the file is written again behind them in the
    same write. A process that is killed leaves a complete file; killed within a write, it leaves
    one whose last messages are cut off, and which the next process repairs.

    Parameters
    ----------
    path : Path
        The file; one that exists is continued.
    topic : str
        Name of the topic of the joint states.

    Raises
    ------
    RecordingError
        If the file can't be written, another process writes it, or it was not written by this
        class with this topic.
    """

    def __init__(self, path: Path, topic: str) -> None:
        self.path, self.topic = path, topic
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise RecordingError(f"'{path}' can't be written: {error.strerror}") from None
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def append(self, messages: Iterable[tuple[int, bytes]]) -> None:
        """Write serialised messages (CDR) with their times of reception [ns].

        Raises
        ------
        RecordingError
            If they can't be written.
        """
        self._write(
            b"".join(
                _record(McapFile.MESSAGE, MCAP_MESSAGE_HEAD.pack(1, 0, stamp, stamp), data)
                for stamp, data in messages
            )
        )

    def close(self) -> None:
        """Close the file, which is complete already."""
        os.close(self._file)

    def _start(self) -> None:
        """Lock the file, and find or write what comes before the messages."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RecordingError(f"'{self.path}' is being recorded by another process") from None
        self._end = self._end_of_messages() if os.fstat(self._file).st_size else 0
        if self._end:
            os.ftruncate(self._file, self._end)
            self._write(b"")
            return
        schema = (JOINT_STATE, "ros2msg", message_definition(JOINT_STATE))
        self._write(
            _START
            + _record(McapFile.SCHEMA, _ONE, *map(_text, schema))
            + _record(McapFile.CHANNEL, _ONE, _ONE, _text(self.topic), _text("cdr"), _text(""))
        )

    def _end_of_messages(self) -> int:
        """Position behind the last whole record of the data; 0 if there is no message yet."""
        with mapped(self.path) as content:
            if content[: len(_START)] != _START[: len(content)]:
                raise RecordingError(
                    f"'{self.path}' was not recorded by 'teach': choose another --output"
                )
            topic, position = _scan(content)
        if topic not in (None, self.topic):
            raise RecordingError(
                f"'{self.path}' was recorded from the topic '{topic}', not '{self.topic}': choose "
                "another --output"
            )
        return 0 if topic is None else position

    def _write(self, added: bytes) -> None:
        """Replace the end of the file by records and a new end."""
        waiting, position = memoryview(added + _END), self._end
        try:
            while waiting:
                n_written = os.pwrite(self._file, waiting, position)
                waiting, position = waiting[n_written:], position + n_written
        except OSError as error:
            raise RecordingError(f"'{self.path}' can't be written: {error.strerror}") from None
        self._end += len(added)


def _scan(content: Buffer) -> tuple[str | None, int]:
    """The topic, None before its record; and the position behind the last whole record."""
    topic, position = None, len(McapFile.MAGIC)
    try:
        for kind, start, end in mcap_records(content, position, len(content)):
            if kind == McapFile.DATA_END:
                break
            if kind == McapFile.CHANNEL:
                topic, _ = mcap_text(content, start + 4)
            position = end
    except (DamageError, struct.error):
        pass  # the last record is cut off
    return topic, position
