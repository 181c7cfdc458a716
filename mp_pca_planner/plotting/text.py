# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Tables and shares of the variance as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..evaluation.paper import TABLE_2
from ..exceptions import printable
from ..primitives.primitive import MovementPrimitive
from .page import Table


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


Column = tuple[str, str, str]
"""Name of a value, its format, and its unit in the table if that is not the SI unit."""


def cells(values: Mapping[str, float | None], columns: Mapping[str, Column]) -> list[str]:
    """Values of a row as text, one for each column by its header; a dash for None."""
    factors = {"": 1.0, "%": 100.0, "ms": 1e3, "mm": 1e3, "mrad": 1e3}
    chosen = [(values[name], form, factors[unit]) for name, form, unit in columns.values()]
    return ["–" if x is None else format(factor * x, form) for x, form, factor in chosen]


def variance_table(shares: Mapping[str, Sequence[float]], n_components: int | None = None) -> Table:
    """Shares of the variance by component, and their sums [%].

    Parameters
    ----------
    shares :
        By the names of the rows.
    n_components :
        Number of columns; by default as many as the longest row has.
    """
    n = max(map(len, shares.values()), default=0) if n_components is None else n_components
    rows = [[name, *percents(values, n), percent(sum(values))] for name, values in shares.items()]
    return Table(["", *(f"PC{k + 1}" for k in range(n)), "sum"], rows)


def percents(values: Sequence[float], n: int) -> list[str]:
    """The first n shares [%], with empty texts where there are fewer."""
    return [percent(values[k]) if k < len(values) else "" for k in range(n)]


def variance_report(primitive: MovementPrimitive) -> list[str]:
    """Shares of the variance of the shapes and of the joint angles."""
    shares = primitive.explained_variance_ratio
    header, rows = variance_table(shares)
    lines = ["Variance of the shapes (motions less their boundary parts) [%]"]
    lines += table(rows, header=header).splitlines()
    for name, values in shares.items():
        if values and sum(values) < 0.99:
            lines.append(
                f"'{name}': {len(values)} components explain {percent(sum(values))} %, "
                f"{percent(0.99 - sum(values))} less than 99 %"
            )
    angles = primitive.metadata["angle_variance_ratio"]
    header, rows = variance_table(angles, 4)
    lines += ["", "Variance of the joint angles themselves [%]"]
    return [*lines, *table(rows, header=header).splitlines()]


def is_arm_of_paper(joint_names: Iterable[str]) -> bool:
    """Whether these are the joints of the paper's arm."""
    return set(joint_names) == set(TABLE_2)
