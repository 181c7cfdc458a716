# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The tables and figures of the case study, as text."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..evaluation.case_study import OURS, TABLE_3_METHODS, CaseStudy, variance_shares
from ..evaluation.naturalness import BSPLINES, QUANTITIES, Comparison
from ..evaluation.paper import TABLE_2, TABLE_3
from ..primitives.differences import MEASURES
from .text import percent, table

Table = tuple[list[str], list[list[str]]]
"""A header and rows."""

_PAPER_SAYS = 0.9
_COMPONENTS = [f"PC{k + 1}" for k in range(4)]


def tables(study: CaseStudy) -> dict[str, Table]:
    """All tables, by the name of their files."""
    found = {
        "table_2": table_2(study),
        "table_2_by_activity": table_2_by_activity(study),
        "table_3": table_3(study),
        "table_3_all_motions": table_3_all_motions(study),
        "naturalness": naturalness(study.held_out),
    }
    if study.other_activities is not None:
        found["naturalness_other_activities"] = naturalness(study.other_activities)
    return found


def table_2(study: CaseStudy) -> Table:
    """Shares of the variance of the joint angles, beside the paper's [%]."""
    rows = []
    names = study.motions[0].joint_names
    for name, shares in zip(names, variance_shares(study.components), strict=True):
        paper = TABLE_2.get(name, ())
        rows.append(
            [
                name,
                *(percent(x) for x in shares),
                percent(shares.sum()),
                *([percent(x) for x in paper] or [""] * 4),
                percent(sum(paper)) if paper else "",
            ]
        )
    paper_header = [f"paper {name}" for name in (*_COMPONENTS, "sum")]
    return ["joint", *_COMPONENTS, "sum", *paper_header], rows


def table_2_by_activity(study: CaseStudy) -> Table:
    """Shares of the first two components, for all motions of each activity [%]."""
    names = study.motions[0].joint_names
    rows = [
        [activity, *(f"{percent(x)} + {percent(y)}" for x, y in shares[:, :2])]
        for activity, shares in study.shares_by_activity.items()
    ]
    return ["activity", *names], rows


def less_than_paper(study: CaseStudy) -> list[str]:
    """Joints of which two components explain less than 90 %, which the paper's exceed."""
    names = study.motions[0].joint_names
    return [
        f"{name} of {activity} ({percent(row[:2].sum())} %, with the third component "
        f"{percent(row[:3].sum())} %)"
        for activity, shares in study.shares_by_activity.items()
        for name, row in zip(names, shares, strict=True)
        if row[:2].sum() < _PAPER_SAYS
    ]


def table_3(study: CaseStudy) -> Table:
    """The arm-raising motion, beside the paper's."""
    found = study.raising.predictions
    least = found[BSPLINES]
    rows = []
    for name in TABLE_3_METHODS:
        effort, seconds = found[name].effort, found[name].solve_time
        ratios = [f"{effort / least.effort:.2f}" if effort and least.effort else "", "", ""]
        ratios[1:] = [f"{1e3 * seconds:.2f}", f"{seconds / least.solve_time:.3f}"]
        rows.append([name, f"{effort:.3f}" if effort else "none", *ratios])
    (spline_effort, spline_time), (pca_effort, pca_time) = TABLE_3["B-spline"], TABLE_3["PCA"]
    rows += [
        ["paper: B-spline", f"{spline_effort:.3f}", "1.00", f"{1e3 * spline_time:.0f}", "1.000"],
        [
            "paper: PCA",
            f"{pca_effort:.3f}",
            f"{pca_effort / spline_effort:.2f}",
            f"{1e3 * pca_time:.0f}",
            f"{pca_time / spline_time:.3f}",
        ],
    ]
    return ["method", "effort [N²m²s]", "ratio", "time [ms]", "time ratio"], rows


def table_3_all_motions(study: CaseStudy) -> Table:
    """The same for all motions, medians, and how near they come."""
    held_out = study.held_out
    least = held_out.column(BSPLINES, "effort")
    rows = []
    for name in TABLE_3_METHODS:
        effort = held_out.column(name, "effort")
        rows.append(
            [
                name,
                f"{np.median(effort):.3f}",
                f"{np.median(effort / least):.2f}",
                f"{1e3 * np.median(held_out.column(name, 'solve_time')):.2f}",
                f"{study.time_ratio(name):.3f}",
                f"{np.rad2deg(held_out.rms(name, 'time')):.2f}",
                f"{1e3 * held_out.rms(name, 'tip'):.0f}",
            ]
        )
    header = ["method", "effort [N²m²s]", "ratio", "time [ms]", "time ratio"]
    return [*header, "angle error [deg]", "tip path error [mm]"], rows


def naturalness(comparison: Comparison) -> Table:
    """Errors by method, with the interval of their difference from those of the default."""
    rows = []
    for name in comparison.results:
        row = [name]
        for measure in MEASURES:
            low, high = np.rad2deg(comparison.interval(name, measure))
            error = np.rad2deg(comparison.rms(name, measure))
            difference = "–" if name == comparison.reference else f"{low:+.2f} … {high:+.2f}"
            row += [f"{error:.2f}", difference]
        row.append(f"{1e3 * comparison.rms(name, 'tip'):.0f}")
        row.append(f"{np.mean(comparison.column(name, 'peak')):.3f}")
        row.append(f"{np.median(comparison.column(name, 'deviation')):.2f}")
        ratio = comparison.column(name, "effort") / comparison.column(BSPLINES, "effort")
        rows.append([*row, f"{np.median(ratio):.2f}"])
    errors = ["in time [deg]", "aligned [deg]", "in path [deg]"]
    columns = [name for error in errors for name in (error, "interval")]
    return ["method", *columns, "tip [mm]", "peak", "deviation", "effort ratio"], rows


def summary(study: CaseStudy) -> str:
    """What the command prints."""
    labels = {
        "table_2": "Table 2: variance of the joint angles [%]",
        "table_3": "Table 3: the arm-raising motion",
        "table_3_all_motions": f"Table 3, all {len(study.motions)} motions, each left out: medians",
        "naturalness": "Naturalness: RMS errors of motions left out, and 95 % intervals of the "
        "difference from the default's",
    }
    found = tables(study)
    texts = [f"{label}\n{table(found[n][1], header=found[n][0])}" for n, label in labels.items()]
    return "\n\n".join([*texts, verdict(study)])


def verdict(study: CaseStudy) -> str:
    """Whether it is as the paper says, in two sentences."""
    angle, tip = (study.closer_than_bsplines(quantity) for quantity in ("time", "tip"))
    pca, spline = (TABLE_3[name][1] for name in ("PCA", "B-spline"))
    return (
        f"By default planning takes {study.time_ratio(OURS):.3f} of the time of B-splines (the "
        f"paper: {pca / spline:.3f}). The motion is nearer to the person's than that of B-splines "
        f"for {angle:.0%} of the motions in joint angle, and for {tip:.0%} in the path of the tip."
    )


def facts(study: CaseStudy, source: str) -> dict[str, Any]:
    """Everything as numbers."""
    names = study.motions[0].joint_names
    return {
        "source": source,
        "n_motions": len(study.motions),
        "motions": [
            {"recording": m.recording, "start_time_s": m.start_time, "label": m.label}
            for m in study.motions
        ],
        "table_2": {
            name: {"ours": shares, "paper": TABLE_2.get(name)}
            for name, shares in zip(names, variance_shares(study.components), strict=True)
        },
        "table_2_by_activity": {
            activity: dict(zip(names, shares, strict=True))
            for activity, shares in study.shares_by_activity.items()
        },
        "table_3": {
            "recording": study.raising.motion.recording,
            "start_time_s": study.raising.motion.start_time,
            "ours": {
                name: {"effort_cost": p.effort, "solve_time_s": p.solve_time}
                for name, p in study.raising.predictions.items()
            },
            "paper": {
                name: {"effort_cost": effort, "solve_time_s": seconds}
                for name, (effort, seconds) in TABLE_3.items()
            },
        },
        "time_ratio_pca_over_bspline": {
            **{name: study.time_ratio(name) for name in TABLE_3_METHODS},
            "paper": TABLE_3["PCA"][1] / TABLE_3["B-spline"][1],
        },
        "closer_than_bspline": {
            quantity: study.closer_than_bsplines(quantity) for quantity in (*MEASURES, "tip")
        },
        "naturalness": _by_method(study.held_out),
        "naturalness_other_activities": None
        if study.other_activities is None
        else _by_method(study.other_activities),
    }


def _by_method(comparison: Comparison) -> dict[str, Any]:
    return {
        name: {quantity: comparison.column(name, quantity) for quantity in QUANTITIES}
        for name in comparison.results
    }
