# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`library`: a folder of primitives that keeps its history."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..exceptions import PrimitiveError
from ..plotting.text import table
from ..primitives.file import load_primitive
from ..primitives.versioned_library import Change, VersionedLibrary
from .common import CommandParser, print_json, run
from .terminal import DONE, say

ACTIONS = ("list", "history", "add", "retire", "rollback")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = CommandParser(
        "library",
        "Add primitives to a folder, retire them, or roll them back to an earlier version. Every "
        "version is kept, every change recorded; `plan` and the node take the folder as it is.",
    )
    parser.add_argument("action", choices=ACTIONS, help="what to do")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the library")
    parser.add_argument(
        "what", nargs="*", metavar="FILE|NAME", help="files to add, or names of primitives"
    )
    parser.add_argument("--version", type=int, metavar="N", help="version to roll back to")
    parser.add_argument("--note", default="", help="why, for the history")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return run(parser, _library, argv)


def _library(arguments: argparse.Namespace) -> int:
    action, what = arguments.action, arguments.what
    if action in ("add", "retire", "rollback") and not what:
        raise PrimitiveError(f"'library {action}' needs at least one file or name after the folder")
    if arguments.version is not None and (action != "rollback" or len(what) != 1):
        raise PrimitiveError("--version goes with 'rollback' of one primitive")
    if action in ("list", "history") and not arguments.folder.is_dir():
        raise PrimitiveError(f"there is no library '{arguments.folder}'")
    library = VersionedLibrary(arguments.folder)
    if action in ("list", "history"):
        changes = library.history()
        if action == "list":
            latest = {change.name: change for change in changes}
            changes = tuple(c for c in latest.values() if c.version is not None)
    elif action == "add":
        # All are read before any is added.
        primitives = [load_primitive(file) for file in what]
        changes = tuple(library.add(primitive, arguments.note) for primitive in primitives)
    elif action == "retire":
        changes = tuple(library.retire(name, arguments.note) for name in what)
    else:
        changes = tuple(library.roll_back(name, arguments.version, arguments.note) for name in what)
    if arguments.json:
        print_json({"changes": [asdict(change) for change in changes]})
    else:
        say(*_text(changes).splitlines())
    return DONE


def _text(changes: Sequence[Change]) -> str:
    rows = [
        [
            change.name,
            "-" if change.version is None else str(change.version),
            change.action,
            change.time,
            change.author,
            change.note,
        ]
        for change in changes
    ]
    return table(rows, header=["primitive", "version", "change", "time", "author", "note"])
