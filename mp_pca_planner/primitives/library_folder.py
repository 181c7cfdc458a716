# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The files of a versioned library: read, and written together."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from ..exceptions import PlannerError, PrimitiveError
from ..files import Content, read_bytes, read_text, reading, write_together
from ..input_limits import INPUT_LIMITS
from .library_journal import MAX_JOURNAL_BYTES, Change, parsed_change


class LibraryFolder:
    """The files of a library and its journal.

    Parameters
    ----------
    folder : str or Path
        The folder; made at the first change.

    Raises
    ------
    PrimitiveError
        If it is no folder, or its journal is damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise PrimitiveError(f"the library '{folder}' is no folder")
        self.versions = self.folder / ".versions"
        self._journal = self.versions / "journal.jsonl"
        self.history()

    def history(self) -> tuple[Change, ...]:
        """Every change, the oldest first."""
        with reading(f"the journal '{self._journal}'", PrimitiveError):
            try:
                lines = read_text(self._journal, MAX_JOURNAL_BYTES).splitlines()
            except (FileNotFoundError, NotADirectoryError):
                return ()
        numbered = enumerate(lines, start=1)
        return tuple(parsed_change(line, f"line {i} of '{self._journal}'") for i, line in numbered)

    def in_use(self) -> dict[str, int]:
        """Version of each primitive that is in use, by name."""
        latest = {change.name: change.version for change in self.history()}
        return {name: version for name, version in latest.items() if version is not None}

    def kept(self, name: str) -> Path:
        """Path of a file that is kept beside the versions, see :meth:`.VersionedLibrary.change`."""
        return self.versions / name

    def file_of(self, name: str, version: int) -> Path:
        """Path of a version of a primitive."""
        return self.versions / name / f"{version:04}.npz"

    def file_in_use(self, name: str) -> Path:
        """Path of a primitive in use."""
        return self.folder / f"{name}.npz"

    def content(self, name: str, version: int) -> bytes:
        """Content of a version of a primitive."""
        file = self.file_of(name, version)
        with reading(f"version {version} of '{name}' of the library", PrimitiveError):
            return read_bytes(file, INPUT_LIMITS.primitive_bytes)

    def make(
        self, changes: Sequence[Change], files: Mapping[Path, Content | None]
    ) -> tuple[Change, ...]:
        """Make changes atomically: their files, then their lines of the journal."""
        before = self._journal.read_bytes() if self._journal.exists() else b""
        lines = (json.dumps(asdict(change), sort_keys=True).encode() + b"\n" for change in changes)
        journal = before + b"".join(lines)
        if len(journal) > MAX_JOURNAL_BYTES:
            raise PrimitiveError(f"the journal '{self._journal}' is full: use another library")
        folders = [self.versions / change.name for change in changes]
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        try:
            write_together({**self._restored(), **files, self._journal: journal}, overwrite=True)
        except PlannerError:
            for folder in folders:
                with suppress(OSError):
                    folder.rmdir()  # only if this change created it
            raise
        return tuple(changes)

    def _restored(self) -> dict[Path, bytes | None]:
        """Files in use that differ from those of the journal, with the content of the latter."""
        files: dict[Path, bytes | None] = {}
        for name, version in {c.name: c.version for c in self.history()}.items():
            file = self.file_in_use(name)
            expected = None if version is None else self.content(name, version)
            if _present(file) != expected:
                files[file] = expected
        return files


def _present(file: Path) -> bytes | None:
    """The content of a file, None if it can't be read."""
    try:
        return read_bytes(file, INPUT_LIMITS.primitive_bytes)
    except (OSError, ValueError):
        return None
