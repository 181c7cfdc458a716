# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`library`: a folder of primitives that keeps its history."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict

from ..arrays import text_table
from ..exceptions import PrimitiveError
from ..primitives.file import load_primitive
from ..primitives.library import Change, VersionedLibrary
from .common import report
from .terminal import DONE


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    changes = _changes(arguments)
    content = {"changes": [asdict(change) for change in changes]}
    report(arguments, content, *_text(changes).splitlines())
    return DONE


def _changes(arguments: argparse.Namespace) -> Sequence[Change]:
    """The changes that the action makes or lists."""
    action, what, note = arguments.action, arguments.what, arguments.note
    is_reading = action in ("list", "history")
    if not is_reading and not what:
        raise PrimitiveError(f"'library {action}' needs at least one file or name after the folder")
    if arguments.version is not None and (action != "rollback" or len(what) != 1):
        raise PrimitiveError("--version is for 'rollback' of one primitive")
    if is_reading and not arguments.folder.is_dir():
        raise PrimitiveError(f"there is no library '{arguments.folder}'")
    library = VersionedLibrary(arguments.folder)
    if action == "history":
        return library.history()
    if action == "list":
        latest = {change.name: change for change in library.history()}
        return [change for change in latest.values() if change.version is not None]
    if action == "add":
        # All files are read before the first one is added.
        return [library.add(new, note) for new in [load_primitive(file) for file in what]]
    if action == "retire":
        return [library.retire(name, note) for name in what]
    return [library.roll_back(name, arguments.version, note) for name in what]


def _text(changes: Sequence[Change]) -> str:
    header = ["primitive", "version", "change", "time", "author", "note"]
    rows = [
        [c.name, "-" if c.version is None else str(c.version), c.action, c.time, c.author, c.note]
        for c in changes
    ]
    return text_table(rows, header=header)
