# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shares of the variance of a primitive, beside those of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..evaluation.paper import TABLE_2
from ..primitives.primitive import MovementPrimitive
from .page import Table
from .text import percent, table


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
    """Shares of the variance, of the shapes and of the joint angles beside [P] Table 2."""
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
    beside = ""
    if is_arm_of_paper(angles):
        beside = ", as in Table 2 of the paper"
        header += ["paper PC1", "PC2"]
        for row in rows:
            row += percents(TABLE_2[row[0]], 2)
    lines += ["", f"Variance of the joint angles themselves{beside} [%]"]
    return [*lines, *table(rows, header=header).splitlines()]


def is_arm_of_paper(joint_names: Iterable[str]) -> bool:
    """Whether these are the joints of the paper's arm."""
    return set(joint_names) == set(TABLE_2)
