# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The reports of `build_primitives` and `build_library`, with the verdict on a primitive.

And a figure that compares methods.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..control.law import control_statement
from ..exceptions import PlannerError, PrimitiveError
from ..primitives.build import PrimitiveOptions
from ..primitives.build_library import LibraryContent
from ..primitives.differences import MEASURES, PHASES, HeldOutErrors, leave_one_out
from ..primitives.foreign import foreign_recordings
from ..primitives.in_span import in_span_score
from ..primitives.kinds import OUTLIER
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.primitive import MovementPrimitive
from ..primitives.timing import aligned_positions
from ..recordings.demonstration import Demonstration
from ..recordings.recording_set import RecordingReport, RecordingSet, Refusal
from ..recordings.repair import REPAIRS
from ..robot.model import Robot
from .arm import arm_figure, plot_demonstrations, primitive_figure, reproductions
from .style import (
    BLACK,
    COLOURS,
    GREY,
    LINES,
    Line,
    add_header,
    figure_address,
    joint_panels,
    line,
    palette_line,
    render,
)
from .text import (
    METRES,
    TABLE_2,
    Unit,
    is_arm_of_paper,
    kinds_words,
    primitive_unit,
    prismatic_joints,
    unit_of,
    variance_table,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
    good, weak, is_weak = verdict_on(primitive, errors, left_out, robot)
    return render(
        "report.html",
        title=f"Movement primitive '{primitive.name}'",
        max_rows=_MAX_ROWS,
        primitive=primitive,
        good=good,
        weak=weak,
        goals=None if robot is None else _goals_address(primitive, robot, is_weak),
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


def _goals_address(primitive: MovementPrimitive, robot: Robot, is_weak: NDArray[np.bool_]) -> str:
    """The figure of the robot among the goals of its demonstrations."""
    tip = robot.end_effector
    ends = primitive.boundary_states[:, [0, 3]]
    typical, *_ = primitive.nearest_demonstrations(ends.mean(axis=0))
    times = np.linspace(0.0, primitive.durations[typical], PHASES.size)
    chain = robot.chain_positions(primitive.reproduction(int(typical), times), tip)
    shown = {
        "goals in span": goals_in_span(primitive),
        "goals, predicted well": ends[~is_weak, 1],
        "goals, predicted badly": ends[is_weak, 1],
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
    if report.overview is None:
        raise PlannerError(f"recording '{report.name}' can't be drawn: its report has no overview")
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
            span = motion.start, motion.end
            axes.axvspan(*span, color=LINES["motion"]["color"], alpha=0.6, linewidth=0)
            for cut in span:
                axes.axvline(cut, color=COLOURS[0], linewidth=1.0)
    above.set(ylabel=f"position [{unit.name}]")
    above.set_xlim(np.nanmin(times), np.nanmax(times))
    below.set(xlabel="time [s]", ylabel=f"speed [{unit.speed}]")
    below.set_ylim(bottom=0.0)


_PATH = MEASURES.index("path")
Feature = tuple[FloatArray, Unit]
"""Values of a quantity at the goals of motions [rad or m], and its unit."""


# Error above which a left-out motion counts as weak, in medians of the errors.
_WEAK_ERROR = 2.0
# Share of the weak motions in a region, less that of the others, above which the region is named.
_SEPARATION = 0.5
# Number of demonstrations below which more are recommended.
_FEW = 10
# Number of goals sampled for the region in span, and how far beyond a demonstrated goal, as a
# share of its distance from another one.
_N_SAMPLED = 3000
_REACH = 0.5


def verdict_on(
    primitive: MovementPrimitive,
    errors: HeldOutErrors | None,
    left_out: Sequence[int],
    robot: Robot | None = None,
) -> tuple[list[str], list[str], NDArray[np.bool_]]:
    """Judge a primitive by its errors on left-out demonstrations and by the ranges of its goals.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    errors : HeldOutErrors or None
        Errors of the motions that were left out, if any were.
    left_out : sequence of int
        Indices of these motions.
    robot : Robot, optional
        The robot of its joints, which gives goals a place in space.

    Returns
    -------
    good, weak : list of str
        Sentences on what it is good for, and on its weaknesses.
    is_weak : array of bool, shape (n_demonstrations,)
        Whether a motion was left out and predicted badly.
    """
    is_weak = np.zeros(len(primitive.durations), dtype=bool)
    good, weak = [], []
    features = _features(primitive, robot)
    if errors is not None:
        path, unit = errors.expected[:, _PATH], primitive_unit(primitive)
        limit = _WEAK_ERROR * float(np.median(path))
        is_weak[list(left_out)] = path > limit
        straight, _, expected = errors.rms()[:, _PATH]
        text = (
            f"left-out motions are predicted to {unit.number(expected)} {unit.name} RMS in path "
            "(timing left aside)"
        )
        if expected < straight:
            good.append(f"{text}, {1.0 - expected / straight:.0%} nearer than by minimum-jerk")
        else:
            weak.append(
                f"{text}, no nearer than by minimum-jerk: their end points say little about them"
            )
        if is_weak.any():
            tested = {name: (values[left_out], of) for name, (values, of) in features.items()}
            shown = f"{unit.number(limit)} {unit.name}"
            weak.append(_weak_goals(tested, is_weak[left_out], shown))
    ranges = [
        f"{name} {unit.text(values[~is_weak].min())} to {unit.text(values[~is_weak].max())}"
        f" {unit.name}"
        for name, (values, unit) in features.items()
    ]
    good.append("goals in the demonstrated ranges: " + ", ".join(ranges))
    weak.append("goals outside: the in-span score of a plan says how far (above 3: unlike)")
    if is_weak.size < _FEW:
        weak.append(f"there are only {is_weak.size} demonstrations: record ten to thirty")
    return good, weak, is_weak


def goals_in_span(primitive: MovementPrimitive) -> FloatArray:
    """Goals as like the demonstrations as the demonstrations are, shape (n_goals, n_joints).

    They are drawn along lines through two demonstrated goals. Each, with the start of the nearer
    one, has an in-span score of at most the largest of the demonstrations.
    """
    rng = np.random.default_rng(0)
    model, ends = primitive.model, primitive.boundary_states[:, [0, 3]]
    own = ends.reshape(len(ends), -1)
    i, j = rng.integers(len(ends), size=(2, _N_SAMPLED))
    reach = rng.uniform(-_REACH, 0.5, size=(_N_SAMPLED, 1))
    goals = ends[i, 1] + reach * (ends[j, 1] - ends[i, 1])

    def score(request: FloatArray) -> float:
        return in_span_score(request, model.mean, model.request_precision)

    largest = max(map(score, own))
    requests = np.concatenate([ends[i, 0], goals], axis=1)
    return np.array([goals[k] for k, request in enumerate(requests) if score(request) <= largest])


def _features(primitive: MovementPrimitive, robot: Robot | None) -> dict[str, Feature]:
    """The joints at the goals of the demonstrations, and the place of the robot's end effector."""
    goals, prismatic = primitive.boundary_states[:, 3], prismatic_joints(primitive)
    features = {
        name: (values, unit_of([name], prismatic))
        for name, values in zip(primitive.joint_names, goals.T, strict=True)
    }
    if robot is not None:
        tip = robot.end_effector
        place = robot.frame_positions(goals, [tip])[:, 0]
        features |= {f"{tip} {axis}": (x, METRES) for axis, x in zip("xyz", place.T, strict=True)}
    return features


def _weak_goals(features: Mapping[str, Feature], is_weak: NDArray[np.bool_], limit: str) -> str:
    """Where the goals of weak motions are: on one side of a value of one feature, or anywhere."""
    n_weak, n = int(is_weak.sum()), is_weak.size
    best, found = _SEPARATION, ""
    for name, (values, unit) in features.items():
        known = np.unique(values)
        for cut in 0.5 * (known[1:] + known[:-1]):
            for word, inside in (("above", values > cut), ("below", values < cut)):
                n_inside, n_there = int(inside.sum()), int((inside & is_weak).sum())
                share = n_there / n_weak - (n_inside - n_there) / max(n - n_weak, 1)
                if share > best:
                    best = share
                    found = (
                        f"goals with {name} {word} {unit.text(cut)} {unit.name}: {n_there} of "
                        f"{n_inside} motions there are off by over {limit} (twice the median), "
                        f"{n_weak - n_there} of {n - n_inside} elsewhere"
                    )
    nowhere = f"{n_weak} of {n} motions, in no region of their own, are off by over {limit}"
    return found or f"{nowhere} (twice the median)"


Points = Sequence[tuple[float, float]]


def comparison_figure(
    figure: Figure,
    clouds: Mapping[str, Points],
    x: str,
    y: str,
    title: str,
    curve: Mapping[str, tuple[float, float]] | None = None,
) -> None:
    """Plot clouds of positive points, each with its median, and the planner from ρ = 0 to ∞.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    clouds : mapping of str to sequence of (float, float)
        By label, the points; at least one in each.
    x, y : str
        Labels of the axes.
    title : str
        Title of the figure.
    curve : mapping of str to (float, float), optional
        By value of ρ, the points of the planner.
    """
    n = len(COLOURS)
    style: Line = {"markersize": 11, "markeredgecolor": BLACK}
    medians = [
        line(label, COLOURS[i % n], "", marker=_MARKERS[i % len(_MARKERS)], **style)
        for i, label in enumerate(clouds)
    ]
    planner = line("planner, from ρ = 0 to ∞", BLACK, width=2.2, marker="o")
    figure.set_size_inches(11.0, 7.0)
    add_header(figure, title, medians if curve is None else [*medians, planner])
    axes = figure.subplots()
    for median, points in zip(medians, clouds.values(), strict=True):
        values = np.array(points, dtype=np.float64)
        small = {"markersize": 4, "markeredgewidth": 0, "alpha": 0.3}
        axes.plot(*values.T, **median | small)
        axes.plot(*np.median(values, axis=0), **median)
    if curve is not None:
        axes.plot(*np.array(list(curve.values())).T, **planner)
        _label(axes, curve)
        axes.margins(0.15, 0.2)
    axes.set(xlabel=x, ylabel=y)
    _logarithmic(axes)


def _label(axes: Axes, curve: Mapping[str, tuple[float, float]], apart: float = 0.1) -> None:
    """Label points of a curve below on the left, where nothing is; one label for near ones."""
    groups: list[tuple[tuple[float, float], list[str]]] = []
    for name, place in curve.items():
        if groups and np.abs(np.log(np.divide(place, groups[-1][0]))).max() < apart:
            groups[-1][1].append(name)
        else:
            groups.append((place, [name]))
    for place, names in groups:
        text = f"ρ = {', '.join(names)}"
        axes.annotate(
            text, place, (-6, -6), textcoords="offset points", ha="right", va="top", size="small"
        )


def _logarithmic(axes: Axes) -> None:
    """Scale both axes logarithmically, with plain numbers at the ticks."""
    from matplotlib.ticker import LogLocator

    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
