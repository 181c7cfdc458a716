# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A folder with what was read of recordings, so that it is not read again.

Each file holds a value by its key: the SHA-256 of the pickled value, then this. Values of this
package and of NumPy are unpickled, others are not. A damaged file counts as missing.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from .. import __version__
from ..exceptions import RecordingError
from ..files import read_bytes
from . import bags
from .bags.discovery import METADATA, bag_files
from .repair import CleanRecording

FOLDER_VARIABLE = "MP_PCA_PLANNER_CACHE"
"""Environment variable that names the folder of the command line's cache."""

_SUFFIX = ".read"
# NumPy's functions that make arrays and numbers, in modules of NumPy 1 and 2.
_OF_NUMPY = ("_reconstruct", "_frombuffer", "ndarray", "dtype", "scalar")


def default_folder() -> Path:
    """The folder of the command line's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get(FOLDER_VARIABLE) or Path(base) / "mp_pca_planner")


@dataclass(frozen=True)
class ReadingCache:
    """Values by key in a folder. A folder that can't be used is no error.

    Attributes
    ----------
    folder : Path or None
        The folder, made when it is needed; None: nothing is kept.
    max_bytes : int
        Largest size of all files after :meth:`prune`.
    """

    folder: Path | None = None
    max_bytes: int = 4 << 30

    @classmethod
    def resumed(cls, path: str | Path) -> ReadingCache:
        """The cache of --resume, which has a folder of its own.

        Raises
        ------
        RecordingError
            If it can't be used, or holds other files.
        """
        folder = Path(path)
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            if any(file.suffix not in (_SUFFIX, ".tmp") for file in folder.iterdir()):
                raise RecordingError(f"'{path}' holds other files: resume from a new folder")
            if not os.access(folder, os.W_OK):
                raise PermissionError
        except OSError as error:
            reason = error.strerror or "it may not be changed"
            raise RecordingError(f"'{path}' can't be the folder to resume from: {reason}") from None
        return cls(folder)

    def value(self, key: str) -> Any:
        """The value of a key; None if there is none."""
        if self.folder is None:
            return None
        file = self.folder / f"{key}{_SUFFIX}"
        # A damaged or hostile pickle may raise any error.
        with suppress(Exception):
            content = file.read_bytes()
            if hashlib.sha256(content[32:]).digest() == content[:32]:
                os.utime(file)  # used last
                return _Reader(io.BytesIO(content[32:])).load()
        return None

    def keep(self, key: str, value: Any) -> None:
        """Keep a value, if that is possible."""
        if self.folder is None:
            return
        with suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            content = pickle.dumps(value)
            descriptor, name = tempfile.mkstemp(".tmp", dir=self.folder)
            try:
                with os.fdopen(descriptor, "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                os.replace(name, self.folder / f"{key}{_SUFFIX}")
            except OSError:
                os.unlink(name)

    def checksum(self, path: Path) -> str:
        """The checksum of a recording, see :func:`.bags.checksum`.

        That of a recording whose files have the same names, sizes and times of modification as
        before is known without reading it.
        """
        key = key_of(str(path.absolute()), bags.stored_state(path))
        found = self.value(key)
        if not isinstance(found, str):
            found = bags.checksum(path)
            self.keep(key, found)
        return found

    def clean(self, path: Path, options: str, read: Callable[[], CleanRecording]) -> CleanRecording:
        """Repaired joint states of a recording.

        Parameters
        ----------
        path : Path
            The recording.
        options : str
            All options on which the result depends.
        read : callable
            Reads them, if they are not in the cache.
        """
        if self.folder is None:
            return read()
        names, metadata = [file.name for file in bag_files(path)], b""
        with suppress(OSError, ValueError):
            metadata = read_bytes(path / METADATA)
        key = key_of(self.checksum(path), options, names, metadata)
        found = self.value(key)
        if not isinstance(found, CleanRecording):
            found = read()
            self.keep(key, found)
        return found

    def prune(self) -> None:
        """Delete the files that were used first, until the others have at most `max_bytes`."""
        if self.folder is None:
            return
        with suppress(OSError), os.scandir(self.folder) as files:
            status = [(file.stat(), file.path) for file in files if file.is_file()]
            if sum(one.st_size for one, _ in status) <= self.max_bytes:
                return
            size = 0
            for one, file in sorted(status, key=lambda x: -x[0].st_mtime_ns):
                size += one.st_size
                if size > self.max_bytes:
                    Path(file).unlink(missing_ok=True)


def key_of(*values: Any) -> str:
    """The key of what the code of this release makes of some values."""
    return hashlib.sha256(pickle.dumps((__version__, _code_digest(), *values))).hexdigest()


@lru_cache(maxsize=1)
def _code_digest() -> bytes:
    """Digest of the code that reads and repairs recordings."""
    files = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()


class _Reader(pickle.Unpickler):
    """Unpickles dataclasses and tuples of this package, and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        package, own = (name.partition(".")[0] for name in (module, __name__))
        if package == "numpy" and name in _OF_NUMPY:
            return super().find_class(module, name)
        if package == own:
            found = super().find_class(module, name)
            if isinstance(found, type) and (is_dataclass(found) or issubclass(found, tuple)):
                return found
        raise pickle.UnpicklingError(f"it holds {module}.{name}")
