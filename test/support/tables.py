# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of the benchmarks: as text, or with ``--json`` as scripts/record_results.py reads them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

from mp_pca_planner.arrays import text_table
from mp_pca_planner.cli.common import plain

Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""A header and rows of text."""


def benchmark_parser(documentation: str) -> argparse.ArgumentParser:
    """A parser with the option ``--json``; its description is the first line of a text."""
    parser = argparse.ArgumentParser(description=documentation.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the tables as JSON")
    return parser


def options(
    documentation: str, arguments: Sequence[str] | None = None, **defaults: Any
) -> argparse.Namespace:
    """Options of a campaign by their defaults; False is a flag, a dictionary of parts a choice."""
    parser = argparse.ArgumentParser(description=documentation.splitlines()[0])
    for name, default in defaults.items():
        how: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            how = {"action": "store_true"}
        if isinstance(default, Mapping):
            parser.add_argument(name, choices=default)
        else:
            parser.add_argument(f"--{name.replace('_', '-')}", **how)
    return parser.parse_args(arguments)


def show(
    tables: Mapping[str, Table],
    *,
    as_json: bool,
    facts: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Print tables by their titles, with notes below; as JSON with further facts."""
    if as_json:
        named = {title: {"header": h, "rows": rows} for title, (h, rows) in tables.items()}
        print(json.dumps(plain({"tables": named, **(facts or {})}), ensure_ascii=False))
        return
    for title, (header, rows) in tables.items():
        print(f"{title}\n{text_table(rows, header=header)}\n")
    print("\n".join(notes))
