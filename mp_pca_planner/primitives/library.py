# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sets of primitives that are used together: in memory, and in folders that keep all versions."""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Collection, Iterable, Iterator, KeysView, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cached_property, partial
from itertools import count
from pathlib import Path
from typing import Any, overload

import numpy as np

from .. import __version__
from ..arrays import FloatArray, check_type, repeated_names
from ..exceptions import (
    GoalError,
    PlannerError,
    PrimitiveError,
    quote_names,
    require,
    shown,
    unknown_name,
)
from ..files import (
    Content,
    check_form,
    read_bytes,
    read_text,
    reading,
    write_together,
)
from ..input_limits import INPUT_LIMITS
from .file import load_primitive, primitive_bytes, write_primitive
from .primitive import MovementPrimitive
from .primitive_values import require_same_joints

# Largest number of ends of demonstrations from which poses are searched.
_MAX_ENDS = 5000


class PrimitiveLibrary(Sequence[MovementPrimitive]):
    """Primitives of the same joints with different names.

    Parameters
    ----------
    primitives : sequence of MovementPrimitive
        The primitives, at least one.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.
    means : array, shape (n_primitives, 2 n_joints + 1)
        Their mean requests, see :class:`.ConditionalModel`.
    precisions : array, shape (n_primitives, 2 n_joints + 1, 2 n_joints + 1)
        Inverse covariances of their requests.

    Raises
    ------
    PrimitiveError
        If there is no primitive, two have the same name, they move different joints, or one is
        something else, such as a path.
    """

    def __init__(self, primitives: Sequence[MovementPrimitive]) -> None:
        if not primitives:
            raise PrimitiveError("at least one primitive is needed, got none")
        for one in primitives:
            if not isinstance(one, MovementPrimitive):
                raise PrimitiveError(
                    f"{shown(one)} is not a movement primitive; MovementPrimitive.load reads a file"
                )
        require_same_joints((f"primitive '{p.name}'", p.joint_names) for p in primitives)
        self._index_of = {p.name: i for i, p in enumerate(primitives)}
        if len(self._index_of) < len(primitives):
            twice = repeated_names(p.name for p in primitives)
            raise PrimitiveError(f"several primitives are called {quote_names(twice)}")
        self._primitives = tuple(primitives)
        self.joint_names = primitives[0].joint_names
        self.means = np.array([p.model.mean for p in primitives])
        self.precisions = np.array([p.model.request_precision for p in primitives])

    @classmethod
    def of(cls, primitives: MovementPrimitive | Sequence[MovementPrimitive]) -> PrimitiveLibrary:
        """The library of some primitives, or of a single one; a library is returned as it is."""
        if isinstance(primitives, PrimitiveLibrary):
            return primitives
        return cls(primitives if isinstance(primitives, Sequence) else [primitives])

    @property
    def names(self) -> KeysView[str]:
        """Their names."""
        return self._index_of.keys()

    @cached_property
    def ends(self) -> FloatArray:
        """Starts and goals of demonstrations, shape (n_motions, 2, n_joints)."""
        ends = np.concatenate([p.boundary_states[:, [0, 3]] for p in self])
        return ends[:: -(-len(ends) // _MAX_ENDS)]

    def named(self, name: str) -> MovementPrimitive:
        """The primitive of that name.

        Raises
        ------
        GoalError
            If there is none.
        """
        self.check_name(name)
        return self[self._index_of[name]]

    def check_name(self, name: str) -> None:
        """Reject a name that no primitive has, see :meth:`named`."""
        check_type(name, "the name of a primitive", GoalError, str)
        if name not in self._index_of:
            raise GoalError(unknown_name("primitive", name, self._index_of))

    def __len__(self) -> int:
        return len(self._index_of)

    @overload
    def __getitem__(self, index: int) -> MovementPrimitive: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[MovementPrimitive]: ...
    def __getitem__(self, index: int | slice) -> MovementPrimitive | Sequence[MovementPrimitive]:
        return self._primitives[index]


def load_primitives(paths: Sequence[str | Path]) -> PrimitiveLibrary:
    """Read primitive files that are to be used together.

    Parameters
    ----------
    paths :
        Files, and folders of .npz files in the order of their names.

    Raises
    ------
    PrimitiveError
        If there is none, a file is rejected, two primitives have the same name, or they move
        different joints.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        found = sorted(path.glob("*.npz"), key=str) if path.is_dir() else [path]
        if not found:
            raise PrimitiveError(f"the folder '{path}' holds no primitive file (.npz)")
        files += found
    if not files:
        raise PrimitiveError("no primitive file was named")
    primitives, file_of = [], dict[str, Path]()
    for file in files:
        primitives.append(load_primitive(file))
        name = primitives[-1].name
        if name in file_of:
            raise PrimitiveError(
                f"'{file}' and '{file_of[name]}' both hold a primitive called '{name}': build "
                "one of them again under another name"
            )
        file_of[name] = file
    require_same_joints((f"'{file_of[p.name]}'", p.joint_names) for p in primitives)
    return PrimitiveLibrary(primitives)


ADD, RETIRE, ROLLBACK = "add", "retire", "rollback"

MAX_JOURNAL_BYTES = 64 << 20
"""Largest journal."""
MAX_NAME_BYTES = 200
"""Longest name of a primitive of a library, in UTF-8."""

LOCK_TIMEOUT = 30.0
"""Time to wait for another process that changes the library [s]."""

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
        return tuple(_parsed_change(line, f"line {i} {where}") for i, line in enumerate(lines, 1))

    def in_use(self) -> dict[str, int]:
        """Version of each primitive that is in use, by name."""
        return _in_use(self.history())

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
        with self._locked() as history:
            return self._put(history, [primitive], [], {}, note)[-1]

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
        with self._locked() as history:
            if len(history) != n_before:
                raise PrimitiveError(f"the library '{self.folder}' changed meanwhile: try again")
            used = _in_use(history)
            new = [
                primitive
                for primitive in primitives
                if primitive.name not in used
                or primitive_bytes(primitive) != self._content(primitive.name, used[primitive.name])
            ]
            return self._put(history, new, retired, kept, note)

    def retire(self, name: str, note: str = "") -> Change:
        """Take a primitive out of use; its versions are kept.

        Raises
        ------
        PrimitiveError
            If none of this name is in use.
        """
        with self._locked() as history:
            used = _in_use(history)
            if name not in used and not self._file(name).exists():
                raise PrimitiveError(unknown_name("primitive in use", name, used))
            return self._put(history, [], [name], {}, note)[-1]

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
        with self._locked() as history:
            version = _version_to_restore(history, name, version)
            primitive = load_primitive(self._file(name, version))
            self._check_joints(history, [primitive], [])
            change = _change_now(ROLLBACK, name, version, note, primitive)
            files = {self._file(name): self._content(name, version)}
            return self._make(history, [change], files)[0]

    @contextmanager
    def _locked(self) -> Iterator[tuple[Change, ...]]:
        """Hold the lock of the library; yields its history, which no other process changes then."""
        filelock = require_locks()
        try:
            self._versions.mkdir(parents=True, exist_ok=True)
            with filelock.FileLock(self._versions / "lock", timeout=LOCK_TIMEOUT):
                yield self.history()
        except filelock.Timeout:
            raise PrimitiveError(
                f"the library '{self.folder}' has been locked by another process for "
                f"{LOCK_TIMEOUT:g} s: try again when it is done"
            ) from None
        except OSError as error:
            raise PlannerError(
                f"the library '{self.folder}' can't be used: {error.strerror or error}"
            ) from None

    def _file(self, name: str, version: int | None = None) -> Path:
        """Path of a primitive in use, or of a version."""
        in_use = self.folder / f"{name}.npz"
        return in_use if version is None else self._versions / name / f"{version:04}.npz"

    def _content(self, name: str, version: int) -> bytes:
        """Content of a version of a primitive."""
        with reading(f"version {version} of '{name}' of the library", PrimitiveError):
            return read_bytes(self._file(name, version), INPUT_LIMITS.primitive_bytes)

    def _put(
        self,
        history: Sequence[Change],
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, Content | None],
        note: str,
    ) -> tuple[Change, ...]:
        """Make changes; files that were copied into the folder are kept as versions first."""
        for primitive in primitives:
            check_name(primitive.name)
        used = _in_use(history)
        self._check_joints(history, primitives, retired)
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
            changes.append(_change_now(ADD, name, version, reason, primitive))
            content = partial(write_primitive, primitive)
            files |= {self._file(name, version): content, self._file(name): content}
        for name in retired:
            changes.append(_change_now(RETIRE, name, None, note))
            files[self._file(name)] = None
        return self._make(
            history, changes, files | {self.kept(name): x for name, x in kept.items()}
        )

    def _check_joints(
        self,
        history: Sequence[Change],
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
    ) -> None:
        """Reject primitives of other joints than those that stay in use, or than each other."""
        replaced = {*retired, *(primitive.name for primitive in primitives)}
        stays = [item for item in _in_use(history).items() if item[0] not in replaced]
        # All that stay move the same joints: the first one is enough.
        known = [load_primitive(self._file(*item)) for item in stays[:1]] if primitives else []
        movers = [(f"'{x.name}' of the library", x.joint_names) for x in known]
        require_same_joints([*movers, *((f"'{x.name}'", x.joint_names) for x in primitives)])

    def _make(
        self,
        history: Sequence[Change],
        changes: Sequence[Change],
        files: Mapping[Path, Content | None],
    ) -> tuple[Change, ...]:
        """Make changes atomically: their files, then their lines of the journal."""
        before = self._journal.read_bytes() if self._journal.exists() else b""
        lines = (json.dumps(asdict(change), sort_keys=True).encode() + b"\n" for change in changes)
        journal = before + b"".join(lines)
        if len(journal) > MAX_JOURNAL_BYTES:
            raise PrimitiveError(f"the journal '{self._journal}' is full: use another library")
        with _new_folders(self._versions / change.name for change in changes):
            write_together(
                {**self._restored(history), **files, self._journal: journal}, overwrite=True
            )
        return tuple(changes)

    def _restored(self, history: Sequence[Change]) -> dict[Path, bytes | None]:
        """Files in use that differ from those of the journal, with the content of the latter."""
        files: dict[Path, bytes | None] = {}
        for name, version in {c.name: c.version for c in history}.items():
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


def _parsed_change(line: str, where: str) -> Change:
    """The change that a line of the journal describes."""
    try:
        with reading(where, PrimitiveError):
            content = json.loads(line)
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
        raise PrimitiveError(f"{shown(name)} can't be the name of a file: choose another")


def _in_use(history: Sequence[Change]) -> dict[str, int]:
    """Version of each primitive that is in use after some changes, by name."""
    latest = {change.name: change.version for change in history}
    return {name: version for name, version in latest.items() if version is not None}


def _change_now(
    action: str,
    name: str,
    version: int | None,
    note: str,
    primitive: MovementPrimitive | None = None,
) -> Change:
    """A change that this user makes now."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without an entry for its user
        user = str(os.getuid())
    provenance: dict[str, Any] = {}
    if primitive is not None and "refined_from" in primitive.metadata:
        provenance = {"refined_from": primitive.metadata["refined_from"]}
    elif primitive is not None:
        demonstrations = primitive.metadata.get("demonstrations", [])
        provenance = {"recordings": sorted({d["recording"] for d in demonstrations})}
    now, author = datetime.now(UTC).isoformat(timespec="seconds"), f"{user}@{os.uname().nodename}"
    return Change(action, name, version, now, author, __version__, provenance, note)


def _version_to_restore(history: Sequence[Change], name: str, version: int | None) -> int:
    """The version of a primitive to go back to; None: the one in use before the present one.

    Raises
    ------
    PrimitiveError
        If there is no such version.
    """
    used = [change.version for change in history if change.name == name]
    if not used:
        names = sorted({change.name for change in history})
        raise PrimitiveError(unknown_name("primitive of the library", name, names))
    if version is None:
        before = [v for v in used[:-1] if v is not None and v != used[-1]]
        if not before:
            raise PrimitiveError(f"there is no earlier version of '{name}'")
        return before[-1]
    if version not in used:
        valid = ", ".join(str(v) for v in sorted({v for v in used if v is not None}))
        raise PrimitiveError(f"'{name}' has no version {version}; it has {valid}")
    return version


def require_locks() -> Any:
    """The module of locks, without which a library can't be changed.

    Raises
    ------
    MissingDependencyError
        If filelock is not installed.
    """
    return require("filelock", "library", "a versioned library")
