# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures and animations of arms in motion: stills from the front and from the side, and GIFs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..exceptions import printable
from ..files import write_whole
from .style import BLACK, COLOURS, GREY, Line, add_header, line, styled_figure

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
