# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A file of what was read of recordings, so that an interrupted run continues where it was.

Entries are appended as recordings are read: the key of the recording and of the options, the
checksum of the content, its length, and the content. An incomplete entry at the end is cut off.
Entries are pickled values of this package and NumPy; others are not unpickled.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import os
import pickle
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, BinaryIO

from .. import __version__
from ..exceptions import RecordingError

_MAGIC = b"mp_pca_planner journal 1\n"
_HEAD = struct.Struct("<32s32sQ")
_PACKAGE = __name__.partition(".")[0]
# NumPy's functions that make arrays and numbers, in modules of NumPy 1 and 2.
_OF_NUMPY = ("_reconstruct", "_frombuffer", "ndarray", "dtype", "scalar")


class Journal:
    """Values by key in a file, see :func:`open_journal`."""

    def __init__(self, file: BinaryIO, path: str | Path) -> None:
        self._file, self._path = file, path
        self._places: dict[bytes, tuple[int, int]] = {}
        end = file.seek(0, os.SEEK_END)
        place = file.seek(len(_MAGIC))
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            key, checksum, length = _HEAD.unpack(head)
            if place + _HEAD.size + length > end:
                break
            if hashlib.sha256(file.read(length)).digest() == checksum:
                self._places[key] = place + _HEAD.size, length
            place += _HEAD.size + length
        file.truncate(place)

    def __contains__(self, key: bytes) -> bool:
        return key in self._places

    def value(self, key: bytes) -> Any:
        """The value of a key that is in it.

        Raises
        ------
        RecordingError
            If it is not what this package writes.
        """
        place, length = self._places[key]
        self._file.seek(place)
        try:
            return _Reader(io.BytesIO(self._file.read(length))).load()
        except Exception as error:  # of a damaged or hostile pickle: any
            raise RecordingError(
                f"'{self._path}' (--resume) is no work of this package ({error}): delete it"
            ) from None

    def add(self, key: bytes, value: Any) -> None:
        """Append a value.

        Raises
        ------
        RecordingError
            If it can't be written.
        """
        content = pickle.dumps(value)
        head = _HEAD.pack(key, hashlib.sha256(content).digest(), len(content))
        try:
            place = self._file.seek(0, os.SEEK_END)
            self._file.write(head + content)
            self._file.flush()
        except OSError as error:
            raise RecordingError(
                f"'{self._path}' (--resume) can't be written: {error.strerror}"
            ) from None
        self._places[key] = place + _HEAD.size, len(content)


@contextmanager
def open_journal(path: str | Path) -> Iterator[Journal]:
    """Open a journal, or make a new one, for this process alone.

    Raises
    ------
    RecordingError
        If the file is no journal, is in use, or can't be read and written.
    """
    try:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600), "r+b")
    except OSError as error:
        raise RecordingError(f"'{path}' can't be the file of --resume: {error.strerror}") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RecordingError(f"'{path}' (--resume) is in use by another process") from None
        start = file.read(len(_MAGIC))
        if not _MAGIC.startswith(start):
            raise RecordingError(f"'{path}' is no file of --resume: name another one")
        file.seek(0)
        file.write(_MAGIC)
        yield Journal(file, path)


def key_of(*values: Any) -> bytes:
    """The key of what is made of some values by this release."""
    return hashlib.sha256(pickle.dumps((__version__, *values))).digest()


class _Reader(pickle.Unpickler):
    """Unpickles dataclasses and tuples of this package, and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        package = module.partition(".")[0]
        if package == "numpy" and name in _OF_NUMPY:
            return super().find_class(module, name)
        if package == _PACKAGE:
            found = super().find_class(module, name)
            if isinstance(found, type) and (is_dataclass(found) or issubclass(found, tuple)):
                return found
        raise pickle.UnpicklingError(f"it holds {module}.{name}")
