# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page of the case study: its tables and numbers, figures, and an animation."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..plotting.arm import arm_figure
from ..plotting.comparison import comparison_figure
from ..plotting.page import image_address, picture, render
from ..plotting.primitive import angle_components_figure
from ..plotting.text import TABLE_2, Table, percent, percents, table, variance_table
from ..primitives.differences import MEASURES
from ..robot.model import Robot
from .case_study import (
    FREE_ENDS,
    OURS,
    PAPER,
    PAPER_OPTIONS,
    TABLE_3_METHODS,
    CaseStudy,
    variance_shares,
)
from .naturalness import BSPLINES, DEFAULT_RHO, EXPECTED, QUANTITIES, Comparison, planned

TABLE_3 = {"B-spline": (5.19594, 148.975), "PCA": (9.58805, 96.509)}
"""[P] Table 3: objective function value, and optimisation time [s]."""

_EFFORTS = ["method", "ends", "effort [N²m²s]", "ratio", "time [ms]", "time ratio"]

_TITLES = {
    "table_2": "Table 2: variance of the joint angles [%]",
    "table_2_by_activity": "Table 2 for each activity: shares of the first two components [%]",
    "table_3": "Table 3: the arm-raising motion",
    "table_3_all_motions": "Table 3, all motions, each left out: medians",
    "naturalness": "Naturalness: RMS errors of motions left out, and 95 % intervals of the "
    "difference from the default's",
    "naturalness_other_activities": "Naturalness with primitives of other activities",
}
_PRINTED = ("table_2", "table_3", "table_3_all_motions", "naturalness")


def tables(study: CaseStudy) -> dict[str, Table]:
    """All tables, by the names of their files."""
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
    (_, *columns), rows = variance_table(_shares(study), 4)
    for row in rows:
        paper = TABLE_2.get(row[0], ())
        row += [*percents(paper, 4), percent(sum(paper)) if paper else ""]
    return Table(["joint", *columns, *(f"paper {name}" for name in columns)], rows)


def table_2_by_activity(study: CaseStudy) -> Table:
    """Shares of the first two components, for all motions of each activity [%]."""
    rows = [
        [activity, *(f"{percent(x)} + {percent(y)}" for x, y in shares[:, :2])]
        for activity, shares in study.shares_by_activity.items()
    ]
    return Table(["activity", *study.motions[0].joint_names], rows)


def less_than_paper(study: CaseStudy) -> list[str]:
    """Joints of which two components explain less than 90 %; those of the paper explain more."""
    names = study.motions[0].joint_names
    return [
        f"{name} of {activity} ({percent(row[:2].sum())} %, with the third component "
        f"{percent(row[:3].sum())} %)"
        for activity, shares in study.shares_by_activity.items()
        for name, row in zip(names, shares, strict=True)
        if row[:2].sum() < 0.9
    ]


def table_3(study: CaseStudy) -> Table:
    """The arm-raising motion, beside the paper's."""
    found = study.raising.predictions
    rows = [
        _effort_row(name, found[name].effort, found[name].solve_time, found[BSPLINES][1:])
        for name in TABLE_3_METHODS
    ]
    rows += [_effort_row(f"paper: {name}", *TABLE_3[name], TABLE_3["B-spline"]) for name in TABLE_3]
    for row in rows[-len(TABLE_3) :]:
        row[1] = "not stated"
    return Table(_EFFORTS, rows)


def _effort_row(
    name: str, effort: float | None, seconds: float, base: tuple[float | None, float]
) -> list[str]:
    """Effort and time of a method, and their ratios to those of B-splines."""
    return [
        name,
        _ends(name),
        f"{effort:.3f}" if effort else "none",
        f"{effort / base[0]:.2f}" if effort and base[0] else "",
        f"{1e3 * seconds:.2f}",
        f"{seconds / base[1]:.3f}",
    ]


def _ends(method: str) -> str:
    """How motions of a method begin and end."""
    return "moving" if method in FREE_ENDS else "at rest"


def table_3_all_motions(study: CaseStudy) -> Table:
    """Median efforts and times for all motions, and their distances from the demonstrations."""
    held_out = study.held_out
    rows = []
    for name in TABLE_3_METHODS:
        rows.append(
            [
                name,
                _ends(name),
                f"{np.median(held_out.column(name, 'effort')):.3f}",
                f"{held_out.effort_ratio(name):.2f}",
                f"{1e3 * np.median(held_out.column(name, 'solve_time')):.2f}",
                f"{study.time_ratio(name):.3f}",
                f"{np.rad2deg(held_out.rms(name, 'time')):.2f}",
                f"{1e3 * held_out.rms(name, 'tip'):.0f}",
            ]
        )
    return Table([*_EFFORTS, "angle error [deg]", "tip path error [mm]"], rows)


def naturalness(comparison: Comparison) -> Table:
    """Errors by method, with the interval of their difference from those of the default."""
    rows = []
    for name in comparison.results:
        row = [name]
        for measure in MEASURES:
            low, high = np.rad2deg(comparison.interval(name, measure))
            difference = "–" if name == comparison.reference else f"{low:+.2f} … {high:+.2f}"
            row += [f"{np.rad2deg(comparison.rms(name, measure)):.2f}", difference]
        row += [
            f"{1e3 * comparison.rms(name, 'tip'):.0f}",
            f"{np.mean(comparison.column(name, 'peak')):.3f}",
            f"{np.median(comparison.column(name, 'deviation')):.2f}",
            f"{comparison.effort_ratio(name):.2f}",
        ]
        rows.append(row)
    errors = ["in time [deg]", "aligned [deg]", "in path [deg]"]
    columns = [name for error in errors for name in (error, "interval")]
    return Table(["method", *columns, "tip [mm]", "peak", "deviation", "effort ratio"], rows)


def summary(study: CaseStudy) -> str:
    """The text output of the command."""
    found = tables(study)
    texts = [f"{_TITLES[n]}\n{table(found[n].rows, header=found[n].header)}" for n in _PRINTED]
    return "\n\n".join([*texts, verdict(study)])


def verdict(study: CaseStudy) -> str:
    """Comparison with B-splines and with the paper, in two sentences."""
    angle, tip = (study.closer_than_bsplines(quantity) for quantity in ("time", "tip"))
    return (
        f"By default, planning takes {study.time_ratio(OURS):.3f} of the time of B-splines (paper: "
        f"{_paper_ratio():.3f}). The motion is nearer to the person's than that of B-splines "
        f"for {angle:.0%} of the motions in joint angle, and for {tip:.0%} in the path of the tip."
    )


def facts(study: CaseStudy, source: str) -> dict[str, Any]:
    """All results as numbers, of JSON types."""
    names = study.motions[0].joint_names
    raising = study.raising
    other = study.other_activities
    return {
        "source": source,
        "tables": {_TITLES[name]: found._asdict() for name, found in tables(study).items()},
        "n_motions": len(study.motions),
        "motions": [
            {"recording": m.recording, "start_time_s": m.start_time, "label": m.label}
            for m in study.motions
        ],
        "table_2": {
            name: {"ours": shares, "paper": TABLE_2.get(name)}
            for name, shares in _shares(study).items()
        },
        "table_2_by_activity": {
            activity: dict(zip(names, shares, strict=True))
            for activity, shares in study.shares_by_activity.items()
        },
        "table_3": {
            "recording": raising.motion.recording,
            "start_time_s": raising.motion.start_time,
            "ours": {
                name: _cost(p.effort, p.solve_time) for name, p in raising.predictions.items()
            },
            "paper": {name: _cost(*values) for name, values in TABLE_3.items()},
        },
        "time_ratio_pca_over_bspline": {
            **{name: study.time_ratio(name) for name in TABLE_3_METHODS},
            "paper": _paper_ratio(),
        },
        "free_ends": FREE_ENDS,
        "closer_than_bspline": {
            quantity: study.closer_than_bsplines(quantity) for quantity in (*MEASURES, "tip")
        },
        "naturalness": _by_method(study.held_out),
        "naturalness_other_activities": None if other is None else _by_method(other),
    }


def _shares(study: CaseStudy) -> dict[str, Any]:
    """Shares of the variance, shape (4,), by joint."""
    names = study.motions[0].joint_names
    return dict(zip(names, variance_shares(study.components), strict=True))


def _cost(effort: float | None, seconds: float) -> dict[str, float | None]:
    return {"effort_cost": effort, "solve_time_s": seconds}


def _paper_ratio() -> float:
    return TABLE_3["PCA"][1] / TABLE_3["B-spline"][1]


def _by_method(comparison: Comparison) -> dict[str, Any]:
    return {
        name: {quantity: comparison.column(name, quantity) for quantity in QUANTITIES}
        for name in comparison.results
    }


def draw_pictures(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, io.BytesIO]:
    """Draw all figures as PNGs, by the names of their files."""
    pictures = {name: io.BytesIO() for name in ("figure_2", "figures_3_4", "trade_off")}
    with picture(pictures["figure_2"]) as figure:
        angle_components_figure(
            figure,
            study.motions[0].joint_names,
            [found.truncated(PAPER_OPTIONS.n_components).components for found in study.components],
            "Principal components of the joint angles (paper: Fig. 2)",
        )
    with picture(pictures["figures_3_4"]) as figure:
        chains = _chains(study, robot, frames)
        title = "The arm-raising motion (paper: Figs. 3 and 4)"
        arm_figure(figure, chains, title, frames[-1])
    others = {
        name: [_place(study.held_out, name)]
        for name in study.held_out.results
        if not name.startswith("planned") and name != EXPECTED
    }
    with picture(pictures["trade_off"]) as figure:
        comparison_figure(
            figure,
            others,
            x="effort, as a multiple of that of B-splines (median)",
            y="RMS error in path [deg]",
            title="Effort against distance to people's motions",
            curve=_curve(study.held_out),
        )
    return pictures


def case_study_page(
    study: CaseStudy,
    robot: Robot,
    frames: Sequence[str],
    source: str,
    pictures: Mapping[str, io.BytesIO],
) -> str:
    """Make the page.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    return render(
        "case_study.html",
        title="Case study: movement primitives of arm motions",
        study=study,
        source=source,
        raising=study.raising.motion,
        verdict=verdict(study),
        tables={"naturalness_other_activities": None, **tables(study)},
        below_paper=less_than_paper(study),
        images={name: image_address(content) for name, content in pictures.items()},
        animation=_animation(study, robot, frames),
    )


def _chains(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of the frames, shape (n_frames, n_points, 3), by the label of the motion."""
    raising = study.raising
    n_frames = 61
    chosen = np.linspace(0, 1000, n_frames).round().astype(int)
    positions = {
        name: raising.predictions[name].positions[chosen] for name in (BSPLINES, PAPER, OURS)
    }
    positions["the person"] = raising.motion.time_normalised(n_frames)
    return {name: robot.frame_positions(q, frames) for name, q in positions.items()}


def _curve(comparison: Comparison) -> dict[str, tuple[float, float]]:
    """The planner from ρ = 0 to ∞."""
    methods = [name for name in comparison.results if name.startswith("planned")]
    labels = {name: name.removeprefix("planned, ρ = ") for name in methods}
    labels[planned(DEFAULT_RHO)] += " (default)"
    labels[EXPECTED] = "∞"
    return {label: _place(comparison, name) for name, label in labels.items()}


def _place(comparison: Comparison, name: str) -> tuple[float, float]:
    """Effort as a multiple of that of B-splines (median), and error in path [deg]."""
    return comparison.effort_ratio(name), float(np.rad2deg(comparison.rms(name, "path")))


def _animation(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, Any]:
    chains = _chains(study, robot, frames)
    return {
        "duration": study.raising.motion.duration,
        "chains": [[name, np.round(chain, 4).tolist()] for name, chain in chains.items()],
    }
