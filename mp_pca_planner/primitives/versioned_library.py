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

import getpass
import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, PrimitiveError, unknown_name
from ..files import read_bytes, read_text, reading, write_together
from ..json_content import check_form, load_json
from .file import MAX_BYTES, load_primitive, primitive_bytes
from .primitive import MovementPrimitive

ADD, RETIRE, ROLLBACK = "add", "retire", "rollback"

MAX_JOURNAL_BYTES = 64 << 20
"""Largest journal."""
MAX_NAME_BYTES = 200
"""Longest name of a primitive of a library, in UTF-8."""

_LOCK_TIMEOUT = 30.0
_LINE = {
    "action": str,
    "name": str,
    "version": (int, type(None)),
    "time": str,
    "author": str,
    "package_version": str,
    "provenance": dict,
    "note?": str,
}


@dataclass(frozen=True)
class Change:
    """One line of the journal.

    Attributes
    ----------
    action : {'add', 'retire', 'rollback'}
        Kind of change.
    name : str
        Name of the primitive.
    version : int or None
        The version in use afterwards; None: none.
    time : str
        Time of the change, UTC.
    author : str
        User and host.
    package_version : str
        Release that made the change.
    provenance : mapping
        The recordings of the demonstrations, or the primitive it was refined from.
    note : str
        Reason, in the author's words.
    """

    action: str
    name: str
    version: int | None
    time: str
    author: str
    package_version: str
    provenance: Mapping[str, Any]
    note: str = ""


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
        return tuple(_parsed(line, f"line {i} of '{self._journal}'") for i, line in numbered)

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
        name = primitive.name
        check_name(name)
        with self._locked():
            self._check_joints(primitive, [name])
            self._adopt(name)
            return self._add(primitive, note)

    def change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, bytes | None],
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
        note : str
            Reason of the changes.

        Raises
        ------
        PrimitiveError
            If a name is no file name, or a primitive moves other joints than those that stay.
        """
        with self._locked():
            replaced = {*retired, *(primitive.name for primitive in primitives)}
            for primitive in primitives:
                check_name(primitive.name)
                self._check_joints(primitive, replaced)
                self._adopt(primitive.name)
            used = self.in_use()
            changes: list[Change] = []
            files: dict[Path, bytes | None] = {}
            for primitive in primitives:
                content = primitive_bytes(primitive)
                version = used.get(primitive.name)
                if version is None or content != self._content(primitive.name, version):
                    change, new = self._addition(primitive, note)
                    changes.append(change)
                    files |= new
            for name in retired:
                changes.append(_change_now(RETIRE, name, None, {}, note))
                files[self._file_in_use(name)] = None
            files |= {self._versions / name: content for name, content in kept.items()}
            return self._make(changes, files)

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
        with self._locked():
            self._adopt(name)
            if name not in self.in_use():
                raise PrimitiveError(unknown_name("primitive in use", name, self.in_use()))
            change = _change_now(RETIRE, name, None, {}, note)
            return self._make([change], {self._file_in_use(name): None})[0]

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
        with self._locked():
            history = self.history()
            used = [change.version for change in history if change.name == name]
            if not used:
                names = sorted({change.name for change in history})
                raise PrimitiveError(unknown_name("primitive of the library", name, names))
            if version is None:
                before = [v for v in used[:-1] if v is not None and v != used[-1]]
                if not before:
                    raise PrimitiveError(f"there is no earlier version of '{name}'")
                version = before[-1]
            if version not in used:
                valid = ", ".join(str(v) for v in sorted({v for v in used if v is not None}))
                raise PrimitiveError(f"'{name}' has no version {version}; it has {valid}")
            primitive = load_primitive(self._file_of(name, version))
            change = _change_now(ROLLBACK, name, version, _provenance(primitive), note)
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

    def _check_joints(self, primitive: MovementPrimitive, replaced: Collection[str]) -> None:
        """Reject a primitive of other joints than those in use that are not replaced."""
        for name in self.in_use().keys() - set(replaced):
            other = load_primitive(self._file_of(name, self.in_use()[name]))
            if other.joint_names != primitive.joint_names:
                raise PrimitiveError(
                    f"'{primitive.name}' moves {primitive.joint_names}, but '{name}' of the "
                    f"library moves {other.joint_names}: use another library"
                )

    def _adopt(self, name: str) -> None:
        """Keep a file that was copied into the folder as a version before it is replaced."""
        file = self._file_in_use(name)
        if name not in self.in_use() and file.exists():
            self._add(load_primitive(file), "was in the folder already", name)

    def _add(self, primitive: MovementPrimitive, note: str, name: str = "") -> Change:
        change, files = self._addition(primitive, note, name)
        return self._make([change], files)[0]

    def _addition(
        self, primitive: MovementPrimitive, note: str, name: str = ""
    ) -> tuple[Change, dict[Path, bytes | None]]:
        """The change that adds a primitive, and its files."""
        name, content = name or primitive.name, primitive_bytes(primitive)
        known = [c.version or 0 for c in self.history() if c.name == name]
        # A version that the journal does not name was left by a process that was killed.
        free = (v for v in count(max(known, default=0) + 1) if not self._file_of(name, v).exists())
        version = next(free)
        change = _change_now(ADD, name, version, _provenance(primitive), note)
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

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Hold the lock of the library, which ends with the process."""
        try:
            from filelock import FileLock, Timeout
        except ModuleNotFoundError:
            raise MissingDependencyError("filelock", "library", "a versioned library") from None
        try:
            self._versions.mkdir(parents=True, exist_ok=True)
            with FileLock(self._versions / "lock", timeout=_LOCK_TIMEOUT):
                yield
        except Timeout:
            raise PrimitiveError(
                f"the library '{self.folder}' has been locked by another process for "
                f"{_LOCK_TIMEOUT:g} s: try again when it is done"
            ) from None
        except OSError as error:
            raise PlannerError(
                f"the library '{self.folder}' can't be used: {error.strerror or error}"
            ) from None


def _parsed(line: str, where: str) -> Change:
    """The change that a line of the journal describes."""
    try:
        with reading(where, PrimitiveError):
            content = load_json(line)
            check_form(content, _LINE, "it")
            change = Change(**content)
            check_name(change.name)
            version_fits = (change.version is None) == (change.action == RETIRE)
            if change.action not in (ADD, RETIRE, ROLLBACK) or not version_fits:
                raise ValueError(f"there is no '{change.action}' to version {change.version}")
            return change
    except PrimitiveError as error:
        raise PrimitiveError(
            f"{where} is damaged ({error}): restore the journal from a copy, or delete the line if "
            "its change may be lost"
        ) from None


def _present(file: Path) -> bytes | None:
    """The content of a file, None if it can't be read."""
    try:
        return read_bytes(file, MAX_BYTES)
    except (OSError, ValueError):
        return None


def check_name(name: str) -> None:
    """Reject a name that is not a valid file name.

    Raises
    ------
    PrimitiveError
        If the name is empty, hidden, too long, or holds a slash or a NUL.
    """
    try:
        length = len(name.encode())
    except UnicodeEncodeError:
        length = 0
    if not 0 < length <= MAX_NAME_BYTES or name.startswith(".") or "/" in name or "\0" in name:
        raise PrimitiveError(f"{name!r:.80} can't be the name of a file: give it another --name")


def _change_now(
    action: str, name: str, version: int | None, provenance: Mapping[str, Any], note: str
) -> Change:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Change(action, name, version, now, _author(), __version__, provenance, note)


def _author() -> str:
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without an entry for its user
        user = str(os.getuid())
    return f"{user}@{os.uname().nodename}"


def _provenance(primitive: MovementPrimitive) -> dict[str, Any]:
    metadata = primitive.metadata
    if "refined_from" in metadata:
        return {"refined_from": metadata["refined_from"]}
    demonstrations = metadata.get("demonstrations", [])
    return {"recordings": sorted({d["recording"] for d in demonstrations})}
