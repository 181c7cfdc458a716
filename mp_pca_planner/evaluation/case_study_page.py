# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page of the case study: its tables and numbers, figures, and an animation."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray, text_table
from ..plotting.arm import angle_components_figure, arm_figure
from ..plotting.report import comparison_figure
from ..plotting.style import image_address, picture, render
from ..plotting.text import TABLE_2, Table, percent, percents, variance_table
from ..primitives.differences import MEASURES
from ..robot.model import Robot
from .case_study import (
    FREE_BSPLINES,
    FREE_ENDS,
    MAX_ROUNDS,
    N_COMPONENTS,
    OURS,
    PAPER,
    REST_BSPLINES,
    SAME_ENDS,
    TABLE_3_METHODS,
    CaseStudy,
    n_agreeing,
    variance_shares,
)
from .naturalness import (
    BSPLINES,
    DEFAULT_RHO,
    EXPECTED,
    QUANTITIES,
    Comparison,
    Prediction,
    planned,
)

TABLE_3 = {"B-spline": (5.19594, 148.975), "PCA": (9.58805, 96.509)}
"""[P] Table 3: objective function value, and optimisation time [s]."""

_EFFORTS = ["method", "ends", "starts", "effort [N²m²s]", "ratio", "time [ms]", "time ratio"]

_TITLES = {
    "table_2": "Table 2: variance of the joint angles [%]",
    "table_2_by_activity": "Table 2 for each activity: shares of the first two components [%]",
    "table_3": "Table 3: the arm-raising motion",
    "table_3_all_motions": "Table 3, all motions, each left out: medians",
    "starts": "Methods with the same number of starts, all motions",
    "naturalness": "Naturalness: RMS errors of motions left out, and 95 % intervals of the "
    "difference from the default's",
    "naturalness_other_activities": "Naturalness with primitives of other activities",
}
_PRINTED = ("table_2", "table_3", "table_3_all_motions", "starts", "naturalness")


def tables(study: CaseStudy) -> dict[str, Table]:
    """All tables, by the names of their files."""
    found = {
        "table_2": table_2(study),
        "table_2_by_activity": table_2_by_activity(study),
        "table_3": table_3(study),
        "table_3_all_motions": table_3_all_motions(study),
        "starts": starts_table(study),
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
    return ["joint", *columns, *(f"paper {name}" for name in columns)], rows


def table_2_by_activity(study: CaseStudy) -> Table:
    """Shares of the first two components, for all motions of each activity [%]."""
    rows = [
        [activity, *(f"{percent(x)} + {percent(y)}" for x, y in shares[:, :2])]
        for activity, shares in study.shares_by_activity.items()
    ]
    return ["activity", *study.motions[0].joint_names], rows


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
    found = study.raised
    paper = {f"paper: {name}": Prediction(np.zeros(0), *TABLE_3[name]) for name in TABLE_3}
    rows = [_effort_row(name, found[name], found[BSPLINES]) for name in TABLE_3_METHODS]
    for name in paper:
        rows.append(_effort_row(name, paper[name], paper["paper: B-spline"]))
        rows[-1][1:3] = ["not stated", "not stated"]
    return _EFFORTS, rows


def _effort_row(name: str, found: Prediction, base: Prediction) -> list[str]:
    """Effort and time of a method, and their ratios to those of B-splines."""
    effort = found.effort
    return [
        name,
        _ends(name),
        f"{_n_starts(found)}",
        f"{effort:.3f}" if effort else "none",
        f"{effort / base.effort:.2f}" if effort and base.effort else "",
        f"{1e3 * found.solve_time:.2f}",
        f"{found.solve_time / base.solve_time:.3f}",
    ]


def _n_starts(found: Prediction) -> int:
    """Number of starts of the optimisation."""
    return 1 if found.starts is None else len(found.starts)


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
                f"{np.median([_n_starts(found[name]) for found in held_out.predictions]):.0f}",
                f"{np.median(held_out.column(name, 'effort')):.3f}",
                f"{held_out.effort_ratio(name):.2f}",
                f"{1e3 * np.median(held_out.column(name, 'solve_time')):.2f}",
                f"{study.time_ratio(name):.3f}",
                f"{np.rad2deg(held_out.rms(name, 'time')):.2f}",
                f"{1e3 * held_out.rms(name, 'tip'):.0f}",
            ]
        )
    return [*_EFFORTS, "angle error [deg]", "tip path error [mm]"], rows


def starts_table(study: CaseStudy) -> Table:
    """Efforts and total times of methods, by the number of starts.

    Efforts are medians; times are those of all motions together.
    """
    rows = []
    searches = {name: study.searches(name) for name in SAME_ENDS}
    one_start = study.effort_and_time(REST_BSPLINES, 1)[1]
    for n in (1, 5, None):
        for name, same in SAME_ENDS.items():
            effort, seconds = study.effort_and_time(name, n)
            base, base_seconds = study.effort_and_time(same, n)
            agreeing = [n_agreeing(x, n) for x in searches[name]]
            rows.append(
                [
                    name,
                    _ends(name),
                    str(n or f"{np.median([len(x) for x in searches[name]]):.0f}"),
                    f"{effort:.3f}",
                    f"{effort / base:.3g}",
                    f"{seconds / base_seconds:.3g}",
                    f"{seconds / one_start:.3g}",
                    f"{100.0 * np.mean(np.array(agreeing) > 0):.0f}",
                    f"{100.0 * np.mean(np.array(agreeing) > 1):.0f}",
                ]
            )
    columns = ["effort [N²m²s]", "effort / same ends", "time / same ends", "time / one start"]
    columns += ["least effort found [%]", "by two starts [%]"]
    return ["method", "ends", "starts", *columns], rows


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
    return ["method", *columns, "tip [mm]", "peak", "deviation", "effort ratio"], rows


def summary(study: CaseStudy) -> str:
    """The text output of the command."""
    found, below = tables(study), notes(study)
    texts = []
    for name in _PRINTED:
        header, rows = found[name]
        texts.append(f"{_TITLES[name]}\n{text_table(rows, header=header)}")
        texts[-1] += "".join(f"\n{line}" for line in below.get(name, ()))
    return "\n\n".join(["\n".join(verdict(study)), *texts])


def verdict(study: CaseStudy) -> list[str]:
    """Comparison with B-splines and with the paper, in sentences; the fairest comes first."""
    held_out, least = study.held_out, planned(0.0)
    spline, components = (values[0] for values in TABLE_3.values())
    _, one_start = study.effort_and_time(REST_BSPLINES, 1)
    one, five = (study.effort_and_time(PAPER, n)[1] / one_start for n in (1, 5))
    efforts = [study.effort_and_time(name, None)[0] for name in (PAPER, FREE_BSPLINES)]
    angle, tip = (study.closer_than_bsplines(quantity) for quantity in ("time", "tip"))
    return [
        "Like for like, from one start and at rest at both ends: components of least effort "
        f"(ρ = 0) take {study.time_ratio(least):.3f} of the time of B-splines and "
        f"{held_out.effort_ratio(least):.2f} times their effort (paper: {_paper_ratio():.3f} and "
        f"{components / spline:.2f}).",
        f"The paper's method takes {one:.2f} of the time of B-splines at rest from one start, and "
        f"{five:.1f} times that time for the best of five starts. With equally free ends, its "
        f"effort is {efforts[0] / efforts[1]:.0f} times that of B-splines.",
        f"By default (ρ = 1), planning takes {study.time_ratio(OURS):.3f} of the time of B-splines "
        f"and {held_out.effort_ratio(OURS):.2f} times their effort. More effort is expected: these "
        "motions stay close to the demonstrated ones, which are not those of least effort.",
        f"The motion (ρ = 1) is nearer to the demonstrated one than that of B-splines for "
        f"{angle:.0%} of the motions in joint angle, and for {tip:.0%} in the path of the tip.",
    ]


def notes(study: CaseStudy) -> dict[str, list[str]]:
    """What columns and rows of a table mean, in sentences, by the name of the table."""
    numbers = sorted({len(starts) for name in SAME_ENDS for starts in study.searches(name)})
    used = f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    starts = (
        f"'{REST_BSPLINES}', '{FREE_BSPLINES}' and '{PAPER}' use {used} starts for each motion: "
        f"further rounds follow, {MAX_ROUNDS} at most, until two starts agree on the least effort."
    )
    same = "'ratio' and 'time ratio' are relative to 'least-effort B-splines'."
    return {
        "table_3": [f"{same} Compare rows with the same 'ends' and 'starts'.", starts],
        "table_3_all_motions": [
            f"{same} 'ratio' is the median of the ratios of the motions, which is not the ratio of "
            "the medians. 'time ratio' is that of the times of all motions together. 'starts' is "
            "the median."
        ],
        "starts": [
            "'same ends': relative to B-splines with the same ends and starts. 'one start': "
            "relative to B-splines at rest from one start. Times are totals. The last columns: "
            "shares of the motions for which these starts lead to the least effort of all starts, "
            "at least once and at least twice."
        ],
        "naturalness": [
            "'deviation' is that of the weights, in standard deviations. 'effort ratio' is the "
            "median of the ratios to the effort of B-splines."
        ],
    }


def facts(study: CaseStudy, source: str) -> dict[str, Any]:
    """All results as numbers, of JSON types."""
    names = study.motions[0].joint_names
    other = study.other_activities
    return {
        "source": source,
        "tables": {
            _TITLES[name]: {"header": header, "rows": rows}
            for name, (header, rows) in tables(study).items()
        },
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
            "recording": study.raising.recording,
            "start_time_s": study.raising.start_time,
            "ours": {name: _cost(p.effort, p.solve_time) for name, p in study.raised.items()},
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
            [found.truncated(N_COMPONENTS).components for found in study.components],
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
            title="Effort against distance to the demonstrated motions",
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
        raising=study.raising,
        verdict=verdict(study),
        notes=notes(study),
        tables={"naturalness_other_activities": None, **tables(study)},
        below_paper=less_than_paper(study),
        images={name: image_address(content) for name, content in pictures.items()},
        animation=_animation(study, robot, frames),
    )


def _chains(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of the frames, shape (n_frames, n_points, 3), by the label of the motion."""
    n_frames = 61
    chosen = np.linspace(0, 1000, n_frames).round().astype(int)
    positions = {name: study.raised[name].positions[chosen] for name in (BSPLINES, PAPER, OURS)}
    positions["demonstrated"] = study.raising.time_normalised(n_frames)
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
        "duration": study.raising.duration,
        "chains": [[name, np.round(chain, 4).tolist()] for name, chain in chains.items()],
    }
