# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A folder of primitive files with all earlier versions and a journal of changes.

    library/NAME.npz                 the primitives in use; any reader takes these
    library/.versions/NAME/0001.npz  every version of each, never changed
    library/.versions/journal.jsonl  one line per change

A change is made under a lock, so that several processes may change a library at once. Its files are
written to temporary names first; then the version, the file in use and the journal are renamed,
each atomically. The journal is authoritative: a change that is not in it was not made, and the next
change first restores the files in use. Reading the history changes nothing.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from itertools import count
from pathlib import Path

from ..exceptions import PlannerError, PrimitiveError, unknown_name
from ..files import read_bytes, read_text, reading, write_together
from .file import MAX_BYTES, load_primitive, primitive_bytes
from .library_journal import (
    ADD,
    MAX_JOURNAL_BYTES,
    RETIRE,
    ROLLBACK,
    Change,
    change_now,
    check_name,
    locked,
    parsed_change,
    provenance_of,
    version_to_restore,
)
from .primitive import MovementPrimitive


class VersionedLibrary:
    """A folder of primitives with its history.

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
        self._versions = self.folder / ".versions"
        self._journal = self._versions / "journal.jsonl"
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

    def add(self, primitive: MovementPrimitive, note: str = "") -> Change:
        """Put a primitive into use; an earlier one of the same name is kept as a version.

        Raises
        ------
        PrimitiveError
            If its name is no file name, or it moves other joints than those in use.
        """
        with locked(self.folder, self._versions):
            return self._change([primitive], [], {}, note)[0]

    def change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, bytes | None],
        *,
        n_before: int,
        note: str = "",
    ) -> tuple[Change, ...]:
        """Put primitives into use and take others out of use, all together or none.

        Parameters
        ----------
        primitives :
            The primitives; one that is in use as it is does not change.
        retired :
            Names of primitives in use.
        kept :
            Content of files to keep beside the versions, by name; None: the file is deleted.
        n_before : int
            Number of changes in the history that these ones are based on.
        note : str
            Reason of the changes.

        Raises
        ------
        PrimitiveError
            If a name is no file name, a primitive moves other joints than those that stay, or
            another process has changed the library meanwhile.
        """
        with locked(self.folder, self._versions):
            if len(self.history()) != n_before:
                raise PrimitiveError(f"the library '{self.folder}' changed meanwhile: try again")
            used = self.in_use()
            new = [
                primitive
                for primitive in primitives
                if primitive.name not in used
                or primitive_bytes(primitive) != self._content(primitive.name, used[primitive.name])
            ]
            return self._change(new, retired, kept, note)

    def kept(self, name: str) -> Path:
        """Path of a file that is kept beside the versions, see :meth:`change`."""
        return self._versions / name

    def retire(self, name: str, note: str = "") -> Change:
        """Take a primitive out of use; its versions are kept.

        Raises
        ------
        PrimitiveError
            If none of this name is in use.
        """
        with locked(self.folder, self._versions):
            self._adopt(name)
            if name not in self.in_use():
                raise PrimitiveError(unknown_name("primitive in use", name, self.in_use()))
            return self._change([], [name], {}, note)[0]

    def roll_back(self, name: str, version: int | None = None, note: str = "") -> Change:
        """Put an earlier version of a primitive into use again.

        Parameters
        ----------
        name : str
            Name of the primitive.
        version : int, optional
            The version; the one that was in use before the present one unless given.
        note : str
            Reason of the change.

        Raises
        ------
        PrimitiveError
            If there is no such version.
        """
        with locked(self.folder, self._versions):
            version = version_to_restore(self.history(), name, version)
            primitive = load_primitive(self._file_of(name, version))
            change = change_now(ROLLBACK, name, version, provenance_of(primitive), note)
            files = {self._file_in_use(name): self._content(name, version)}
            return self._make([change], files)[0]

    def _file_of(self, name: str, version: int) -> Path:
        return self._versions / name / f"{version:04}.npz"

    def _file_in_use(self, name: str) -> Path:
        return self.folder / f"{name}.npz"

    def _content(self, name: str, version: int) -> bytes:
        file = self._file_of(name, version)
        with reading(f"version {version} of '{name}' of the library", PrimitiveError):
            return read_bytes(file, MAX_BYTES)

    def _change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, bytes | None],
        note: str,
    ) -> tuple[Change, ...]:
        for primitive in primitives:
            check_name(primitive.name)
        self._check_joints(primitives, retired)
        for primitive in primitives:
            self._adopt(primitive.name)
        changes: list[Change] = []
        files: dict[Path, bytes | None] = {}
        for primitive in primitives:
            change, own = self._addition(primitive, note)
            changes.append(change)
            files |= own
        for name in retired:
            changes.append(change_now(RETIRE, name, None, {}, note))
            files[self._file_in_use(name)] = None
        files |= {self._versions / name: content for name, content in kept.items()}
        return self._make(changes, files)

    def _check_joints(
        self, primitives: Sequence[MovementPrimitive], retired: Collection[str]
    ) -> None:
        """Reject primitives of other joints than those that stay in use."""
        replaced = {*retired, *(primitive.name for primitive in primitives)}
        for name, version in self.in_use().items():
            if name in replaced or not primitives:
                continue
            other = load_primitive(self._file_of(name, version))
            for primitive in primitives:
                if other.joint_names != primitive.joint_names:
                    raise PrimitiveError(
                        f"'{primitive.name}' moves {primitive.joint_names}, but '{name}' of the "
                        f"library moves {other.joint_names}: use another library"
                    )

    def _adopt(self, name: str) -> None:
        """Keep a file that was copied into the folder as a version before it is replaced."""
        file = self._file_in_use(name)
        if name not in self.in_use() and file.exists():
            change, files = self._addition(load_primitive(file), "was in the folder already", name)
            self._make([change], files)

    def _addition(
        self, primitive: MovementPrimitive, note: str, name: str = ""
    ) -> tuple[Change, dict[Path, bytes | None]]:
        """The change that adds a primitive, and its files."""
        name, content = name or primitive.name, primitive_bytes(primitive)
        known = [c.version or 0 for c in self.history() if c.name == name]
        # A version that the journal does not name was left by a process that was killed.
        free = (v for v in count(max(known, default=0) + 1) if not self._file_of(name, v).exists())
        version = next(free)
        change = change_now(ADD, name, version, provenance_of(primitive), note)
        return change, {self._file_of(name, version): content, self._file_in_use(name): content}

    def _make(
        self, changes: Sequence[Change], files: Mapping[Path, bytes | None]
    ) -> tuple[Change, ...]:
        """Make changes atomically: their files, then their lines of the journal."""
        before = self._journal.read_bytes() if self._journal.exists() else b""
        lines = (json.dumps(asdict(change), sort_keys=True).encode() + b"\n" for change in changes)
        journal = before + b"".join(lines)
        if len(journal) > MAX_JOURNAL_BYTES:
            raise PrimitiveError(f"the journal '{self._journal}' is full: use another library")
        folders = [self._versions / change.name for change in changes]
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
            file = self._file_in_use(name)
            expected = None if version is None else self._content(name, version)
            if _present(file) != expected:
                files[file] = expected
        return files


def _present(file: Path) -> bytes | None:
    """The content of a file, None if it can't be read."""
    try:
        return read_bytes(file, MAX_BYTES)
    except (OSError, ValueError):
        return None
