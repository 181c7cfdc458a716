# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The files of a recording, read one after the other."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import chain
from pathlib import Path, PurePath

from ...exceptions import DamagedRecordingError, RecordingError, quote_names
from ...files import load_yaml, read_bytes
from .discovery import METADATA, PACKED_SUFFIXES, BagFormat, bag_files, translated_os_errors
from .formats import McapFile, Rosbag1File, Sqlite3File
from .storage import (
    ZSTD_MAGIC,
    Channel,
    DamageError,
    Key,
    StorageFile,
    StoredMessage,
    copy_unpacked,
    unpacked,
)

METADATA_VERSION = 9
"""Newest supported version of metadata.yaml."""

_READERS: dict[str, Callable[[Path], StorageFile]] = {
    ".bag": Rosbag1File,
    ".db3": Sqlite3File,
    ".mcap": McapFile,
}


class RecordingFiles:
    """The storage files of a recording.

    Parameters
    ----------
    path :
        The recording.
    bag_format :
        Its storage format.

    Attributes
    ----------
    notes : tuple of str
        Notes on them, one sentence each.
    """

    def __init__(self, path: Path, bag_format: BagFormat) -> None:
        self._path, self._format = path, bag_format
        self._files: list[StorageFile] = []
        self.notes: tuple[str, ...] = ()

    def open_by_index(self, stack: ExitStack) -> Counter[Channel]:
        """Open the files; return the number of messages of each channel, by their indices.

        Parameters
        ----------
        stack :
            Removes temporary files at its end.

        Raises
        ------
        RecordingError
            If a file or an index is damaged.
        """
        if self._path.is_file():
            # Errors of the file system do not count as damage of the recording.
            with translated_os_errors(self._path), self._path.open("rb") as file:
                file.read(1)
        counts: Counter[Channel] = Counter()
        with damage_reported(self._path, self._format):
            files = bag_files(self._path)
            if (self._path / METADATA).exists():
                files = _read_metadata(self._path)
            elif self._path.is_dir():
                note = f"{METADATA} is missing: the files are read in the order of their numbers"
                self.notes = (note,)
            logs = [log.name for file in files for log in _logs(file)]
            if logs:
                left = quote_names(logs)
                self.notes += (f"the recorder did not finish: the samples in {left} are also used",)
            self._files = [_READERS[part.suffix](part) for part in _plain_files(files, stack)]
            for part in self._files:
                # Channels without messages are included.
                for channel, count in part.index().items():
                    counts[channel] += count
        return counts

    def open_damaged(self, stack: ExitStack) -> Counter[Channel]:
        """Open the files; return the number of messages of each channel before the damage."""
        files = _plain_files(bag_files(self._path), stack, damaged=True)
        self._files = [_READERS[file.suffix](file) for file in files]
        counts: Counter[Channel] = Counter()
        with suppress(DamagedRecordingError), damage_reported(self._path, self._format):
            for channel, _, _ in self.messages():
                counts[channel] += 1
        return counts

    def messages(self, keys: Collection[Key] | None = None) -> Iterator[StoredMessage]:
        """Messages of some channels (all by default), each unpacked."""
        for file in self._files:
            messages = file.messages(keys)
            # All messages of a file are packed, or none; CDR never begins as zstd does.
            for first in messages:
                whole: Iterator[StoredMessage] = chain([first], messages)
                if first[2].startswith(ZSTD_MAGIC):
                    whole = ((c, stamp, unpacked("zstd", data)) for c, stamp, data in whole)
                yield from whole


@contextmanager
def damage_reported(path: Path, bag_format: BagFormat) -> Iterator[None]:
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
            f"'{path}' can't be read: damaged, cut off or no {bag_format} recording ({reason})"
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
