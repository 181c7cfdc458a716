# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The report of `build_primitives`: one HTML page that needs nothing else, pictures inside."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Sequence
from html import escape

import numpy as np

from ..arrays import FloatArray
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
from .drawing import draw_primitive, draw_recording
from .page import html_image, html_page, html_table
from .text import percent
from .units import Unit, prismatic_joints, unit_of

# What would make the page too heavy or too slow to make is left out beyond these numbers, and
# the page says so.
MOST_PICTURES = 100
MOST_DRAWN = 200
MOST_LEFT_OUT = 60
# Building primitives of many others takes its time: fewer are left out where there are many.
_MOST_BUILT_FROM = 6000
_LEAST_LEFT_OUT = 5
MOST_ROWS = 500
REPORT_SAMPLES = 301
"""Samples of a motion that are enough for its curves and for leaving it out."""
_OPEN_AT_FIRST = 3
_PHASES = np.linspace(0.0, 1.0, 101)


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
        If matplotlib is not installed.
    """
    title = f"Movement primitive '{primitive.name}'"
    sections = [
        f"<h1>{escape(title)}</h1>",
        _summary(recordings, primitive),
        "<h2>The primitive</h2>",
        _shapes(recordings.demonstrations, primitive),
        _variance(primitive),
        _demonstrations(recordings.demonstrations, primitive, options),
        "<h2>The recordings</h2>",
        _refused(recordings),
        _repairs(recordings.reports),
        _recordings(recordings.reports, prismatic_joints(primitive)),
    ]
    return html_page(title, "\n".join(section for section in sections if section))


def _summary(recordings: RecordingSet, primitive: MovementPrimitive) -> str:
    durations = primitive.durations
    of_all = "whole arm" if primitive.coupling == "arm" else "of all joints"
    residual = float(np.sqrt(np.mean(primitive.fit_residual**2)))
    unit = _unit(primitive)
    facts = {
        "recordings used": str(len(recordings.reports)),
        "refused": str(len(recordings.refused)),
        "motions": str(len(durations)),
        "joints": str(primitive.n_joints),
        "components": f"{primitive.n_components}, {of_all}",
        "reproduced to": f"{unit.number(residual)} {unit.name} RMS",
        "durations": f"{durations.min():.2f} – {durations.max():.2f} s",
    }
    cells = "".join(f"<div><dt>{name}</dt><dd>{text}</dd></div>" for name, text in facts.items())
    joints = ", ".join(map(escape, primitive.joint_names))
    law = escape(control_statement(primitive))
    return f'<dl>{cells}</dl>\n<p class="soft">Joints: {joints}<br>Control law: {law}</p>'


def _shapes(motions: Sequence[Demonstration], primitive: MovementPrimitive) -> str:
    chosen = _evenly(len(motions), MOST_DRAWN)
    basis = primitive.basis
    functions = np.moveaxis(basis.functions(_PHASES) * basis.scales, 2, 0)
    shares = primitive.explained_variance_ratio
    if primitive.coupling == "arm":
        components, ratios = functions, np.array(shares["arm"])
    else:
        components, ratios = _side_by_side(functions, primitive)
    picture = io.BytesIO()
    draw_primitive(
        picture,
        joint_names=primitive.joint_names,
        phases=_PHASES,
        demonstrations=[aligned_positions(motions[i], primitive.warps[i], _PHASES) for i in chosen],
        mean=basis.shape(np.zeros(basis.n_weights), _PHASES),
        components=components,
        explained_variance_ratio=ratios,
        prismatic=prismatic_joints(primitive),
        title="",
    )
    return (
        "<h3>Demonstrations, mean and components</h3>\n"
        "<p>Joint by joint over the phase. Above: the demonstrations and their mean. Below: the "
        "mean shape, which is what motions have beyond the minimum-jerk motion between their end "
        "points, and what one standard deviation along the first components adds to it.</p>\n"
        + _left_out("demonstrations", "drawn", len(chosen), len(motions))
        + html_image(
            picture, "Demonstrations, mean shape and components of each joint", "primitive"
        )
    )


def _side_by_side(
    functions: FloatArray, primitive: MovementPrimitive
) -> tuple[FloatArray, FloatArray]:
    """The k-th components of all joints as one, for primitives with components per joint.

    Returns
    -------
    components : array, shape (most, n_phases, n_joints)
        Zero where a joint has fewer.
    ratios : array, shape (n_joints, most)
        Their shares of the variance.
    """
    shares = primitive.explained_variance_ratio
    most = max(map(len, shares.values()))
    components = np.zeros((most, *functions.shape[1:]))
    ratios = np.zeros((primitive.n_joints, most))
    seen = Counter[int]()
    for function, joint in zip(functions, primitive.joint_of_component, strict=True):
        components[seen[joint], :, joint] = function[:, joint]
        ratios[joint, seen[joint]] = shares[primitive.joint_names[joint]][seen[joint]]
        seen[joint] += 1
    return components, ratios


def _variance(primitive: MovementPrimitive) -> str:
    shares = primitive.explained_variance_ratio
    most = max(map(len, shares.values()), default=0)
    of_shapes = html_table(
        ["", *(f"PC{k + 1}" for k in range(most)), "sum"],
        ([name, *_percents(values, most), percent(sum(values))] for name, values in shares.items()),
        "Variance of the shapes that each component explains [%]",
    )
    angles: dict[str, list[float]] = primitive.metadata["angle_variance_ratio"]
    header = ["", "PC1", "PC2", "PC3", "PC4", "sum"]
    of_angles = html_table(
        header,
        ([name, *_percents(values, 4), percent(sum(values))] for name, values in angles.items()),
        "The joint angles of these motions [%]",
    )
    of_paper = html_table(
        header,
        ([name, *_percents(values, 4), percent(sum(values))] for name, values in TABLE_2.items()),
        "The arm of the paper, Table 2 [%]",
    )
    return (
        f"<h3>Variance</h3>\n{of_shapes}\n"
        "<p>The paper takes the components of the joint angles themselves, joint by joint:</p>\n"
        f"{of_angles}\n{of_paper}"
    )


def _percents(values: Sequence[float], n: int) -> list[str]:
    return [percent(values[k]) if k < len(values) else "" for k in range(n)]


def _demonstrations(
    motions: Sequence[Demonstration], primitive: MovementPrimitive, options: PrimitiveOptions
) -> str:
    residuals = np.sqrt(np.mean(primitive.fit_residual**2, axis=1))
    unit = _unit(primitive)
    worst = primitive.fit_residual.argmax(axis=1)
    affordable = max(_LEAST_LEFT_OUT, _MOST_BUILT_FROM // len(motions))
    chosen = _evenly(len(motions), min(MOST_LEFT_OUT, affordable))
    held_out, why_not = _held_out(motions, options, chosen)
    predicted = {i: k for k, i in enumerate(chosen)}
    rows = []
    for i in range(min(len(motions), MOST_ROWS)):
        motion = motions[i]
        row = [
            f"{motion.recording} {motion.label}".strip(),
            f"{motion.start_time:.2f}",
            f"{motion.duration:.2f}",
            unit.number(residuals[i]),
            primitive.joint_names[worst[i]],
        ]
        if held_out is not None:
            k = predicted.get(i)
            row += (
                ["", ""]
                if k is None
                else [
                    unit.number(held_out.minimum_jerk[k, 0]),
                    unit.number(held_out.expected[k, 0]),
                ]
            )
        rows.append(row)
    header = [
        "recording",
        "start [s]",
        "duration [s]",
        f"reproduced to [{unit.name} RMS]",
        "worst joint",
    ]
    if held_out is not None:
        header += [f"minimum-jerk, in time [{unit.name}]", f"expected [{unit.name}]"]
    table = html_table(header, rows, "")
    return (
        "<h3>How well motions are predicted</h3>\n"
        + (why_not if held_out is None else _held_out_text(held_out, len(motions), unit))
        + "\n<h3>Each demonstration</h3>\n"
        "<p>How well the components reproduce it"
        + (
            ""
            if held_out is None
            else ", and how far the predictions were off when it was left out"
        )
        + f".</p>\n{_left_out('demonstrations', 'listed', len(rows), len(motions))}"
        + f"<details><summary>{_counted(len(rows), 'demonstration')}</summary>\n{table}</details>"
    )


def _held_out(
    motions: Sequence[Demonstration], options: PrimitiveOptions, chosen: Sequence[int]
) -> tuple[HeldOutErrors | None, str]:
    """The errors of motions left out, or a sentence that says why there are none."""
    if len(motions) < 3:
        return None, "<p>There are too few motions to leave one out: at least 3 are needed.</p>"
    try:
        return leave_one_out(motions, options, chosen), ""
    except PrimitiveError as error:
        return None, f"<p>Motions can't be left out: {escape(str(error))}.</p>"


def _held_out_text(errors: HeldOutErrors, n_motions: int, unit: Unit) -> str:
    rms = errors.rms()
    minimum_jerk, _, expected = rms[:, MEASURES.index("path")]
    change = 1.0 - expected / minimum_jerk if minimum_jerk > 0.0 else 0.0
    verdict = (
        f"The paths of motions are expected {change:.0%} better than by minimum-jerk."
        if change >= 0.005
        else f"The paths of motions are expected {-change:.0%} worse than by minimum-jerk: "
        "their end points and durations tell little of them."
        if change <= -0.005
        else "The paths of motions are expected as well as by minimum-jerk."
    )
    table = html_table(
        ["prediction", "in time", "after time alignment", "in path"],
        [
            [name, *(unit.number(error) for error in row)]
            for name, row in zip(("minimum-jerk", "mean shape", "expected"), rms, strict=True)
        ],
        f"Errors [{unit.name} RMS]",
    )
    return (
        "<p>Each motion is left out in turn and predicted from its end points and duration by a "
        f"primitive of the others. {verdict}</p>\n"
        + _left_out("motions", "left out, evenly spread", len(errors.expected), n_motions)
        + table
    )


def _refused(recordings: RecordingSet) -> str:
    if not recordings.refused:
        return "<p>No recording was refused.</p>"
    rows = [[refusal.recording, refusal.reason] for refusal in recordings.refused]
    table = html_table(["recording", "why it is not used"], rows[:MOST_ROWS], "", text=True)
    return (
        f"<h3>Refused: {len(rows)}</h3>\n"
        + _left_out("refused recordings", "listed", len(rows[:MOST_ROWS]), len(rows))
        + table
    )


def _repairs(reports: Sequence[RecordingReport]) -> str:
    totals = Counter[str]()
    concerned = Counter[str]()
    for report in reports:
        totals.update(report.repairs)
        concerned.update(kind for kind, count in report.repairs.items() if count)
    rows = [
        [kind, str(totals[kind]), str(concerned[kind]), REPAIRS.get(kind, "")]
        for kind in [*REPAIRS, *sorted(totals.keys() - REPAIRS.keys())]
        if totals[kind]
    ]
    if not rows:
        return "<p>Nothing had to be repaired in those used.</p>"
    header = ["repair", "times", "recordings", "meaning"]
    return f"<h3>Repaired</h3>\n{html_table(header, rows, '', text=True)}"


def _recordings(reports: Sequence[RecordingReport], prismatic: Sequence[str]) -> str:
    is_few = len(reports) <= _OPEN_AT_FIRST
    details = [
        _recording(report, prismatic, is_open=is_few, is_drawn=i < MOST_PICTURES)
        for i, report in enumerate(reports)
    ]
    return (
        "<h3>Used</h3>\n"
        "<p>Blue: motions, with a line at each cut. Grey: rest, where the speed (its norm over the "
        "joints) is below the lower dashed line; a motion has a peak over the upper one.</p>\n"
        + _left_out(
            "recordings", "drawn, the first ones", min(len(reports), MOST_PICTURES), len(reports)
        )
        + "\n".join(details)
    )


def _recording(
    report: RecordingReport, prismatic: Sequence[str], *, is_open: bool, is_drawn: bool
) -> str:
    found = [
        f"{kind}: {count} ({REPAIRS.get(kind, 'repaired')})"
        for kind, count in report.repairs.items()
        if count
    ]
    unit = unit_of(report.joint_names, prismatic)
    rest, moving = (unit.number(x) for x in (report.thresholds.rest, report.thresholds.moving))
    facts = [
        f"{report.n_messages} messages on {report.topic}, {report.rate:.1f} Hz, {report.format}",
        f"rest below {rest} {unit.speed}, motion with a peak over {moving} {unit.speed}",
        *found,
        *report.notes,
    ]
    items = "".join(f"<li>{escape(fact)}</li>" for fact in facts)
    n_repairs = sum(report.repairs.values())
    summary = ", ".join(
        [
            _counted(len(report.motions), "motion"),
            f"{report.duration:.1f} s",
            _counted(n_repairs, "repair") if n_repairs else "nothing repaired",
        ]
    )
    image = ""
    if is_drawn and report.overview is not None:
        picture = io.BytesIO()
        draw_recording(picture, report, prismatic)
        image = html_image(picture, f"Positions and speed of {report.name} over time", "recording")
    return (
        f"<details{' open' if is_open else ''}><summary><strong>{escape(report.name)}</strong> "
        f'<span class="soft">{summary}</span></summary>\n<ul>{items}</ul>\n{image}</details>'
    )


def _unit(primitive: MovementPrimitive) -> Unit:
    return unit_of(primitive.joint_names, prismatic_joints(primitive))


def _evenly(n: int, most: int) -> list[int]:
    """At most so many of n indices, evenly spread."""
    return [int(i) for i in np.unique(np.linspace(0, n - 1, min(n, most)).round())]


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _left_out(what: str, done: str, n: int, total: int) -> str:
    """Say that not all are on the page, if so."""
    if n == total:
        return ""
    return f'<p class="soft">{n} of the {total} {what} are {done}.</p>\n'
