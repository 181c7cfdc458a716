# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of motions: positions, velocities and efforts over time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, printable
from ..motion.trajectory import Trajectory
from ..robot.limits import JointLimits
from .style import BLACK, COLOURS, FIGURES, LINES, STYLES, Line, add_header, label_left, line
from .units import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

QUANTITIES = ("positions", "velocities", "efforts")
"""Plotted quantities of a motion, from top to bottom."""

Curve = tuple[FloatArray, FloatArray]
"""Times [s] and positions [rad or m], shapes (n_times,) and (n_times, n_joints)."""


@dataclass(frozen=True)
class MotionContext:
    """What a figure shows beside motions.

    Attributes
    ----------
    behind : sequence of Curve
        Curves behind the positions, such as demonstrations.
    vias : array, shape (n_vias,)
        Times at which the first motion passes its vias [s].
    warnings : sequence of str
        Warnings above the panels.
    """

    behind: Sequence[Curve] = ()
    vias: FloatArray = field(default_factory=lambda: np.zeros(0))
    warnings: Sequence[str] = ()

    def entries(self) -> list[Line]:
        """Entries of the legend."""
        entries = [LINES["behind"]] * bool(self.behind) + [LINES["via"]] * bool(self.vias.size)
        return entries + [LINES["warning"] | {"label": warning} for warning in self.warnings]


def plot_motion(
    axes: Axes,
    trajectory: Trajectory,
    quantity: str = "positions",
    joints: Sequence[str] | None = None,
    *,
    prismatic: Collection[str] = (),
    lines: Sequence[Line] | None = None,
) -> Axes:
    """Plot a quantity of some joints over time, one line per joint.

    Parameters
    ----------
    axes : Axes
        Where to plot.
    trajectory : Trajectory
        The motion.
    quantity : {'positions', 'velocities', 'efforts'}
        Quantity to plot; efforts are skipped for a motion without efforts.
    joints : sequence of str, optional
        Which joints; all by default.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.
    lines : sequence of Line, optional
        Properties of the line of each joint.
    """
    names = list(trajectory.joint_names if joints is None else joints)
    values = getattr(trajectory, quantity)
    factor, label = _scale(quantity, names, prismatic)
    if values is not None:
        for name, style in zip(names, lines or _lines("-", names), strict=True):
            joint = trajectory.joint_names.index(name)
            axes.plot(trajectory.times, factor * values[:, joint], **style)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    return axes


def motion_figure(
    figure: Figure,
    motions: Mapping[str, Trajectory],
    title: str,
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
    context: MotionContext | None = None,
) -> list[list[Axes]]:
    """Plot motions of the same joints, at most twelve panels.

    Each column shows one joint, or several of one unit if there are more than four.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    motions : mapping of str to Trajectory
        The motions, by their labels.
    title : str
        Title of the figure.
    limits : JointLimits, optional
        Limits of the same joints, drawn if the motions are near them.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.
    context : MotionContext, optional
        What is shown beside the motions.

    Returns
    -------
    panels : list of list of Axes
        By column, the Axes of positions, velocities and, if known, efforts.

    Raises
    ------
    PlannerError
        If the motions have one point each.
    """
    names = next(iter(motions.values())).joint_names
    duration = max(motion.duration for motion in motions.values())
    if duration == 0.0:
        raise PlannerError("a motion of one point can't be drawn: at least two are needed")
    groups = _groups(names, prismatic)
    quantities = [q for q in QUANTITIES if any(getattr(m, q) is not None for m in motions.values())]
    is_single = len(groups) == len(names)
    entries = [
        line(label, COLOURS[i % len(COLOURS)] if is_single else BLACK, STYLES[i % len(STYLES)])
        for i, label in enumerate(motions)
    ]
    context, drawn_limits = MotionContext() if context is None else context, 0
    grid = figure.subplots(len(quantities), len(groups), squeeze=False, sharex=True)
    for column, group in zip(grid.T, groups, strict=True):
        for entry, motion in zip(entries, motions.values(), strict=True):
            lines = [entry] if is_single else _lines(entry["linestyle"], group)
            for axes, quantity in zip(column, quantities, strict=True):
                plot_motion(axes, motion, quantity, group, prismatic=prismatic, lines=lines)
        for axes, quantity in zip(column, quantities, strict=True):
            drawn_limits += _show_limits(axes, quantity, group, limits, prismatic)
            if not prismatic:
                label_left(axes)
        _show_context(column[0], context, next(iter(motions.values())), group, prismatic)
        for axes in column[:-1]:
            axes.set_xlabel("")
        _name_joints(column[0], group)
    grid[0, 0].set_xlim(0.0, duration)
    header = [*entries, *([LINES["limit"]] if drawn_limits else []), *context.entries()]
    width, height = 3.5 * max(len(groups), 2), 2.3 * len(quantities)
    add_header(figure, title, header, width, height)
    return [list(column) for column in grid.T]


def _groups(names: Sequence[str], prismatic: Collection[str]) -> list[list[str]]:
    """The joints of each column, all of them of one unit if there are several."""
    n_most = FIGURES.max_columns
    if len(names) <= n_most:
        return [[name] for name in names]
    sliding = [name for name in names if name in prismatic]
    turning = [name for name in names if name not in prismatic]
    n_sliding = round(n_most * len(sliding) / len(names))
    if sliding and turning:
        n_sliding = min(max(n_sliding, 1), len(sliding), n_most - 1)
    n_turning = min(n_most - n_sliding, len(turning))
    columns = [(turning, n_turning), (sliding, n_sliding)]
    return [list(group) for some, n in columns if n for group in np.array_split(some, n)]


def _show_context(
    axes: Axes,
    context: MotionContext,
    motion: Trajectory,
    names: Sequence[str],
    prismatic: Collection[str],
) -> None:
    """Draw curves behind the positions of some joints, and the vias of a motion on them."""
    factor, _ = _scale("positions", names, prismatic)
    for i, name in enumerate(names):
        joint = motion.joint_names.index(name)
        colour = (
            LINES["behind"]
            if len(names) == 1
            else LINES["behind"] | {"color": COLOURS[i % len(COLOURS)]}
        )
        for times, positions in context.behind:
            values = factor * positions[:, joint]
            axes.plot(times, values, **colour | {"label": None})
            low, high = axes.get_ylim()
            axes.set_ylim(min(low, values.min()), max(high, values.max()))
        for via in context.vias:
            passed = np.interp(via, motion.times, motion.positions[:, joint])
            axes.plot(via, factor * passed, **LINES["via"] | {"label": None})


def _lines(style: object, names: Sequence[str]) -> list[Line]:
    """A line per joint, by colour."""
    return [line(printable(n), COLOURS[i % len(COLOURS)], style) for i, n in enumerate(names)]


def _scale(quantity: str, names: Sequence[str], prismatic: Collection[str]) -> tuple[float, str]:
    """Factor from SI units, and label of the axis."""
    unit = unit_of(names, prismatic)
    return {
        "positions": (unit.factor, f"position [{unit.name}]"),
        "velocities": (unit.factor, f"velocity [{unit.speed}]"),
        "efforts": (1.0, f"effort [{unit.effort}]"),
    }[quantity]


def _show_limits(
    axes: Axes,
    quantity: str,
    names: Sequence[str],
    limits: JointLimits | None,
    prismatic: Collection[str],
) -> int:
    """Set the range of values; draw the limits that are near, of several joints by colour.

    Returns the number of limits drawn.
    """
    factor, _ = _scale(quantity, names, prismatic)
    low, high = axes.dataLim.intervaly
    least = FIGURES.min_effort_span if quantity == "efforts" else FIGURES.min_span
    span = max(high - low, factor * least)
    low, high = (low + high - span) / 2, (low + high + span) / 2
    reach = low - FIGURES.near_limit * span, high + FIGURES.near_limit * span
    shown = [low, high]
    for i, name in enumerate(names):
        colour = BLACK if len(names) == 1 else COLOURS[i % len(COLOURS)]
        for bound in factor * _bounds(limits, quantity, name):
            if reach[0] < bound < reach[1]:
                axes.axhline(bound, **LINES["limit"] | {"color": colour})
                shown.append(bound)
    axes.set_ylim(min(shown) - 0.08 * span, max(shown) + 0.08 * span)
    return len(shown) - 2


def _bounds(limits: JointLimits | None, quantity: str, name: str) -> FloatArray:
    """Lower and upper limit of a joint; none without limits."""
    if limits is None:
        return np.array([])
    joint = limits.joint_names.index(name)
    if quantity == "positions":
        return np.array([limits.lower[joint], limits.upper[joint]])
    magnitude = limits.velocity if quantity == "velocities" else limits.effort
    return np.array([-magnitude[joint], magnitude[joint]])


def _name_joints(axes: Axes, names: Sequence[str]) -> None:
    """Name the joint of a column above it, or several with their colours."""
    if len(names) == 1:
        axes.set_title(printable(names[0]))
    else:
        handles = axes.lines[: len(names)]
        axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0))
