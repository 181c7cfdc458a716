# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The tables, numbers and figures of the case study."""

from __future__ import annotations

from typing import Any

import numpy as np
from paper_method import (
    FREE_BSPLINES,
    FREE_ENDS,
    MAX_ROUNDS,
    PAPER,
    REST_BSPLINES,
    SAME_ENDS,
    TABLE_3_METHODS,
    CaseStudy,
    n_agreeing,
    variance_shares,
)
from prediction import BSPLINES, PLANNED, Prediction, error_table

from mp_pca_planner.plotting.text import Table, percent, percents, variance_table

TABLE_2 = {
    "shoulder1": (0.9249, 0.0639, 0.0082, 0.0013),
    "shoulder2": (0.8237, 0.1265, 0.0369, 0.0081),
    "shoulder3": (0.8563, 0.1190, 0.0190, 0.0029),
    "elbow": (0.7436, 0.2350, 0.0165, 0.0028),
}
"""[P] Table 2: shares of the first four components, joint by joint of the paper's arm."""

TABLE_3 = {"B-spline": (5.19594, 148.975), "PCA": (9.58805, 96.509)}
"""[P] Table 3: objective function value, and optimisation time [s]."""

_EFFORTS = ["method", "ends", "starts", "effort [N²m²s]", "ratio", "time [ms]", "time ratio"]


def tables(study: CaseStudy) -> dict[str, Table]:
    """All tables by their titles."""
    found = {
        "Table 2: variance of the joint angles [%]": table_2(study),
        "Table 3: the arm-raising motion": table_3(study),
        "Table 3, all motions, each left out: medians": table_3_all_motions(study),
        "Methods with the same number of starts, all motions": starts_table(study),
        "Naturalness: RMS errors of motions left out, and 95 % intervals of the difference from "
        "the default's": error_table(study.held_out),
    }
    if study.other_activities is not None:
        title = "Naturalness with primitives of other activities"
        found[title] = error_table(study.other_activities)
    return found


def table_2(study: CaseStudy) -> Table:
    """Shares of the variance of the joint angles, beside the paper's [%]."""
    (_, *columns), rows = variance_table(_shares(study), 4)
    for row in rows:
        paper = TABLE_2.get(row[0], ())
        row += [*percents(paper, 4), percent(sum(paper)) if paper else ""]
    return ["joint", *columns, *(f"paper {name}" for name in columns)], rows


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


def notes(study: CaseStudy) -> list[str]:
    """What columns and rows of the tables mean, in sentences."""
    nearer = study.closer_than_bsplines
    numbers = sorted({len(starts) for name in SAME_ENDS for starts in study.searches(name)})
    used = f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    starts = (
        f"'{REST_BSPLINES}', '{FREE_BSPLINES}' and '{PAPER}' use {used} starts for each motion: "
        f"further rounds follow, {MAX_ROUNDS} at most, until two starts agree on the least effort."
    )
    return [
        "Table 3: 'ratio' and 'time ratio' are relative to 'least-effort B-splines'. Compare rows "
        f"with the same 'ends' and 'starts'. {starts} All motions: medians of the ratios; 'time "
        "ratio' is that of the times of all motions together.",
        "Starts: 'same ends': relative to B-splines with the same ends and starts. 'one start': "
        "relative to B-splines at rest from one start. The last columns: shares of the motions for "
        "which these starts lead to the least effort of all starts, at least once and twice.",
        "Naturalness: 'deviation' is that of the weights, in standard deviations. 'effort' is the "
        "median of the ratios to the effort of B-splines.",
        f"'{PLANNED}' is nearer to the person's motion than B-splines in {nearer('time'):.0%} of "
        f"the motions in joint angle and in {nearer('tip'):.0%} in the tip's path. The arm-raising "
        f"motion is that at {study.raising.start_time:.2f} s of {study.raising.recording}.",
    ]


def _shares(study: CaseStudy) -> dict[str, Any]:
    """Shares of the variance, shape (4,), by joint."""
    names = study.motions[0].joint_names
    return dict(zip(names, variance_shares(study.components), strict=True))
