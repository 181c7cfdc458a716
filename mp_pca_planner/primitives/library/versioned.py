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
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import cached_property, partial
from itertools import count
from pathlib import Path

from ...exceptions import PlannerError, PrimitiveError, unknown_name
from ...files import Content, read_bytes, read_text, reading, write_together
from ...input_limits import INPUT_LIMITS
from ..file import load_primitive, primitive_bytes, write_primitive
from ..primitive import MovementPrimitive
from ..primitive_values import require_same_joints
from .journal import (
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


class VersionedLibrary:
    """A folder of primitives with its history, and the changes of it.

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
            raise PrimitiveError(f"the library '{folder}' is not a folder")
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
        where = f"of '{self._journal}'"
        return tuple(parsed_change(line, f"line {i} {where}") for i, line in enumerate(lines, 1))

    def in_use(self) -> dict[str, int]:
        """Version of each primitive that is in use, by name."""
        latest = {change.name: change.version for change in self.history()}
        return {name: version for name, version in latest.items() if version is not None}

    def kept(self, name: str) -> Path:
        """Path of a file that is kept beside the versions, see :meth:`change`."""
        return self._versions / name

    def add(self, primitive: MovementPrimitive, note: str = "") -> Change:
        """Put a primitive into use; an earlier one of the same name is kept as a version.

        Raises
        ------
        PrimitiveError
            If its name is no file name, or it moves other joints than those in use.
        """
        with self._locked() as library:
            return library.make([primitive], [], {}, note)[-1]

    def change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, Content | None],
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
        with self._locked() as library:
            if len(library.history()) != n_before:
                raise PrimitiveError(f"the library '{self.folder}' changed meanwhile: try again")
            used = library.in_use()
            new = [
                primitive
                for primitive in primitives
                if primitive.name not in used
                or primitive_bytes(primitive) != self._content(primitive.name, used[primitive.name])
            ]
            return library.make(new, retired, kept, note)

    def retire(self, name: str, note: str = "") -> Change:
        """Take a primitive out of use; its versions are kept.

        Raises
        ------
        PrimitiveError
            If none of this name is in use.
        """
        with self._locked() as library:
            used = library.in_use()
            if name not in used and not self._file(name).exists():
                raise PrimitiveError(unknown_name("primitive in use", name, used))
            return library.make([], [name], {}, note)[-1]

    def roll_back(self, name: str, version: int | None = None, note: str = "") -> Change:
        """Put an earlier version of a primitive into use again.

        Parameters
        ----------
        name, version : str, int or None
            Its name and version; by default the one that was in use before the present one.
        note : str
            Reason of the change.

        Raises
        ------
        PrimitiveError
            If there is no such version.
        """
        with self._locked() as library:
            return library.make_rollback(name, version, note)

    @contextmanager
    def _locked(self) -> Iterator[_LockedLibrary]:
        """Hold the lock of the library, which changes it."""
        with locked(self.folder, self._versions):
            yield _LockedLibrary(self.folder)

    def _file(self, name: str, version: int | None = None) -> Path:
        """Path of a primitive in use, or of a version."""
        in_use = self.folder / f"{name}.npz"
        return in_use if version is None else self._versions / name / f"{version:04}.npz"

    def _content(self, name: str, version: int) -> bytes:
        """Content of a version of a primitive."""
        with reading(f"version {version} of '{name}' of the library", PrimitiveError):
            return read_bytes(self._file(name, version), INPUT_LIMITS.primitive_bytes)


class _LockedLibrary(VersionedLibrary):
    """A library under its lock; its history, which no other process changes, is read once."""

    @cached_property
    def _known(self) -> tuple[Change, ...]:
        return super().history()

    def history(self) -> tuple[Change, ...]:
        """Every change before, the oldest first."""
        return self._known

    def make(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, Content | None],
        note: str,
    ) -> tuple[Change, ...]:
        """Make changes; files that were copied into the folder are kept as versions first."""
        for primitive in primitives:
            check_name(primitive.name)
        history, used = self.history(), self.in_use()
        self._check_joints(primitives, retired)
        replaced = [*(primitive.name for primitive in primitives), *retired]
        copied = [name for name in replaced if name not in used and self._file(name).exists()]
        additions = [
            (name, load_primitive(self._file(name)), "was there before") for name in copied
        ]
        additions += [(primitive.name, primitive, note) for primitive in primitives]
        changes: list[Change] = []
        files: dict[Path, Content | None] = {}
        for name, primitive, reason in additions:
            known = max((c.version or 0 for c in (*history, *changes) if c.name == name), default=0)
            # A version that the journal does not name was left by a process that was killed.
            version = next(n for n in count(known + 1) if not self._file(name, n).exists())
            changes.append(change_now(ADD, name, version, provenance_of(primitive), reason))
            content = partial(write_primitive, primitive)
            files |= {self._file(name, version): content, self._file(name): content}
        for name in retired:
            changes.append(change_now(RETIRE, name, None, {}, note))
            files[self._file(name)] = None
        return self._make(changes, files | {self.kept(name): x for name, x in kept.items()})

    def make_rollback(self, name: str, version: int | None, note: str) -> Change:
        """See :meth:`VersionedLibrary.roll_back`."""
        version = version_to_restore(self.history(), name, version)
        primitive = load_primitive(self._file(name, version))
        self._check_joints([primitive], [])
        change = change_now(ROLLBACK, name, version, provenance_of(primitive), note)
        return self._make([change], {self._file(name): self._content(name, version)})[0]

    def _check_joints(
        self, primitives: Sequence[MovementPrimitive], retired: Collection[str]
    ) -> None:
        """Reject primitives of other joints than those that stay in use, or than each other."""
        replaced = {*retired, *(primitive.name for primitive in primitives)}
        stays = [item for item in self.in_use().items() if item[0] not in replaced]
        # All that stay move the same joints: the first one is enough.
        known = [load_primitive(self._file(*item)) for item in stays[:1]] if primitives else []
        movers = [(f"'{x.name}' of the library", x.joint_names) for x in known]
        require_same_joints([*movers, *((f"'{x.name}'", x.joint_names) for x in primitives)])

    def _make(
        self, changes: Sequence[Change], files: Mapping[Path, Content | None]
    ) -> tuple[Change, ...]:
        """Make changes atomically: their files, then their lines of the journal."""
        before = self._journal.read_bytes() if self._journal.exists() else b""
        lines = (json.dumps(asdict(change), sort_keys=True).encode() + b"\n" for change in changes)
        journal = before + b"".join(lines)
        if len(journal) > MAX_JOURNAL_BYTES:
            raise PrimitiveError(f"the journal '{self._journal}' is full: use another library")
        with _new_folders(self._versions / change.name for change in changes):
            write_together({**self._restored(), **files, self._journal: journal}, overwrite=True)
        return tuple(changes)

    def _restored(self) -> dict[Path, bytes | None]:
        """Files in use that differ from those of the journal, with the content of the latter."""
        files: dict[Path, bytes | None] = {}
        for name, version in {c.name: c.version for c in self.history()}.items():
            expected = None if version is None else self._content(name, version)
            file, present = self._file(name), None
            with suppress(OSError, ValueError):
                present = read_bytes(file, INPUT_LIMITS.primitive_bytes)
            if present != expected:
                files[file] = expected
        return files


@contextmanager
def _new_folders(folders: Iterable[Path]) -> Iterator[None]:
    """Make folders, and remove them after an error if they are empty."""
    made = list(folders)
    for folder in made:
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except PlannerError:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise
