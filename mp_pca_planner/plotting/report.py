# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The report of `build_primitives`, an HTML page."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..control.statement import control_statement
from ..evaluation.paper import TABLE_2
from ..exceptions import PrimitiveError
from ..primitives.alignment import aligned_positions
from ..primitives.cross_validation import HeldOutErrors, leave_one_out
from ..primitives.differences import MEASURES
from ..primitives.options import PrimitiveOptions
from ..primitives.primitive import MovementPrimitive
from ..recordings.demonstration import Demonstration
from ..recordings.load import RecordingReport, RecordingSet
from ..recordings.repair import REPAIRS
from .drawing import picture
from .page import Table, image_address, render
from .primitive import PHASES, primitive_figure
from .recording import recording_figure
from .units import Unit, primitive_unit, prismatic_joints
from .variance import variance_table

REPORT_SAMPLES = 301
"""Samples of a motion that are enough for its curves and for leaving it out."""


@dataclass(frozen=True)
class ReportOptions:
    """Limits of the page's size and of the time to make it.

    Attributes
    ----------
    max_recordings_drawn : int
        Recordings with a figure.
    max_demonstrations_drawn : int
        Demonstrations in the figure of the primitive.
    max_left_out : int
        Demonstrations that are left out and predicted.
    max_built_from : int
        Demonstrations that all primitives for these predictions are built from, in total: fewer
        are left out where there are many, but at least five.
    max_rows : int
        Rows of a table.
    """

    max_recordings_drawn: int = 100
    max_demonstrations_drawn: int = 200
    max_left_out: int = 60
    max_built_from: int = 6000
    max_rows: int = 500


def report_page(
    recordings: RecordingSet, primitive: MovementPrimitive, options: PrimitiveOptions
) -> str:
    """Make the page.

    Parameters
    ----------
    recordings :
        What was loaded, with overviews.
    primitive :
        The primitive of all its demonstrations, in this order.
    options :
        How it was built.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    limits = ReportOptions()
    motions = recordings.demonstrations
    unit = primitive_unit(primitive)
    drawn = _evenly(len(motions), limits.max_demonstrations_drawn)
    affordable = max(5, limits.max_built_from // len(motions))
    left_out = _evenly(len(motions), min(limits.max_left_out, affordable))
    errors, why_no_errors = _held_out(motions, options, left_out)
    return render(
        "report.html",
        title=f"Movement primitive '{primitive.name}'",
        limits=limits,
        primitive=primitive,
        motions=motions,
        unit=unit,
        residual=float(np.sqrt(np.mean(primitive.fit_residual**2))),
        law=control_statement(primitive),
        n_drawn=len(drawn),
        shapes=_shapes(motions, primitive, drawn),
        shape_variance=variance_table(primitive.explained_variance_ratio),
        angle_variance=variance_table(primitive.metadata["angle_variance_ratio"], 4),
        paper_variance=variance_table(TABLE_2),
        errors=errors,
        why_no_errors=why_no_errors,
        **({} if errors is None else _predictions(errors, unit)),
        demonstrations=_demonstrations(motions[: limits.max_rows], primitive, errors, left_out),
        refused=[(refusal.recording, refusal.reason) for refusal in recordings.refused],
        repairs=_repairs(recordings.reports),
        meanings=REPAIRS,
        reports=recordings.reports,
        images=[
            _image(report, prismatic_joints(primitive))
            for report in recordings.reports[: limits.max_recordings_drawn]
        ],
    )


def _shapes(
    motions: Sequence[Demonstration], primitive: MovementPrimitive, drawn: Sequence[int]
) -> str:
    shown = [aligned_positions(motions[i], primitive.warps[i], PHASES) for i in drawn]
    content = io.BytesIO()
    with picture(content) as figure:
        primitive_figure(figure, primitive, np.array(shown))
    return image_address(content)


def _held_out(
    motions: Sequence[Demonstration], options: PrimitiveOptions, chosen: Sequence[int]
) -> tuple[HeldOutErrors | None, str]:
    """The errors of motions left out, or a sentence that says why there are none."""
    if len(motions) < 3:
        return None, "At least 3 motions are needed to leave one out"
    try:
        return leave_one_out(motions, options, chosen), ""
    except PrimitiveError as error:
        return None, f"Motions can't be left out: {error}"


def _predictions(errors: HeldOutErrors, unit: Unit) -> dict[str, Any]:
    """Errors by method and measure, and by which share predictions beat minimum-jerk."""
    rms = errors.rms()
    minimum_jerk, _, expected = rms[:, MEASURES.index("path")]
    rows = [
        [name, *map(unit.number, row)]
        for name, row in zip(("minimum-jerk", "mean shape", "expected"), rms, strict=True)
    ]
    return {
        "gain": 1.0 - expected / minimum_jerk if minimum_jerk > 0.0 else 0.0,
        "prediction_errors": Table(
            ["prediction", "in time", "after time alignment", "in path"], rows
        ),
    }


def _demonstrations(
    motions: Sequence[Demonstration],
    primitive: MovementPrimitive,
    errors: HeldOutErrors | None,
    left_out: Sequence[int],
) -> Table:
    """A row per demonstration; errors of predictions for those that were left out."""
    unit = primitive_unit(primitive)
    residuals = np.sqrt(np.mean(primitive.fit_residual**2, axis=1))
    rows = [
        [
            f"{motion.recording} {motion.label}".strip(),
            f"{motion.start_time:.2f}",
            f"{motion.duration:.2f}",
            unit.number(residuals[i]),
            primitive.joint_names[primitive.fit_residual[i].argmax()],
        ]
        for i, motion in enumerate(motions)
    ]
    reproduced = f"reproduced to [{unit.name} RMS]"
    header = ["recording", "start [s]", "duration [s]", reproduced, "worst joint"]
    if errors is not None:
        header += [f"minimum-jerk, in time [{unit.name}]", f"expected [{unit.name}]"]
        of_motion = dict(
            zip(left_out, zip(errors.minimum_jerk, errors.expected, strict=True), strict=True)
        )
        for i, row in enumerate(rows):
            found = of_motion.get(i)
            row += ["", ""] if found is None else [unit.number(in_time) for in_time, *_ in found]
    return Table(header, rows)


def _repairs(reports: Sequence[RecordingReport]) -> Table:
    """Kinds of repairs that were made, and in how many recordings."""
    totals, concerned = Counter[str](), Counter[str]()
    for report in reports:
        totals.update(report.repairs)
        concerned.update(kind for kind, count in report.repairs.items() if count)
    kinds = [*REPAIRS, *sorted(totals.keys() - REPAIRS.keys())]
    return Table(
        ["repair", "times", "recordings", "meaning"],
        [
            [kind, str(totals[kind]), str(concerned[kind]), REPAIRS.get(kind, "")]
            for kind in kinds
            if totals[kind]
        ],
    )


def _image(report: RecordingReport, prismatic: Sequence[str]) -> str:
    content = io.BytesIO()
    with picture(content) as figure:
        recording_figure(figure, report, prismatic)
    return image_address(content)


def _evenly(n: int, most: int) -> list[int]:
    """At most so many of n indices, evenly spread."""
    return [int(i) for i in np.unique(np.linspace(0, n - 1, min(n, most)).round())]
