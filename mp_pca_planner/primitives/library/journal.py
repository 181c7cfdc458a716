# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The journal of a versioned library, one line of JSON for each change, and its lock."""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ... import __version__
from ...exceptions import PlannerError, PrimitiveError, require, shown, unknown_name
from ...files import check_form, load_json, reading
from ..primitive import MovementPrimitive

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


def parsed_change(line: str, where: str) -> Change:
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


def change_now(
    action: str, name: str, version: int | None, provenance: Mapping[str, Any], note: str
) -> Change:
    """A change that this user makes now."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Change(action, name, version, now, _author(), __version__, provenance, note)


def _author() -> str:
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without an entry for its user
        user = str(os.getuid())
    return f"{user}@{os.uname().nodename}"


def provenance_of(primitive: MovementPrimitive) -> dict[str, Any]:
    """The recordings of a primitive, or the primitive that it was refined from."""
    metadata = primitive.metadata
    if "refined_from" in metadata:
        return {"refined_from": metadata["refined_from"]}
    demonstrations = metadata.get("demonstrations", [])
    return {"recordings": sorted({d["recording"] for d in demonstrations})}


def version_to_restore(history: Sequence[Change], name: str, version: int | None) -> int:
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


@contextmanager
def locked(library: Path, versions: Path) -> Iterator[None]:
    """Hold the lock of the library, which ends with the process."""
    filelock = require_locks()
    try:
        versions.mkdir(parents=True, exist_ok=True)
        with filelock.FileLock(versions / "lock", timeout=LOCK_TIMEOUT):
            yield
    except filelock.Timeout:
        raise PrimitiveError(
            f"the library '{library}' has been locked by another process for "
            f"{LOCK_TIMEOUT:g} s: try again when it is done"
        ) from None
    except OSError as error:
        raise PlannerError(
            f"the library '{library}' can't be used: {error.strerror or error}"
        ) from None
