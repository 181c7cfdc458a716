# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures and animations of arms in motion: stills from the front and from the side, and GIFs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import printable
from ..files import write_whole
from ..primitives.differences import PHASES
from ..primitives.primitive import MovementPrimitive
from ..primitives.timing import own_phases
from .style import (
    BLACK,
    COLOURS,
    GREY,
    LINES,
    MAX_COMPONENTS,
    Line,
    add_header,
    given_axes,
    joint_panels,
    label_left,
    line,
    palette_line,
    styled_figure,
)
from .text import prismatic_joints, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_START: Line = {"marker": "o", "markersize": 8, "markerfacecolor": "white"}
_END: Line = {"marker": "s", "markersize": 8}
_GOALS: tuple[Line, ...] = (
    {"colour": "#CFE6F5", "style": "", "marker": "o", "markersize": 4},
    {"colour": COLOURS[0], "style": "", "marker": "o", "markersize": 6},
    {"colour": COLOURS[1], "style": "", "marker": "^", "markersize": 8},
)
# Coordinates and labels of the horizontal axes of the front view and of the side view.
_VIEWS = (
    (1, "front view, from +x", "y [m] (left of the body →)"),
    (0, "side view, from -y", "x [m] (forward →)"),
)


def plot_arm(
    axes: Axes, chain: FloatArray, horizontal: int, colour: str, n_stills: int = 8
) -> Axes:
    """Plot stills of an arm that fade in, and the path of its tip.

    Parameters
    ----------
    axes : Axes
        Where to plot.
    chain : array, shape (n_steps, n_points, 3)
        Origins of the frames along the arm in the base frame [m], evenly spaced in time.
    horizontal : int
        Coordinate of the horizontal axis; z is the vertical one.
    colour : str
        Colour of the arm.
    n_stills : int
        Number of stills, first and last included.
    """
    flat = chain[:, :, [horizontal, 2]]
    chosen = np.unique(np.linspace(0, len(flat) - 1, n_stills).round().astype(int))
    still = line("", colour, width=3.5, marker="o", markersize=6, solid_capstyle="round")
    for step, strength in zip(chosen, np.linspace(0.2, 1.0, chosen.size), strict=True):
        axes.plot(*flat[step].T, **still, alpha=strength)
    tip = flat[:, -1]
    axes.plot(*tip.T, color=BLACK, linewidth=1.5, linestyle=(0, (3, 2)))
    axes.plot(*tip[0], color=BLACK, **_START)
    axes.plot(*tip[-1], color=BLACK, **_END)
    axes.set_aspect("equal")
    return axes


def arm_figure(
    figure: Figure,
    motions: Mapping[str, FloatArray],
    title: str,
    tip: str,
    goals: Mapping[str, FloatArray] | None = None,
) -> None:
    """Plot motions of an arm from the front and from the side ([P] Figs. 3 and 4).

    One row per motion, all in the same scale. The front view looks along -x, facing a person who
    looks along x; the side view looks along y, at the person's right.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    motions : mapping of str to array, shape (n_steps, n_points, 3)
        By label, origins of the frames along the arm in the base frame [m] (x forward, y left,
        z up), evenly spaced in time.
    title : str
        Title of the figure.
    tip : str
        Name of the frame at the end of the arm.
    goals : mapping of str to array, shape (n_goals, 3)
        By label, places of the tip to show behind grey motions [m]: of a region in span, of good
        and of weak goals.
    """
    goals = {} if goals is None else goals
    places = [chain.reshape(-1, 3) for chain in motions.values()]
    box = _view_box(np.concatenate([*places, *goals.values()]))
    side, front, up = box[:, 1] - box[:, 0]
    entries = [
        line(f"path of {tip}", BLACK, (0, (3, 2)), 1.5),
        line("start (pale)", BLACK, "", **_START),
        line("end (dark)", BLACK, "", **_END),
    ]
    marks = [line(name, **style) for name, style in zip(goals, _GOALS, strict=False)]
    width = max(3.1 * (front + side) / up + 2.0, 7.0)
    figure.set_size_inches(width, 4.0 * len(motions))
    add_header(figure, title, entries + marks)
    grid = figure.subplots(len(motions), 2, squeeze=False, width_ratios=[front, side])
    for i, (label, chain) in enumerate(motions.items()):
        for axes, (horizontal, view, name) in zip(grid[i], _VIEWS, strict=True):
            for mark, found in zip(marks, goals.values(), strict=True):
                axes.plot(*found[:, [horizontal, 2]].T, **mark)
            plot_arm(axes, chain, horizontal, GREY if goals else COLOURS[i % len(COLOURS)])
            axes.set(xlim=box[horizontal], ylim=box[2], xlabel=name)
            if i == 0:
                axes.set_title(view)
        grid[i, 0].set_ylabel(f"{printable(label)}\nz [m]")


def _view_box(points: FloatArray) -> FloatArray:
    """Ranges of x, y and z that hold all points, none too narrow for its labels, shape (3, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    # An arm without extent gets a view of 0.05 m.
    span = np.maximum(high - low, max(0.6 * (high - low).max(), 0.05)) * 1.12
    middle = (low + high) / 2
    return np.stack([middle - span / 2, middle + span / 2], axis=1)


_PALE = "#D9D9D9"


# Frames per second; motions run in real time.
ANIMATION_RATE = 20.0
# Frames before and after each motion.
ANIMATION_PAUSE = 12
# Size [inch].
ANIMATION_WIDTH = 4.6
ANIMATION_HEIGHT = 5.1
# Left, bottom, width and height of the drawing, as shares of the size.
ANIMATION_AXES = (0.02, 0.02, 0.96, 0.9)
# Pixels per inch.
ANIMATION_DPI = 80


def at_frames(times: FloatArray, positions: FloatArray) -> FloatArray:
    """Joint positions at the frames of an animation, the last position included.

    Parameters
    ----------
    times : array, shape (n_times,)
        Increasing times [s].
    positions : array, shape (n_times, n_joints)
        Positions at these times [rad or m].
    """
    n_frames = round((times[-1] - times[0]) * ANIMATION_RATE) + 1
    frames = np.linspace(times[0], times[-1], n_frames)
    return np.column_stack([np.interp(frames, times, q) for q in positions.T])


def write_animation(
    path: Path, shown: Sequence[FloatArray], executed: Sequence[FloatArray], *, force: bool = False
) -> None:
    """Draw motions that are shown at once, then motions to goals one after the other, as a GIF.

    Parameters
    ----------
    path : Path
        The file to write.
    shown, executed : sequence of array, shape (n_frames, n_points, 3)
        Origins of the frames along the arm in the base frame [m], x forward and z up, at the
        frames of the animation.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    with styled_figure() as figure, tempfile.TemporaryDirectory() as folder:
        from matplotlib.animation import PillowWriter

        figure.set_size_inches(ANIMATION_WIDTH, ANIMATION_HEIGHT)
        figure.set_layout_engine("none")  # one is computed for each frame otherwise
        axes, writer = figure.add_axes(ANIMATION_AXES), PillowWriter(fps=round(ANIMATION_RATE))
        file = Path(folder, "animation.gif")
        with writer.saving(figure, file, ANIMATION_DPI):
            _draw_frames(axes, shown, executed, writer.grab_frame)
        content = file.read_bytes()
    write_whole(path, content, overwrite=force)


def _draw_frames(
    axes: Axes,
    shown: Sequence[FloatArray],
    executed: Sequence[FloatArray],
    grab: Callable[[], None],
) -> None:
    for k in range(max(map(len, shown)) + ANIMATION_PAUSE):
        _draw_person(axes, "1. Motions are shown")
        for chain in shown:
            _draw_arm(axes, chain[: k + 1], GREY)
        grab()
    for chain in executed:
        for k in range(-ANIMATION_PAUSE, len(chain) + ANIMATION_PAUSE):
            _draw_person(axes, "2. A goal is given" if k < 0 else "3. The simulated robot moves")
            for one in shown:
                _draw_path(axes, one, GREY)
            axes.plot(*chain[-1, -1, [0, 2]], "*", color=COLOURS[1], markersize=18, zorder=3)
            _draw_arm(axes, chain[: max(k, 0) + 1], COLOURS[0])
            grab()


def _draw_person(axes: Axes, title: str) -> None:
    """Begin a frame: the side view of a person without the right arm."""
    axes.clear()
    axes.set(xlim=(-0.45, 0.75), ylim=(-0.62, 0.62), aspect="equal", xticks=[], yticks=[])
    axes.set_title(title, fontsize=15)
    axes.plot([0.0, 0.0], [-0.38, 0.08], color=_PALE, linewidth=34, solid_capstyle="round")
    axes.plot(0.01, 0.25, "o", color=_PALE, markersize=38)


def _draw_arm(axes: Axes, chain: FloatArray, colour: str) -> None:
    """Draw the arm at the end of a motion, and the path of its tip up to there."""
    _draw_path(axes, chain, colour)
    points = chain[-1][:, [0, 2]].T
    axes.plot(*points, color=colour, linewidth=5, marker="o", solid_capstyle="round")


def _draw_path(axes: Axes, chain: FloatArray, colour: str) -> None:
    tip = chain[:, -1, [0, 2]].T
    axes.plot(*tip, color=colour, linewidth=1.5, linestyle="--", alpha=0.7)


def plot_demonstrations(
    axes: Axes, primitive: MovementPrimitive, joint: int, demonstrations: FloatArray
) -> Axes:
    """Plot the demonstrations of one joint over the phase, and their mean.

    Parameters
    ----------
    axes : Axes
        Where to plot.
    primitive : MovementPrimitive
        The primitive.
    joint : int
        Index of the joint.
    demonstrations : array, shape (n_demonstrations, 101, n_joints)
        Aligned positions at evenly spaced phases [rad or m].
    """
    unit = unit_of([primitive.joint_names[joint]], prismatic_joints(primitive))
    shown = unit.factor * demonstrations[:, :, joint]
    axes.plot(PHASES, shown.T, **LINES["demonstration"])
    axes.plot(PHASES, shown.mean(axis=0), **LINES["mean"])
    axes.set(xlabel="phase", ylabel=f"position [{unit.name}]", xlim=(0.0, 1.0))
    return axes


def plot_components(axes: Axes, primitive: MovementPrimitive, joint: int) -> Axes:
    """Plot the mean shape of one joint, plus and minus a standard deviation by component.

    Parameters
    ----------
    axes : Axes
        Where to plot.
    primitive : MovementPrimitive
        The primitive.
    joint : int
        Index of the joint.
    """
    unit = unit_of([primitive.joint_names[joint]], prismatic_joints(primitive))
    basis = primitive.basis
    mean = unit.factor * basis.shape(np.zeros(basis.n_weights), PHASES)[:, joint]
    deviations = unit.factor * (basis.functions(PHASES) * basis.scales)[:, joint]
    indices = np.arange(primitive.n_components)
    if primitive.coupling == "joint":
        indices = np.flatnonzero(np.equal(primitive.joint_of_component, joint))
    for style, k in zip(_component_lines(primitive), indices, strict=False):
        low, high = mean - deviations[:, k], mean + deviations[:, k]
        axes.fill_between(PHASES, low, high, color=style["color"], alpha=0.12, linewidth=0)
        axes.plot(PHASES, high, **style)
        axes.plot(PHASES, low, **style | {"label": None})
    axes.plot(PHASES, mean, **LINES["mean"])
    axes.set(xlabel="phase", ylabel=f"shape [{unit.name}]", xlim=(0.0, 1.0))
    return axes


def primitive_figure(
    figure: Figure,
    primitive: MovementPrimitive,
    demonstrations: FloatArray | None = None,
    title: str = "",
) -> list[list[Axes]]:
    """Plot the demonstrations and components of a primitive, joint by joint ([P] Fig. 2).

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    primitive : MovementPrimitive
        The primitive.
    demonstrations : array, shape (n_demonstrations, 101, n_joints), optional
        Aligned positions at evenly spaced phases [rad or m]; by default as the components
        reproduce them.
    title : str
        Title of the figure.

    Returns
    -------
    panels : list of list of Axes
        By joint, the Axes of the demonstrations and of the components.
    """
    shown = demonstrations
    if shown is None:
        shown = reproductions(primitive, range(len(primitive.durations)))
    lines = [LINES["demonstration"], LINES["mean"], *_component_lines(primitive)]
    panels = joint_panels(figure, primitive.joint_names, 2)
    add_header(figure, title, lines)
    for joint, (above, below) in enumerate(panels):
        plot_demonstrations(above, primitive, joint, shown)
        plot_components(below, primitive, joint)
        if primitive.coupling == "joint":
            shares = primitive.explained_variance_ratio[primitive.joint_names[joint]]
            percents = ", ".join(f"{100 * share:.1f}" for share in shares[:MAX_COMPONENTS])
            below.set_title(f"variance: {percents} %", fontsize="small", fontweight="normal")
        if not prismatic_joints(primitive):
            for axes in (above, below):
                label_left(axes)
    return panels


def plot_primitive(
    primitive: MovementPrimitive, axes: Axes | Sequence[Axes] | None = None
) -> NDArray[np.object_]:
    """Plot the mean shape and the components of a primitive.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    axes : Axes or sequence of Axes, optional
        Where to plot mean shape and components, one of the first joints on each. By default a new
        pyplot figure with the demonstrations, too.

    Returns
    -------
    axes : array of Axes
        The Axes, shape (n_joints, 2) of a new figure.

    Raises
    ------
    PlannerError
        If they are not Axes of Matplotlib.
    """
    if axes is None:
        with styled_figure(interactive=True) as figure:
            return np.array(primitive_figure(figure, primitive, title=f"'{primitive.name}'"))
    given = given_axes(axes).ravel()
    for joint, one in enumerate(given[: primitive.n_joints]):
        plot_components(one, primitive, joint)
    return given


def angle_components_figure(
    figure: Figure, joint_names: Sequence[str], components: Sequence[FloatArray], title: str
) -> None:
    """Plot each joint's principal components over time ([P] Fig. 2).

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    joint_names : sequence of str
        Names of the joints.
    components : sequence of array, shape (n_components, n_phases)
        Of each joint.
    title : str
        Title of the figure.
    """
    lines = [palette_line(f"PC{k + 1}", k) for k in range(max(map(len, components)))]
    panels = joint_panels(figure, joint_names, 1)
    add_header(figure, title, lines)
    for (axes,), found in zip(panels, components, strict=True):
        for row, style in zip(found, lines, strict=False):
            axes.plot(np.linspace(0.0, 1.0, row.size), row, **style)
        axes.set(xlabel="share of the duration", ylabel="component [–]", xlim=(0.0, 1.0))
        label_left(axes)


def _component_lines(primitive: MovementPrimitive) -> list[Line]:
    """Labels of the first components; if these move all joints, with shares of the variance."""
    ratios = primitive.explained_variance_ratio
    shares = ratios.get("arm") if primitive.coupling == "arm" else None
    n_most = max(map(len, ratios.values()), default=0)
    return [
        palette_line(
            f"±1 sd, component {k + 1}" + (f" ({100 * shares[k]:.1f} %)" if shares else ""), k, 1.8
        )
        for k in range(min(n_most, MAX_COMPONENTS))
    ]


def reproductions(primitive: MovementPrimitive, chosen: Sequence[int]) -> FloatArray:
    """Some demonstrations as the components reproduce them, shape (n_chosen, 101, n_joints)."""
    times = [primitive.durations[i] * own_phases(primitive.warps[i], PHASES) for i in chosen]
    return np.array(list(map(primitive.reproduction, chosen, times)))
