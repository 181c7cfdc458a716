# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A folder of primitive files that keeps what was in it, and who changed it.

    library/NAME.npz                 the primitives in use; any reader takes these
    library/.versions/NAME/0001.npz  every version of each, never changed
    library/.versions/journal.jsonl  one line per change

A change is made under a lock, so that several processes may change a library at once. It writes the
version first, then the line of the journal, then the file in use; each of these appears in one
step or not at all. The journal decides: a process that was killed in between leaves files in use
that lag behind it, which the next one to open the library brings up to date.
"""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, PrimitiveError, unknown_name
from ..files import write_whole
from .file import load_primitive, save_primitive
from .primitive import MovementPrimitive

ADD, RETIRE, ROLLBACK = "add", "retire", "rollback"

_LOCK_TIMEOUT = 30.0


@dataclass(frozen=True)
class Change:
    """One line of the journal.

    Attributes
    ----------
    action : {'add', 'retire', 'rollback'}
        What was done.
    name : str
        Name of the primitive.
    version : int or None
        The version in use afterwards; None: none.
    time : str
        When, UTC.
    author : str
        Who.
    package_version : str
        With which release.
    provenance : mapping
        From what: the recordings of the demonstrations, or the primitive it was refined from.
    note : str
        Why, in the author's words.
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
        if self._journal.exists():
            with self._locked():
                self._bring_up_to_date()

    def history(self) -> tuple[Change, ...]:
        """Every change, the oldest first."""
        if not self._journal.exists():
            return ()
        lines = self._journal.read_text(encoding="utf-8").splitlines()
        changes = []
        for number, line in enumerate(lines, start=1):
            try:
                changes.append(Change(**json.loads(line)))
            except (TypeError, ValueError):
                raise PrimitiveError(
                    f"line {number} of '{self._journal}' is damaged: restore it from a copy, or "
                    "delete the line if the change that it stood for may be forgotten"
                ) from None
        return tuple(changes)

    def in_use(self) -> dict[str, int]:
        """Version of each primitive that is in use, by name."""
        latest = {change.name: change.version for change in self.history()}
        return {name: version for name, version in latest.items() if version is not None}

    def add(self, primitive: MovementPrimitive, note: str = "") -> Change:
        """Put a primitive into use; one of the same name is replaced, and kept.

        Raises
        ------
        PrimitiveError
            If its name is no file name, or it moves other joints than those in use.
        """
        name = primitive.name
        if name.startswith(".") or "/" in name or "\0" in name:
            raise PrimitiveError(f"'{name}' can't be the name of a file: give it another --name")
        with self._locked():
            self._check_joints(primitive)
            self._adopt_strangers(name)
            version = self._store(primitive)
            return self._record(ADD, name, version, _provenance(primitive), note)

    def retire(self, name: str, note: str = "") -> Change:
        """Take a primitive out of use; its versions are kept.

        Raises
        ------
        PrimitiveError
            If none of this name is in use.
        """
        with self._locked():
            self._adopt_strangers(name)
            if name not in self.in_use():
                raise PrimitiveError(unknown_name("primitive in use", name, self.in_use()))
            return self._record(RETIRE, name, None, {}, note)

    def roll_back(self, name: str, version: int | None = None, note: str = "") -> Change:
        """Put an earlier version of a primitive into use again.

        Parameters
        ----------
        name : str
            Name of the primitive.
        version : int, optional
            Which; the one that was in use before the present one unless given.
        note : str
            Why.

        Raises
        ------
        PrimitiveError
            If there is no such version.
        """
        with self._locked():
            used = [c.version for c in self.history() if c.name == name]
            if not used:
                names = sorted({c.name for c in self.history()})
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
            return self._record(ROLLBACK, name, version, _provenance(primitive), note)

    def _file_of(self, name: str, version: int) -> Path:
        return self._versions / name / f"{version:04}.npz"

    def _check_joints(self, primitive: MovementPrimitive) -> None:
        for name, version in self.in_use().items():
            other = load_primitive(self._file_of(name, version))
            if name != primitive.name and other.joint_names != primitive.joint_names:
                raise PrimitiveError(
                    f"'{primitive.name}' moves {primitive.joint_names}, but '{name}' of the "
                    f"library moves {other.joint_names}: use another library"
                )

    def _adopt_strangers(self, name: str) -> None:
        """Keep a file that somebody put into the folder by hand before it is replaced."""
        file = self.folder / f"{name}.npz"
        if file.exists() and name not in self.in_use():
            found = load_primitive(file)
            version = self._store(found)
            self._record(ADD, name, version, _provenance(found), "was in the folder already")

    def _store(self, primitive: MovementPrimitive) -> int:
        folder = self._versions / primitive.name
        folder.mkdir(parents=True, exist_ok=True)
        # A version that no line of the journal names was left by a process that was killed.
        taken = [int(path.stem) for path in folder.glob("[0-9]*.npz")]
        version = max(taken, default=0) + 1
        save_primitive(primitive, self._file_of(primitive.name, version))
        return version

    def _record(
        self, action: str, name: str, version: int | None, provenance: Mapping[str, Any], note: str
    ) -> Change:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        change = Change(action, name, version, now, _author(), __version__, provenance, note)
        lines = self._journal.read_bytes() if self._journal.exists() else b""
        line = json.dumps(asdict(change), sort_keys=True).encode() + b"\n"
        write_whole(self._journal, lines + line, overwrite=True)
        self._bring_up_to_date()
        return change

    def _bring_up_to_date(self) -> None:
        """Make the files in use those that the journal names."""
        for name, version in {c.name: c.version for c in self.history()}.items():
            file = self.folder / f"{name}.npz"
            if version is None:
                file.unlink(missing_ok=True)
                continue
            content = self._file_of(name, version).read_bytes()
            if not file.exists() or file.read_bytes() != content:
                write_whole(file, content, overwrite=True)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep other processes from changing the library; a process that dies lets go."""
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
