# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of recordings, primitives and motions, as PNG files.

The only module that needs matplotlib, which it imports when a picture is drawn. It uses figures
of its own with the Agg canvas: pyplot, its windows and its settings are left alone.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from math import ceil
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import MissingDependencyError, PlannerError, printable, quote_names
from ..files import write_whole
from ..motion.trajectory import Trajectory
from ..recordings.demonstration import Demonstration
from ..recordings.load import RecordingReport
from ..robot.limits import JointLimits
from .units import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, which people with any colour vision can tell apart, without the yellow
# that is too pale for lines. Line styles differ too, for printers without colour.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D")
_STYLES = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 3)))
_BLACK, _GREY = "#000000", "#8C8C8C"

# Sizes that can still be read when the picture is shown at half its size.
_DPI = 120
_TITLE_SIZE, _TEXT_SIZE, _TICK_SIZE = 15, 12, 11
_HEADER_HEIGHT = 0.95  # [inch], for the title and one row of the legend
_LEGEND_ROW_HEIGHT = 0.28
_MOST_COLUMNS = 4
_PANEL = (3.5, 2.3)  # [inch]
_RECORDING = (8.0, 3.6)  # [inch]
_ARM_ROW_HEIGHT = 4.0  # [inch]
_LEAST_VIEW = 0.05  # [m], for arms without extent

_START_MARKER: Mapping[str, Any] = MappingProxyType(
    {"marker": "o", "markersize": 8, "markerfacecolor": "white"}
)
_END_MARKER: Mapping[str, Any] = MappingProxyType({"marker": "s", "markersize": 8})

# More components than this around one mean can't be told apart.
_MOST_COMPONENTS = 3
# A limit farther than this share of the curve's range from the curve is not drawn: it would
# press the curve flat.
_NEAR_LIMIT = 0.25


class _Curve(NamedTuple):
    """How a kind of curve is drawn and called."""

    label: str
    colour: str
    style: Any  # whatever matplotlib takes
    width: float
    marker: Mapping[str, Any] = MappingProxyType({})


class _Row(NamedTuple):
    """A quantity of a motion: where it and its limits are found, and how it is drawn."""

    name: str
    field: str
    limits: tuple[str, ...]
    scale: float
    least_span: float  # so that a joint at rest does not show rounding errors


_DEMONSTRATION = _Curve("demonstrations", _GREY, "-", 0.8)
_MEAN = _Curve("mean", _BLACK, "-", 2.5)
_LIMIT = _Curve("limit (where near)", _BLACK, (0, (2, 2)), 1.5)
_SPEED = _Curve("speed", _BLACK, "-", 1.4)
_MOTION_BAND = _Curve("motion", "#CFE6F5", "-", 8.0)
_REST_BAND = _Curve("rest", "#E6E6E6", "-", 8.0)
# More joints than this are drawn without their names.
_MOST_NAMED = 14
_ROWS = (
    _Row("position [deg]", "positions", ("lower", "upper"), np.rad2deg(1.0), 2.0),
    _Row("velocity [deg/s]", "velocities", ("velocity",), np.rad2deg(1.0), 2.0),
    _Row("effort [N·m]", "efforts", ("effort",), 1.0, 0.2),
)
_PRISMATIC_ROWS = (
    _Row("position [m]", "positions", ("lower", "upper"), 1.0, 0.02),
    _Row("velocity [m/s]", "velocities", ("velocity",), 1.0, 0.02),
    _Row("effort [N]", "efforts", ("effort",), 1.0, 0.2),
)


def require_matplotlib() -> None:
    """Make sure that pictures can be drawn, before work is done for them.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401  # whether it can be imported is the question
    except ImportError:
        raise MissingDependencyError("matplotlib", "plot", "drawing a picture") from None


def draw_primitive(
    path: str | Path | io.BytesIO,
    *,
    joint_names: Sequence[str],
    phases: ArrayLike,
    demonstrations: ArrayLike,
    mean: ArrayLike,
    components: ArrayLike,
    explained_variance_ratio: ArrayLike,
    prismatic: Collection[str] = (),
    title: str,
    force: bool = False,
) -> None:
    """Draw what a primitive is made of, joint by joint ([P] Fig. 2).

    Above: the demonstrations; below: the mean shape, and the mean shape plus and minus one
    standard deviation along the first components.

    Parameters
    ----------
    path : str, Path or BytesIO
        The PNG file to write, or the buffer that takes its content.
    joint_names : sequence of str
        Names of n_joints joints.
    phases : array, shape (n_phases,)
        Phases from 0 to 1.
    demonstrations : array, shape (n_demonstrations, n_phases, n_joints)
        Time-normalised positions [rad or m].
    mean : array, shape (n_phases, n_joints)
        The mean shape [rad or m].
    components : array, shape (n_components, n_phases, n_joints)
        The components, each times the standard deviation of its weight [rad or m]. A component
        that is zero for a joint is not drawn there.
    explained_variance_ratio : array, shape (n_components,) or (n_joints, n_components)
        Shares of the variance, of all joints together or of each joint.
    prismatic : collection of str
        Joints that are measured in metres.
    title : str
        Title of the picture.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If shapes disagree, a number is not finite, there is no demonstration, or the file
        can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    names = unique_names(joint_names, "joints of a primitive", PlannerError)
    n = len(names)
    s = frozen_array(phases, (None,), "phases", PlannerError)
    units = [unit_of([name], prismatic) for name in names]
    factors = np.array([unit.factor for unit in units])
    shown = factors * frozen_array(
        demonstrations, (None, s.size, n), "demonstrations", PlannerError
    )
    centre = factors * frozen_array(mean, (s.size, n), "mean shape", PlannerError)
    deviations = factors * frozen_array(components, (None, s.size, n), "components", PlannerError)
    shares = _variance_shares(explained_variance_ratio, len(deviations), n)
    if not len(shown):
        raise PlannerError("a picture of a primitive needs at least one demonstration, got none")
    per_joint = np.ndim(explained_variance_ratio) == 2
    styles = _component_curves(len(deviations), None if per_joint else shares[0])
    figure, panels = _joint_panels(names, 2, title, [_DEMONSTRATION, _MEAN, *styles])
    for j, (above, below) in enumerate(panels):
        for demonstration in shown[:, :, j]:
            _draw(above, s, demonstration, _DEMONSTRATION)
        _draw(above, s, shown[:, :, j].mean(axis=0), _MEAN)
        for deviation, style in zip(deviations[:, :, j], styles, strict=False):
            if np.any(deviation):
                _draw_around(below, s, centre[:, j], deviation, style)
        _draw(below, s, centre[:, j], _MEAN)
        if per_joint:
            percents = ", ".join(f"{100 * share:.1f}" for share in shares[j, : len(styles)])
            below.set_title(f"variance: {percents} %", fontsize=_TICK_SIZE)
        for axes, quantity in ((above, "position"), (below, "shape")):
            label = f"{quantity} [{units[j].name}]"
            _label(axes, "phase", label, in_all_columns=bool(prismatic))
            axes.set_xlim(s[0], s[-1])
    _save(figure, path, force)


def draw_recording(
    path: str | Path | io.BytesIO,
    report: RecordingReport,
    prismatic: Collection[str] = (),
    *,
    force: bool = False,
) -> None:
    """Draw what a recording holds: positions and speed over time, its rests, motions and cuts.

    Parameters
    ----------
    path : str, Path or BytesIO
        The PNG file to write, or the buffer that takes its content.
    report : RecordingReport
        What was found in it, with an overview.
    prismatic : collection of str
        Joints that are measured in metres.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the report has no overview, or the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    overview = report.overview
    if overview is None:
        raise PlannerError(f"recording '{report.name}' can't be drawn: its report has no overview")
    joints = _joint_curves(report.joint_names)
    entries = (
        [*joints, _MOTION_BAND, _REST_BAND]
        if len(joints) <= _MOST_NAMED
        else [_MOTION_BAND, _REST_BAND]
    )
    unit = unit_of(report.joint_names, prismatic)
    figure = _recording_figure(entries)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    for values, curve in zip(overview.positions.T, joints, strict=True):
        _draw(above, overview.times, unit.factor * values, curve)
    _draw(below, overview.times, unit.factor * overview.speed, _SPEED)
    for threshold in (report.thresholds.rest, report.thresholds.moving):
        below.axhline(unit.factor * threshold, color=_GREY, linestyle="--", linewidth=1.0)
    rests = _runs(overview.speed <= report.thresholds.rest)
    for axes, name in (
        (above, f"position [{unit.name}]"),
        (below, f"speed [{unit.speed}]"),
    ):
        for first, last in rests:
            axes.axvspan(*overview.times[[first, last]], color=_REST_BAND.colour, linewidth=0)
        for motion in report.motions:
            axes.axvspan(
                motion.start, motion.end, color=_MOTION_BAND.colour, alpha=0.6, linewidth=0
            )
            for cut in (motion.start, motion.end):
                axes.axvline(cut, color=_COLOURS[0], linewidth=1.0)
        _label(axes, "time [s]" if axes is below else "", name)
    above.set_xlim(np.nanmin(overview.times), np.nanmax(overview.times))
    below.set_ylim(bottom=0.0)
    _save(figure, path, force)


def draw_motion(
    path: str | Path,
    trajectory: Trajectory,
    *,
    title: str,
    label: str = "planned",
    others: Mapping[str, Trajectory] | None = None,
    demonstrations: Sequence[Demonstration] = (),
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
    force: bool = False,
) -> None:
    """Draw positions, velocities and efforts of a motion over time, joint by joint.

    Parameters
    ----------
    path : str or Path
        The PNG file to write.
    trajectory : Trajectory
        The motion.
    title : str
        Title of the picture.
    label : str
        What the legend calls the motion.
    others : mapping of str to Trajectory, optional
        Motions of the same joints to compare it with, by what the legend calls them.
    demonstrations : sequence of Demonstration
        Demonstrated motions of the same joints, drawn behind.
    limits : JointLimits, optional
        Limits of the same joints, drawn where the motions come near.
    prismatic : collection of str
        Joints that are measured in metres; the others are drawn in degrees.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the motion has only one point, the joints are not the same everywhere, two have
        the same label, or the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    motions = _with_labels(label, trajectory, others or {})
    longest = max([*(m.duration for m in motions.values()), *(d.duration for d in demonstrations)])
    if longest == 0.0:
        raise PlannerError("a motion of one point can't be drawn, at least two are needed")
    _check_joints(trajectory.joint_names, [*motions.values(), *demonstrations, limits])
    names = trajectory.joint_names
    styles = _motion_curves(motions)
    curves: list[tuple[Trajectory | Demonstration, _Curve]] = [
        *((demonstration, _DEMONSTRATION) for demonstration in demonstrations),
        *zip(motions.values(), styles, strict=True),
    ]
    entries = [*styles]
    if demonstrations:
        entries.append(_DEMONSTRATION)
    if limits is not None:
        entries.append(_LIMIT)
    has_efforts = any(motion.efforts is not None for motion in motions.values())
    n_rows = len(_ROWS) if has_efforts else len(_ROWS) - 1
    figure, panels = _joint_panels(names, n_rows, title, entries)
    for j, (name, panel) in enumerate(zip(names, panels, strict=True)):
        rows = (_PRISMATIC_ROWS if name in prismatic else _ROWS)[:n_rows]
        for axes, row in zip(panel, rows, strict=True):
            for motion, style in curves:
                values = _samples(motion, row, j)
                if values is not None:
                    _draw(axes, motion.times, values, style)
            _frame_curve(axes, row, [] if limits is None else _bounds(limits, row, j))
            x = "time [s]" if row is rows[-1] else ""
            _label(axes, x, row.name, in_all_columns=bool(prismatic))
            axes.set_xlim(0.0, longest)
    _save(figure, path, force)


def draw_arm(
    path: str | Path | io.BytesIO,
    frames: Sequence[str],
    motions: Mapping[str, ArrayLike],
    *,
    title: str,
    n_ghosts: int = 8,
    force: bool = False,
) -> None:
    """Draw motions of an arm as stills that fade in, from the front and from the side.

    One row per motion, all in the same scale ([P] Figs. 3 and 4). The front view looks along
    -x, facing a person who looks along x; the side view looks along y, at the person's right.

    Parameters
    ----------
    path : str, Path or BytesIO
        The PNG file to write, or the buffer that takes its content.
    frames : sequence of str
        Names of the n_points frames along the arm, from its base to its tip.
    motions : mapping of str to array, shape (n_steps, n_points, 3)
        By what the picture calls them: origins of the frames in the base frame [m] (x forward,
        y left, z up), evenly spaced in time.
    title : str
        Title of the picture.
    n_ghosts : int
        Number of stills, first and last included; at least 2.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If there is nothing to draw, shapes disagree, a number is not finite or the file
        can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    names = unique_names(frames, "frames of an arm", PlannerError)
    labels = unique_names(list(motions), "motions to draw", PlannerError)
    if n_ghosts < 2:
        raise PlannerError(f"a motion needs at least 2 stills, got {n_ghosts}")
    chains = [
        frozen_array(motions[x], (None, len(names), 3), f"points of '{x}'", PlannerError)
        for x in labels
    ]
    for label, chain in zip(labels, chains, strict=True):
        if len(chain) < 2:
            raise PlannerError(f"'{label}' has {len(chain)} steps, at least 2 are needed")
    box = _view_box(np.concatenate([chain.reshape(-1, 3) for chain in chains]))
    figure, rows = _arm_panels(len(chains), box, title, names[-1])
    for i, (label, chain, panels) in enumerate(zip(labels, chains, rows, strict=True)):
        colour = _COLOURS[i % len(_COLOURS)]
        for axes, horizontal in zip(panels, (1, 0), strict=True):
            _draw_stills(axes, chain[:, :, [horizontal, 2]], n_ghosts, colour)
            axes.set_aspect("equal")
            axes.set_xlim(*box[horizontal])
            axes.set_ylim(*box[2])
        panels[0].set_ylabel(f"{label}\nz [m]", fontsize=_TEXT_SIZE)
    _save(figure, path, force)


def draw_components(
    path: str | Path | io.BytesIO,
    *,
    joint_names: Sequence[str],
    components: Sequence[ArrayLike],
    title: str,
    force: bool = False,
) -> None:
    """Draw each joint's principal components over time ([P] Fig. 2).

    Parameters
    ----------
    path : str, Path or BytesIO
        The PNG file to write, or the buffer that takes its content.
    joint_names : sequence of str
        Names of n_joints joints.
    components : sequence of array, shape (n_components, n_phases)
        Of each joint.
    title : str
        Title of the picture.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If shapes disagree, or the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    names = unique_names(joint_names, "joints", PlannerError)
    most = max(len(np.atleast_2d(found)) for found in components)
    curves = [
        _Curve(f"PC{k + 1}", _COLOURS[k % len(_COLOURS)], _STYLES[k % len(_STYLES)], 2.2)
        for k in range(most)
    ]
    figure, panels = _joint_panels(names, 1, title, curves)
    for panel, found in zip(panels, components, strict=True):
        values = frozen_array(found, (None, None), "components", PlannerError)
        for row, curve in zip(values, curves, strict=False):
            _draw(panel[0], np.linspace(0.0, 1.0, row.size), row, curve)
        _label(panel[0], "share of the duration", "component [–]")
        panel[0].set_xlim(0.0, 1.0)
    _save(figure, path, force)


def draw_trade_off(
    path: str | Path | io.BytesIO,
    curve: Mapping[str, tuple[float, float]],
    points: Mapping[str, tuple[float, float]],
    *,
    title: str,
    force: bool = False,
) -> None:
    """Draw errors over efforts: a curve of one method's settings, and other methods.

    Parameters
    ----------
    path : str, Path or BytesIO
        The PNG file to write, or the buffer that takes its content.
    curve, points : mapping of str to (effort, error)
        By what the picture calls them: effort as a multiple of the least, error [deg].
    title : str
        Title of the picture.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    styles = [
        _Curve(
            name, _COLOURS[1 + i % (len(_COLOURS) - 1)], "", 0.0, {"marker": mark, "markersize": 9}
        )
        for i, (name, mark) in enumerate(zip(points, "sD^vP*X<>" * len(points), strict=False))
    ]
    figure = _figure(8.0, 4.8, _HEADER_HEIGHT + 0.1, title)
    _draw_legend(figure, styles, 3)
    axes = figure.subplots()
    x, y = np.array(list(curve.values())).T
    axes.plot(x, y, color=_COLOURS[0], linewidth=2.2, marker="o", markersize=7)
    for (name, place), style in zip(points.items(), styles, strict=True):
        axes.plot(*place, color=style.colour, linestyle="none", label=name, **style.marker)
    for name, place in curve.items():
        axes.annotate(
            name,
            place,
            (2, 10),
            textcoords="offset points",
            fontsize=_TICK_SIZE,
            color=_COLOURS[0],
            rotation=45,
            rotation_mode="anchor",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    from matplotlib.ticker import FuncFormatter, LogLocator

    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(LogLocator(subs=()))
    _label(axes, "effort, as a multiple of that of B-splines (median)", "RMS error in path [deg]")
    axes.margins(0.15, 0.2)
    _save(figure, path, force)


class Cloud(NamedTuple):
    """Points of one kind, and what the legend calls them."""

    label: str
    points: Sequence[tuple[float, float]]


def draw_comparison(
    path: str | Path,
    clouds: Sequence[Cloud],
    *,
    x: str,
    y: str,
    title: str,
    force: bool = False,
) -> None:
    """Draw clouds of positive points on logarithmic axes, each with its median.

    Parameters
    ----------
    path : str or Path
        The PNG file to write.
    clouds : sequence of Cloud
        The points, at least one in each.
    x, y : str
        Labels of the axes.
    title : str
        Title of the picture.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    columns = 4
    n_rows = ceil(len(clouds) / columns)
    figure = _figure(11.0, 7.0, 0.6 + _LEGEND_ROW_HEIGHT * n_rows, title)
    axes = figure.subplots()
    entries = []
    for i, cloud in enumerate(clouds):
        colour, marker = _COLOURS[i % len(_COLOURS)], _MARKERS[i // len(_COLOURS)]
        times, costs = np.array(cloud.points, dtype=np.float64).T
        axes.plot(times, costs, marker, color=colour, markersize=4, alpha=0.3, markeredgewidth=0)
        style: dict[str, Any] = {"marker": marker, "markersize": 11, "markeredgecolor": _BLACK}
        axes.plot(np.median(times), np.median(costs), color=colour, linestyle="", **style)
        entries.append(_Curve(cloud.label, colour, "", 0.0, style))
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    _label(axes, x, y)
    axes.tick_params(which="minor", labelsize=_TICK_SIZE - 2)
    _draw_legend(figure, entries, columns)
    _save(figure, path, force)


def _recording_figure(entries: Sequence[_Curve]) -> Figure:
    columns = 4
    header = 0.15 + _LEGEND_ROW_HEIGHT * ceil(len(entries) / columns)
    figure = _figure(*_RECORDING, header, "")
    _draw_legend(figure, entries, columns, top=0.08)
    return figure


def _joint_curves(names: Sequence[str]) -> list[_Curve]:
    n = len(_COLOURS)
    return [
        _Curve(name, _COLOURS[i % n], _STYLES[(i // n) % len(_STYLES)], 1.4)
        for i, name in enumerate(names)
    ]


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def _variance_shares(values: ArrayLike, n_components: int, n_joints: int) -> FloatArray:
    per_joint = np.ndim(values) == 2
    shape = (n_joints, n_components) if per_joint else (n_components,)
    shares = frozen_array(values, shape, "explained variance ratios", PlannerError)
    return np.broadcast_to(shares, (n_joints, n_components))


def _component_curves(n_components: int, shares: FloatArray | None = None) -> list[_Curve]:
    """The first components, with their shares of the variance if these are of all joints."""
    return [
        _Curve(
            f"±1 sd, component {k + 1}" + ("" if shares is None else f" ({100 * shares[k]:.1f} %)"),
            *(_COLOURS[k], _STYLES[k], 1.8),
        )
        for k in range(min(n_components, _MOST_COMPONENTS))
    ]


def _motion_curves(motions: Iterable[str]) -> list[_Curve]:
    return [
        _Curve(label, _COLOURS[i % len(_COLOURS)], _STYLES[i % len(_STYLES)], 2.2)
        for i, label in enumerate(motions)
    ]


def _with_labels(
    label: str, trajectory: Trajectory, others: Mapping[str, Trajectory]
) -> dict[str, Trajectory]:
    unique_names([label, *others], "labels of motions", PlannerError)
    return {label: trajectory, **others}


def _check_joints(
    names: tuple[str, ...],
    things: Iterable[Trajectory | Demonstration | JointLimits | None],
) -> None:
    for thing in things:
        if thing is not None and thing.joint_names != names:
            raise PlannerError(
                f"the joints {quote_names(thing.joint_names)} can't be drawn with the motion of "
                f"{quote_names(names)}: they must be the same in the same order"
            )


def _samples(motion: Trajectory | Demonstration, row: _Row, joint: int) -> FloatArray | None:
    # Demonstrations have no efforts, and trajectories may have none.
    values: FloatArray | None = getattr(motion, row.field, None)
    return None if values is None else values[:, joint] * row.scale


def _bounds(limits: JointLimits, row: _Row, joint: int) -> list[float]:
    values = [float(getattr(limits, name)[joint]) * row.scale for name in row.limits]
    # One limit of a magnitude stands for both signs.
    return values if len(values) == 2 else [-values[0], values[0]]


def _frame_curve(axes: Axes, row: _Row, bounds: Sequence[float]) -> None:
    """Choose the range of values; show the bounds that are near."""
    low, high = axes.dataLim.intervaly
    span = max(high - low, row.least_span)
    middle = (low + high) / 2
    low, high = middle - span / 2, middle + span / 2
    near = [b for b in bounds if low - _NEAR_LIMIT * span < b < high + _NEAR_LIMIT * span]
    for bound in near:
        axes.axhline(bound, color=_LIMIT.colour, linestyle=_LIMIT.style, linewidth=_LIMIT.width)
    low, high = min([low, *near]), max([high, *near])
    axes.set_ylim(low - 0.08 * span, high + 0.08 * span)


def _draw(axes: Axes, x: FloatArray, y: FloatArray, curve: _Curve) -> None:
    axes.plot(x, y, color=curve.colour, linestyle=curve.style, linewidth=curve.width)


def _draw_around(
    axes: Axes, x: FloatArray, centre: FloatArray, deviation: FloatArray, curve: _Curve
) -> None:
    axes.fill_between(
        x, centre - deviation, centre + deviation, color=curve.colour, alpha=0.12, linewidth=0
    )
    for sign in (1, -1):
        _draw(axes, x, centre + sign * deviation, curve)


def _draw_stills(axes: Axes, chain: FloatArray, n_stills: int, colour: str) -> None:
    """Draw a chain, shape (n_steps, n_points, 2), at some times, and the path of its tip."""
    chosen = np.unique(np.linspace(0, len(chain) - 1, n_stills).round().astype(int))
    for step, strength in zip(chosen, np.linspace(0.2, 1.0, chosen.size), strict=True):
        axes.plot(
            *chain[step].T,
            color=colour,
            alpha=strength,
            linewidth=3.5,
            marker="o",
            markersize=6,
            solid_capstyle="round",
        )
    tip = chain[:, -1]
    axes.plot(*tip.T, color=_BLACK, linewidth=1.5, linestyle=(0, (3, 2)))
    axes.plot(*tip[0], color=_BLACK, **_START_MARKER)
    axes.plot(*tip[-1], color=_BLACK, **_END_MARKER)


def _view_box(points: FloatArray) -> FloatArray:
    """Ranges of x, y and z that hold all points, none too narrow for its labels, shape (3, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, max(0.6 * (high - low).max(), _LEAST_VIEW)) * 1.12
    middle = (low + high) / 2
    return np.stack([middle - span / 2, middle + span / 2], axis=1)


def _joint_panels(
    names: Sequence[str], n_rows: int, title: str, entries: Sequence[_Curve]
) -> tuple[Figure, list[list[Axes]]]:
    """Make a column of panels per joint, wrapped into bands if there are many joints."""
    n_bands = ceil(len(names) / _MOST_COLUMNS)
    n_columns = ceil(len(names) / n_bands)
    width = max(n_columns * _PANEL[0], 2 * _PANEL[0])
    legend_columns = max(1, int(width / 2.7))
    header = _HEADER_HEIGHT + _LEGEND_ROW_HEIGHT * (ceil(len(entries) / legend_columns) - 1)
    figure = _figure(width, n_bands * n_rows * _PANEL[1], header, title)
    _draw_legend(figure, entries, legend_columns)
    grid = figure.subplots(n_bands * n_rows, n_columns, squeeze=False)
    panels = []
    for j, (band, column) in enumerate(np.ndindex(n_bands, n_columns)):
        panel = list(grid[band * n_rows : (band + 1) * n_rows, column])
        if j < len(names):
            panel[0].set_title(names[j], fontsize=_TEXT_SIZE, fontweight="bold")
            panels.append(panel)
        else:
            for axes in panel:
                axes.remove()
    return figure, panels


def _arm_panels(
    n_motions: int, box: FloatArray, title: str, tip: str
) -> tuple[Figure, Iterator[list[Axes]]]:
    side_span, front_span, up_span = box[:, 1] - box[:, 0]
    width = (_ARM_ROW_HEIGHT - 0.9) * (front_span + side_span) / up_span + 2.0
    figure = _figure(max(width, 2 * _PANEL[0]), n_motions * _ARM_ROW_HEIGHT, _HEADER_HEIGHT, title)
    entries = [
        _Curve(f"path of {tip}", _BLACK, (0, (3, 2)), 1.5),
        _Curve("start (pale)", _BLACK, "", 0.0, _START_MARKER),
        _Curve("end (dark)", _BLACK, "", 0.0, _END_MARKER),
    ]
    _draw_legend(figure, entries, len(entries))
    grid = figure.subplots(n_motions, 2, squeeze=False, width_ratios=[front_span, side_span])
    for axes, name in zip(grid[0], ("front view, from +x", "side view, from -y"), strict=True):
        axes.set_title(name, fontsize=_TEXT_SIZE, fontweight="bold")
    for row in grid:
        _label(row[0], "y [m] (left of the body →)", "z [m]")
        _label(row[1], "x [m] (forward →)", "z [m]")
    return figure, (list(row) for row in grid)


def _figure(width: float, height: float, header: float, title: str) -> Figure:
    """Make an empty figure [inch] with a title, its panels kept below the header."""
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    total = height + header
    engine = ConstrainedLayoutEngine(
        rect=(0.0, 0.0, 1.0, height / total), h_pad=0.08, w_pad=0.08, hspace=0.04
    )
    figure = Figure(figsize=(width, total), dpi=_DPI, facecolor="white", layout=engine)
    FigureCanvasAgg(figure)
    figure.text(
        0.5, 1.0 - 0.1 / total, title, fontsize=_TITLE_SIZE, horizontalalignment="center", va="top"
    )
    return figure


def _draw_legend(
    figure: Figure, entries: Sequence[_Curve], n_columns: int, *, top: float = 0.45
) -> None:
    """Draw a legend that far below the upper edge [inch]."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            label=entry.label,
            color=entry.colour,
            linestyle=entry.style,
            linewidth=entry.width,
            **entry.marker,
        )
        for entry in entries
    ]
    figure.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 1.0 - top / figure.get_figheight()),
        ncol=min(n_columns, len(handles)),
        fontsize=_TEXT_SIZE,
        frameon=False,
        handlelength=3.0,
    )


def _label(axes: Axes, x: str, y: str, *, in_all_columns: bool = False) -> None:
    """Label the axes; values only in the first column, if all columns show the same."""
    place = axes.get_subplotspec()
    shown = in_all_columns or (place is not None and place.is_first_col())
    axes.set_xlabel(x, fontsize=_TEXT_SIZE)
    axes.set_ylabel(y if shown else "", fontsize=_TEXT_SIZE)
    axes.tick_params(labelsize=_TICK_SIZE)
    axes.grid(color="#DDDDDD", linewidth=0.8)
    axes.set_axisbelow(True)


def _save(figure: Figure, path: str | Path | io.BytesIO, force: bool) -> None:
    _show_names_as_they_are(figure)
    if isinstance(path, io.BytesIO):
        figure.savefig(path, format="png", dpi=_DPI)
        return
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise PlannerError(f"pictures are PNG files, so '{target}' must be called something.png")
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI)
    write_whole(target, content.getvalue(), overwrite=force)


def _show_names_as_they_are(figure: Figure) -> None:
    """Keep matplotlib from reading $ in names as mathematics, and control characters as text."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        content = text.get_text()
        # Ticks get their text, which may be mathematics, when they are drawn.
        if content:
            text.set_parse_math(False)
            text.set_text("\n".join(map(printable, content.split("\n"))))
