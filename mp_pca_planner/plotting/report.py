# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The report of `build_primitives`: the primitive, its demonstrations and the recordings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from ..control.law import control_statement
from ..primitives.differences import PHASES
from ..primitives.primitive import MovementPrimitive, prediction_words
from ..primitives.timing import own_phases
from ..recordings.recording import REPAIRS, Recording
from ..recordings.recording_set import RecordingSet
from .primitive import primitive_figure
from .style import (
    BLACK,
    COLOURS,
    GREY,
    LINES,
    Line,
    add_header,
    figure_address,
    palette_line,
    render,
)
from .text import primitive_unit, prismatic_joints, unit_of, variance_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Recordings with a figure.
_MAX_RECORDINGS_DRAWN = 100
# Demonstrations in the figure of the primitive.
_MAX_DEMONSTRATIONS_DRAWN = 200
# Rows of a table.
_MAX_ROWS = 500


def report_page(
    recordings: RecordingSet,
    primitive: MovementPrimitive,
    foreign: Sequence[tuple[str, str]],
) -> str:
    """Make the page.

    Parameters
    ----------
    recordings :
        The loaded recordings.
    primitive :
        The primitive of all its demonstrations, in this order.
    foreign :
        Recordings unlike the others, and why, see :func:`.foreign_recordings`.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    motions = recordings.demonstrations
    drawn = range(0, len(motions), ceil(len(motions) / _MAX_DEMONSTRATIONS_DRAWN))
    phases = [own_phases(primitive.warps[i], PHASES) for i in drawn]
    shown = [motions[i].at(motions[i].duration * x) for i, x in zip(drawn, phases, strict=True)]
    shapes = partial(primitive_figure, primitive=primitive, demonstrations=np.array(shown))
    prismatic = prismatic_joints(primitive)
    angles = primitive.metadata["angle_variance_ratio"]
    return render(
        "report.html",
        title=f"Movement primitive '{primitive.name}'",
        max_rows=_MAX_ROWS,
        primitive=primitive,
        prediction=prediction_words(primitive),
        motions=motions,
        unit=primitive_unit(primitive),
        residual=np.sqrt(np.mean(primitive.fit_residual**2)),
        residuals=np.sqrt(np.mean(primitive.fit_residual**2, axis=1)),
        law=control_statement(primitive),
        n_drawn=len(drawn),
        shapes=figure_address(shapes),
        shape_variance=variance_table(primitive.explained_variance_ratio),
        angle_variance=variance_table(angles, 4),
        refused=recordings.refused,
        foreign=foreign,
        meanings=REPAIRS,
        reports=recordings.reports,
        images=[
            figure_address(partial(recording_figure, report=report, prismatic=prismatic))
            for report in recordings.reports[:_MAX_RECORDINGS_DRAWN]
        ],
    )


def recording_figure(figure: Figure, report: Recording, prismatic: Collection[str] = ()) -> None:
    """Plot the content of a recording.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    report : Recording
        The recording.
    prismatic : collection of str
        Joints that are measured in metres.
    """
    assert report.overview is not None
    assert report.thresholds is not None
    times, positions, speed = report.overview
    joints = [palette_line(name, i, 1.4) for i, name in enumerate(report.joint_names)]
    unit = unit_of(report.joint_names, prismatic)
    figure.set_size_inches(12.0, 3.6)
    add_header(figure, "", [*joints, LINES["motion"], LINES["rest"]])
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    for values, style in zip(positions.T, joints, strict=True):
        above.plot(times, unit.factor * values, **style)
    below.plot(times, unit.factor * speed, color=BLACK, linewidth=1.4)
    for threshold in (report.thresholds.rest, report.thresholds.moving):
        below.axhline(unit.factor * threshold, color=GREY, linestyle="--", linewidth=1.0)
    at_rest = speed <= report.thresholds.rest
    for axes in (above, below):
        whole: Line = {"transform": axes.get_xaxis_transform(), "linewidth": 0}
        axes.fill_between(times, 0.0, 1.0, where=at_rest, color=LINES["rest"]["color"], **whole)
        for motion in report.motions:
            span = motion.start_time, motion.end_time
            axes.axvspan(*span, color=LINES["motion"]["color"], alpha=0.6, linewidth=0)
            for cut in span:
                axes.axvline(cut, color=COLOURS[0], linewidth=1.0)
    above.set(ylabel=f"position [{unit.name}]")
    above.set_xlim(np.nanmin(times), np.nanmax(times))
    below.set(xlabel="time [s]", ylabel=f"speed [{unit.speed}]")
    below.set_ylim(bottom=0.0)
