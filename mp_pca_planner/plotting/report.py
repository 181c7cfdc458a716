# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The reports of `build_primitives` and `build_library`, HTML pages, and figures of recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..control.law import control_statement
from ..exceptions import PlannerError, PrimitiveError
from ..primitives.alignment import aligned_positions
from ..primitives.cross_validation import HeldOutErrors, leave_one_out
from ..primitives.differences import PHASES
from ..primitives.foreign import foreign_recordings
from ..primitives.kinds.find import OUTLIER
from ..primitives.library.build import LibraryContent
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.options import PrimitiveOptions
from ..primitives.primitive import MovementPrimitive
from ..recordings.demonstration import Demonstration
from ..recordings.recording_set import RecordingReport, RecordingSet, Refusal
from ..recordings.repair import REPAIRS
from ..robot.model import Robot
from .arm import arm_figure
from .page import figure_address, render
from .primitive import plot_demonstrations, primitive_figure, reproductions
from .style import BLACK, COLOURS, GREY, LINES, Line, add_header, joint_panels, palette_line
from .text import (
    TABLE_2,
    is_arm_of_paper,
    kinds_words,
    primitive_unit,
    prismatic_joints,
    unit_of,
    variance_table,
)
from .verdict import PrimitiveVerdict, goals_in_span, verdict_on

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MARKERS = "osD^v<>P*X"


# Samples of a motion for curves and leave-one-out predictions.
N_SAMPLES = 301
# Recordings with a figure.
_MAX_RECORDINGS_DRAWN = 100
# Demonstrations in the figure of the primitive.
_MAX_DEMONSTRATIONS_DRAWN = 200
# Demonstrations that are left out and predicted.
_MAX_LEFT_OUT = 60
# Total number of demonstrations in all primitives for these predictions. With many
# demonstrations, fewer are left out, but at least five.
_MAX_BUILT_FROM = 6000
# Rows of a table, and motions of a library in a list.
_MAX_ROWS = 500
_MAX_MOTIONS = 200
# Kinds of motions with a figure, and motions and joints in it.
_MAX_KINDS = 40
_MAX_PATHS = 60
_MAX_JOINTS = 8


def report_page(
    recordings: RecordingSet,
    primitive: MovementPrimitive,
    options: PrimitiveOptions,
    robot: Robot | None = None,
) -> str:
    """Make the page.

    Parameters
    ----------
    recordings :
        The loaded recordings, with overviews.
    primitive :
        The primitive of all its demonstrations, in this order.
    options :
        How it was built.
    robot :
        The robot of its joints, for a picture.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    motions = recordings.demonstrations
    drawn = _evenly(len(motions), _MAX_DEMONSTRATIONS_DRAWN)
    prismatic = prismatic_joints(primitive)
    statistics = primitive.statistics or MotionStatistics.of(motions, options)
    affordable = max(5, _MAX_BUILT_FROM // len(motions))
    left_out = _evenly(len(motions), min(_MAX_LEFT_OUT, affordable))
    angles = primitive.metadata["angle_variance_ratio"]
    errors, why_no_errors = _held_out(motions, options, left_out)
    verdict = verdict_on(primitive, errors, left_out, robot)
    return render(
        "report.html",
        title=f"Movement primitive '{primitive.name}'",
        max_rows=_MAX_ROWS,
        primitive=primitive,
        verdict=verdict,
        goals=None if robot is None else _goals_address(primitive, robot, verdict),
        motions=motions,
        unit=primitive_unit(primitive),
        residual=_rms(primitive.fit_residual),
        residuals=_rms(primitive.fit_residual, axis=1),
        law=control_statement(primitive),
        n_drawn=len(drawn),
        shapes=_shapes_address(motions, primitive, drawn),
        shape_variance=variance_table(primitive.explained_variance_ratio),
        angle_variance=variance_table(angles, 4),
        paper_variance=variance_table(TABLE_2) if is_arm_of_paper(angles) else None,
        errors=errors,
        why_no_errors=why_no_errors,
        left_out_as={motion: row for row, motion in enumerate(left_out)},
        refused=recordings.refused,
        foreign=foreign_recordings(statistics, options.n_phases),
        repairs=_repairs(recordings.reports),
        meanings=REPAIRS,
        reports=recordings.reports,
        images=[
            figure_address(partial(recording_figure, report=report, prismatic=prismatic))
            for report in recordings.reports[:_MAX_RECORDINGS_DRAWN]
        ],
    )


def _shapes_address(
    motions: Sequence[Demonstration], primitive: MovementPrimitive, drawn: Sequence[int]
) -> str:
    """The figure of some demonstrations and of the components."""
    shown = [aligned_positions(motions[i], primitive.warps[i], PHASES) for i in drawn]
    return figure_address(
        partial(primitive_figure, primitive=primitive, demonstrations=np.array(shown))
    )


def _goals_address(primitive: MovementPrimitive, robot: Robot, verdict: PrimitiveVerdict) -> str:
    """The figure of the robot among the goals of its demonstrations."""
    tip = robot.end_effector
    ends = primitive.boundary_states[:, [0, 3]]
    typical, *_ = primitive.nearest_demonstrations(ends.mean(axis=0))
    times = np.linspace(0.0, primitive.durations[typical], PHASES.size)
    chain = robot.chain_positions(primitive.reproduction(int(typical), times), tip)
    shown = {
        "goals in span": goals_in_span(primitive),
        "goals, predicted well": ends[~verdict.is_weak, 1],
        "goals, predicted badly": ends[verdict.is_weak, 1],
    }
    places = {name: robot.frame_positions(q, [tip])[:, 0] for name, q in shown.items()}
    motions = {"a demonstration": chain}
    return figure_address(partial(arm_figure, motions=motions, title="", tip=tip, goals=places))


def _rms(values: FloatArray, axis: int | None = None) -> Any:
    return np.sqrt(np.mean(values**2, axis=axis))


def _held_out(
    motions: Sequence[Demonstration], options: PrimitiveOptions, chosen: Sequence[int]
) -> tuple[HeldOutErrors | None, str]:
    """The errors of left-out motions, or a sentence on the reason why there are none."""
    if len(motions) < 3:
        return None, "At least 3 motions are needed to leave one out"
    try:
        return leave_one_out(motions, options, chosen), ""
    except PrimitiveError as error:
        return None, f"Motions can't be left out: {error}"


def _repairs(reports: Sequence[RecordingReport]) -> list[tuple[str, int, int]]:
    """Kinds of repairs that were made, how often, and in how many recordings."""
    totals, concerned = Counter[str](), Counter[str]()
    for report in reports:
        totals.update(report.repairs)
        concerned.update(kind for kind, count in report.repairs.items() if count)
    kinds = [*REPAIRS, *sorted(totals.keys() - REPAIRS.keys())]
    return [(kind, totals[kind], concerned[kind]) for kind in kinds if totals[kind]]


def _evenly(n: int, most: int) -> list[int]:
    """At most the given number of n indices, evenly spread."""
    return [int(i) for i in np.unique(np.linspace(0, n - 1, min(n, most)).round())]


def library_page(places: Mapping[Path, LibraryContent], refused: Sequence[Refusal]) -> str:
    """Make the page.

    Parameters
    ----------
    places : mapping
        The libraries by their folders.
    refused : sequence of Refusal
        Recordings that were not used.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    return render(
        "library.html",
        title="Kinds of motions",
        libraries=[_library(folder, content) for folder, content in places.items()],
        refused=refused,
        max_rows=_MAX_MOTIONS,
    )


def _library(folder: Path, content: LibraryContent) -> dict[str, Any]:
    motions, unit = content.statistics.motions, primitive_unit(content.primitives[0])
    kinds = zip(content.primitives, content.errors_alone, content.errors_pooled, strict=True)
    return {
        "folder": str(folder),
        "content": content,
        "unit": unit,
        "map": figure_address(partial(kinds_map, content=content)),
        "agreement": content.label_agreement(),
        "judgement": content.left_out and kinds_words(content.left_out, unit),
        "kinds": [
            {
                "primitive": primitive,
                "labels": _labels(primitive),
                "alone": unit.number(alone),
                "together": unit.number(together),
                "figure": figure_address(partial(paths_figure, primitive=primitive))
                if i < _MAX_KINDS
                else None,
            }
            for i, (primitive, alone, together) in enumerate(kinds)
        ],
        "outliers": [motions[i] for i in content.kinds.members(OUTLIER)],
        "ambiguous": [(motions[i], ", ".join(names)) for i, names in content.ambiguous],
    }


def _labels(primitive: MovementPrimitive) -> str:
    counts = Counter(d["label"] for d in primitive.metadata["demonstrations"] if d["label"])
    return ", ".join(f"{label} {n}" for label, n in counts.most_common())


def kinds_map(figure: Figure, content: LibraryContent) -> None:
    """Draw every motion as a point, by kind."""
    kinds, styles = content.kinds, [_points(GREY, "x", "none of them")]
    for k, primitive in enumerate(content.primitives):
        colour = palette_line("", k)["color"]
        styles.append(_points(colour, _MARKERS[k % len(_MARKERS)], primitive.name))
    figure.set_size_inches(10.0, 6.0)
    add_header(figure, "Motions by kind", styles[1:] + styles[:1])
    axes = figure.subplots()
    for k, style in enumerate(styles, start=OUTLIER):
        axes.plot(*kinds.positions[kinds.members(k)].T, **style)
    axes.set(xlabel="first component of the features", ylabel="second component")


def _points(colour: str, marker: str, label: str) -> Line:
    shape = {"marker": marker, "markersize": 6.0, "alpha": 0.8}
    return {"color": colour, "linestyle": "none", "label": label, **shape}


def paths_figure(figure: Figure, primitive: MovementPrimitive) -> None:
    """Draw the motions of a kind over the aligned phase, in the joints that move most."""
    paths = reproductions(primitive, _evenly(len(primitive.durations), _MAX_PATHS))
    moved = np.argsort(-np.ptp(paths, axis=1).mean(axis=0), kind="stable")
    joints = np.sort(moved[:_MAX_JOINTS])
    names = [primitive.joint_names[j] for j in joints]
    panels = joint_panels(figure, names, 1)
    add_header(figure, primitive.name, [LINES["demonstration"], LINES["mean"]])
    for joint, (axes,) in zip(joints, panels, strict=True):
        plot_demonstrations(axes, primitive, int(joint), paths)


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
