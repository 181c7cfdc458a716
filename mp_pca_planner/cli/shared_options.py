# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands have."""

from __future__ import annotations

from .option_types import Stop
from .parser import Options

NODE = "mp_pca_planner"
"""Name of the planner's node."""


def add_report_options(add: Options, written: str | None = "files") -> None:
    """Add ``--json`` and, for files that are written, ``--force``."""
    if written is not None:
        add.flag("--force", f"overwrite {written}")
    add.flag("--json", "print one JSON object")


def add_node_options(add: Options) -> None:
    """Add the name and the namespace of the planner's node."""
    add("--node NAME", "name of the node", default=NODE)
    add("--namespace NS", "namespace of the node", default="")


def add_via(add: Options, form: str, text: str, *, with_stops: bool = False) -> None:
    """Add ``--via`` and ``--stop``; the values of both stand in order in ``via``."""
    add(f"--via {form}", f"{text}; may be repeated", str, [], action="append")
    if with_stops:
        text = "likewise, with a stop there"
        add(f"--stop {form}", text, Stop, [], action="append", dest="via")
