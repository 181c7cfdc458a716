# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shares of the variance of a primitive, beside those of the paper."""

from __future__ import annotations

from ..evaluation.paper import TABLE_2
from ..primitives.primitive import MovementPrimitive
from .text import percent, table

_ENOUGH = 0.99


def variance_report(primitive: MovementPrimitive) -> list[str]:
    """Shares of the variance, of the shapes and of the joint angles beside [P] Table 2."""
    shares = primitive.explained_variance_ratio
    lines = ["Variance of the shapes (motions less their boundary parts) [%]"]
    most = max((len(values) for values in shares.values()), default=0)
    rows = [
        [name, *(percent(v) for v in values), *[""] * (most - len(values)), percent(sum(values))]
        for name, values in shares.items()
    ]
    header = ["", *(f"PC{k + 1}" for k in range(most)), "sum"]
    lines += table(rows, header=header).splitlines()
    for name, values in shares.items():
        if values and sum(values) < _ENOUGH:
            lines.append(
                f"'{name}': {len(values)} components explain {percent(sum(values))} %, "
                f"{percent(_ENOUGH - sum(values))} less than 99 %"
            )
    lines += ["", "Variance of the joint angles themselves, as in Table 2 of the paper [%]"]
    angles: dict[str, list[float]] = primitive.metadata["angle_variance_ratio"]
    beside = bool(set(TABLE_2) & set(angles))
    rows = []
    for name, values in angles.items():
        ours = [percent(values[k]) if k < len(values) else "" for k in range(4)]
        paper = [percent(value) for value in TABLE_2.get(name, ())[:2]] or ["", ""]
        rows.append([name, *ours, percent(sum(values)), *(paper if beside else [])])
    header = ["", "PC1", "PC2", "PC3", "PC4", "sum", *(["paper PC1", "PC2"] if beside else [])]
    lines += table(rows, header=header).splitlines()
    if not beside:
        firsts = [percent(sum(values[:2])) for values in TABLE_2.values()]
        lines.append(f"PC1 + PC2 of the paper's arm, joint by joint: {', '.join(firsts)}")
    return lines
