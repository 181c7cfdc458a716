# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The report of `build_primitives`, an HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..control.law import control_statement
from ..evaluation.paper import TABLE_2
from ..exceptions import PrimitiveError
from ..primitives.alignment import aligned_positions
from ..primitives.cross_validation import HeldOutErrors, leave_one_out
from ..primitives.options import PrimitiveOptions
from ..primitives.prediction import nearest_demonstrations
from ..primitives.primitive import MovementPrimitive
from ..recordings.demonstration import Demonstration
from ..recordings.load import RecordingReport, RecordingSet
from ..recordings.repair import REPAIRS
from ..robot.model import Robot
from .arm import goals_figure
from .page import figure_address, render
from .primitive import PHASES, primitive_figure
from .recording import recording_figure
from .units import primitive_unit, prismatic_joints
from .variance import is_arm_of_paper, variance_table
from .verdict import PrimitiveVerdict, goals_in_span, verdict_on

REPORT_SAMPLES = 301
"""Number of samples of a motion for curves and leave-one-out predictions."""


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
        Total number of demonstrations in all primitives for these predictions. With many
        demonstrations, fewer are left out, but at least five.
    max_rows : int
        Rows of a table.
    """

    max_recordings_drawn: int = 100
    max_demonstrations_drawn: int = 200
    max_left_out: int = 60
    max_built_from: int = 6000
    max_rows: int = 500


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
    limits = ReportOptions()
    motions = recordings.demonstrations
    drawn = _evenly(len(motions), limits.max_demonstrations_drawn)
    prismatic = prismatic_joints(primitive)
    affordable = max(5, limits.max_built_from // len(motions))
    left_out = _evenly(len(motions), min(limits.max_left_out, affordable))
    angles = primitive.metadata["angle_variance_ratio"]
    errors, why_no_errors = _held_out(motions, options, left_out)
    verdict = verdict_on(primitive, errors, left_out, robot)
    return render(
        "report.html",
        title=f"Movement primitive '{primitive.name}'",
        limits=limits,
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
        repairs=_repairs(recordings.reports),
        meanings=REPAIRS,
        reports=recordings.reports,
        images=[
            figure_address(partial(recording_figure, report=report, prismatic=prismatic))
            for report in recordings.reports[: limits.max_recordings_drawn]
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
    tip = robot.frame_names[-1]
    ends = primitive.boundary_states[:, [0, 3]]
    typical, *_ = nearest_demonstrations(primitive, ends.mean(axis=0))
    times = np.linspace(0.0, primitive.durations[typical], PHASES.size)
    chain = robot.chain_positions(primitive.reproduction(int(typical), times), tip)
    shown = {
        "goals in span": goals_in_span(primitive),
        "goals, predicted well": ends[~verdict.is_weak, 1],
        "goals, predicted badly": ends[verdict.is_weak, 1],
    }
    places = {name: robot.frame_positions(q, [tip])[:, 0] for name, q in shown.items()}
    return figure_address(partial(goals_figure, chain=chain, goals=places, tip=tip))


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
