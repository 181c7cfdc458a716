# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Tables and shares as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..exceptions import printable


def table(rows: Sequence[Sequence[str]], *, header: Sequence[str]) -> str:
    """Lines of columns, the first aligned left, the others right; unprintable text is escaped."""
    lines = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def percent(share: float) -> str:
    """A share as a percentage with two decimals, as in [P] Table 2."""
    return f"{100.0 * share:.2f}"


Column = tuple[str, str, float]
"""Name of a value, its format, and the factor of its unit."""


def cells(values: Mapping[str, float | None], columns: Mapping[str, Column]) -> list[str]:
    """Values of a row as text, one for each column by its header; a dash for None."""
    chosen = [(values[name], form, factor) for name, form, factor in columns.values()]
    return ["–" if x is None else format(factor * x, form) for x, form, factor in chosen]
