# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sqlite3 files of rosbag2, read in order of writing."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Container, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from ...input_limits import INPUT_LIMITS
from .storage import Channel, DamageError, Key, StoredMessage, ros2_type, total


class Sqlite3File:
    """An sqlite3 file of rosbag2, see :class:`.StorageFile`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def index(self) -> Counter[Channel]:
        """Count the rows of the messages."""
        with _opened(self._path) as database:
            counts = dict(
                database.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")
            )
            return total(_channels(database), counts)

    def messages(self, keys: Container[Key] | None = None) -> Iterator[StoredMessage]:
        """Messages up to the damage, or to the end."""
        with _opened(self._path, cut_off=True) as database:
            channels = _channels(database)
            chosen = {n for n, c in channels.items() if keys is None or c.key in keys}
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


def _channels(database: sqlite3.Connection) -> dict[int, Channel]:
    definitions = _definitions(database)
    channels = {}
    for number, name, kind in database.execute("SELECT id, name, type FROM topics"):
        if (type(number), type(name), type(kind)) != (int, str, str):
            raise DamageError(f"topic {number!r:.40} has a name or type that is no text")
        channels[number] = Channel(name, ros2_type(kind), definitions.get(kind, ""))
    return channels


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
