# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files with what was read of recordings, so that other options need not read them again."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..exceptions import PlannerError
from ..files import write_whole
from . import bags
from .bags.discovery import METADATA, translated_os_errors
from .repair import CleanRecording, Piece

FOLDER_VARIABLE = "MP_PCA_PLANNER_CACHE"
"""Environment variable that names the folder of the command line's cache."""

_UNREADABLE = (OSError, ValueError, KeyError, TypeError, BadZipFile)


def default_folder() -> Path:
    """The folder of the command line's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get(FOLDER_VARIABLE) or Path(base) / "mp_pca_planner")


@dataclass(frozen=True)
class ReadingCache:
    """A folder with the repaired joint states of recordings.

    They are found by the checksum of the recording, the options of reading, and the code that
    reads. The checksum of a recording whose files have the same names, sizes and times of
    modification as before is known without reading it. A folder that can't be used is no error.

    Attributes
    ----------
    folder : Path or None
        The folder, made when it is needed; None: nothing is kept.
    max_bytes : int
        Largest size of all files after :meth:`prune`.
    """

    folder: Path | None = None
    max_bytes: int = 4 << 30

    def checksum(self, path: Path) -> str:
        """The checksum of a recording, see :func:`.bags.checksum`."""
        if self.folder is None:
            return bags.checksum(path)
        stamp = _stamp(path)
        file = self.folder / f"{_digest(str(path.absolute()))}.json"
        with suppress(*_UNREADABLE):
            known = json.loads(file.read_text(encoding="utf-8"))
            if known["stamp"] == stamp:
                return str(known["checksum"])
        found = bags.checksum(path)
        _write(file, json.dumps({"stamp": stamp, "checksum": found}).encode())
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
        names = [name for name, *_ in _stamp(path)]
        with suppress(OSError):
            names.append(_digest((path / METADATA).read_text(encoding="utf-8")))
        key = [self.checksum(path), options, names, _code_digest()]
        file = self.folder / f"{_digest(json.dumps(key))}.npz"
        with suppress(*_UNREADABLE):
            found = _loaded(file)
            os.utime(file)  # used last
            return found
        clean = read()
        _write(file, _content(clean))
        return clean

    def prune(self) -> None:
        """Delete the files that were used first, until the others have at most `max_bytes`."""
        if self.folder is None:
            return
        with suppress(OSError):
            status = [(file.stat(), file) for file in self.folder.iterdir() if file.is_file()]
            size = 0
            for one, file in sorted(status, key=lambda x: -x[0].st_mtime_ns):
                size += one.st_size
                if size > self.max_bytes:
                    file.unlink(missing_ok=True)


def _write(file: Path, content: bytes) -> None:
    with suppress(OSError, PlannerError):
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(file, content, overwrite=True)


def _stamp(path: Path) -> list[list[Any]]:
    """Names, sizes and times of modification of the files of a recording."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    with translated_os_errors(path):
        status = [(file.name, file.stat()) for file in files]
    return [[name, one.st_size, one.st_mtime_ns] for name, one in status]


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Digest of the code that reads and repairs recordings."""
    files = sorted(Path(__file__).parent.rglob("*.py"))
    return _digest("".join(file.read_text(encoding="utf-8") for file in files))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _content(clean: CleanRecording) -> bytes:
    facts = {f.name: getattr(clean, f.name) for f in fields(clean) if f.name != "pieces"}
    arrays: dict[str, Any] = {"facts": np.array(json.dumps(facts))}
    for i, piece in enumerate(clean.pieces):
        arrays |= {f"times_{i}": piece.times, f"positions_{i}": piece.positions}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _loaded(file: Path) -> CleanRecording:
    with np.load(file, allow_pickle=False) as content:
        facts: dict[str, Any] = json.loads(str(content["facts"]))
        n_pieces = sum(name.startswith("times_") for name in content.files)
        pieces = tuple(
            Piece(content[f"times_{i}"], content[f"positions_{i}"]) for i in range(n_pieces)
        )
    values: dict[str, Any] = {
        key: tuple(x) if isinstance(x, list) else x for key, x in facts.items()
    }
    return CleanRecording(pieces=pieces, **values)
