# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of recordings: positions and speed over time, with rests, motions and cuts."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import PlannerError
from ..recordings.recording_set import RecordingReport
from .style import BLACK, COLOURS, GREY, LINES, Line, add_header, palette_line
from .units import unit_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def recording_figure(
    figure: Figure, report: RecordingReport, prismatic: Collection[str] = ()
) -> None:
    """Plot the content of a recording.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    report : RecordingReport
        The report on the recording, with an overview.
    prismatic : collection of str
        Joints that are measured in metres.

    Raises
    ------
    PlannerError
        If the report has no overview.
    """
    overview = report.overview
    if overview is None:
        raise PlannerError(f"recording '{report.name}' can't be drawn: its report has no overview")
    joints = [palette_line(name, i, 1.4) for i, name in enumerate(report.joint_names)]
    unit = unit_of(report.joint_names, prismatic)
    figure.set_size_inches(12.0, 3.6)
    add_header(figure, "", [*joints, LINES["motion"], LINES["rest"]])
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    for values, style in zip(overview.positions.T, joints, strict=True):
        above.plot(overview.times, unit.factor * values, **style)
    below.plot(overview.times, unit.factor * overview.speed, color=BLACK, linewidth=1.4)
    for threshold in (report.thresholds.rest, report.thresholds.moving):
        below.axhline(unit.factor * threshold, color=GREY, linestyle="--", linewidth=1.0)
    at_rest = overview.speed <= report.thresholds.rest
    for axes in (above, below):
        whole: Line = {"transform": axes.get_xaxis_transform(), "linewidth": 0}
        axes.fill_between(
            overview.times, 0.0, 1.0, where=at_rest, color=LINES["rest"]["color"], **whole
        )
        for motion in report.motions:
            span = motion.start, motion.end
            axes.axvspan(*span, color=LINES["motion"]["color"], alpha=0.6, linewidth=0)
            for cut in span:
                axes.axvline(cut, color=COLOURS[0], linewidth=1.0)
    above.set(ylabel=f"position [{unit.name}]")
    above.set_xlim(np.nanmin(overview.times), np.nanmax(overview.times))
    below.set(xlabel="time [s]", ylabel=f"speed [{unit.speed}]")
    below.set_ylim(bottom=0.0)
