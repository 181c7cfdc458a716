# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Animations of an arm beside a person's body: shown motions, and motions to goals."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..files import write_whole
from .style import COLOURS, GREY, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PALE = "#D9D9D9"


@dataclass(frozen=True)
class AnimationOptions:
    """Size and timing of an animation.

    Attributes
    ----------
    rate : float
        Frames per second; motions run in real time.
    pause : int
        Frames before and after each motion.
    width, height : float
        Size [inch].
    axes : tuple of float
        Left, bottom, width and height of the drawing, as shares of the size.
    dpi : int
        Pixels per inch.
    """

    rate: float = 20.0
    pause: int = 12
    width: float = 4.6
    height: float = 5.1
    axes: tuple[float, float, float, float] = (0.02, 0.02, 0.96, 0.9)
    dpi: int = 80


ANIMATION = AnimationOptions()


def at_frames(times: FloatArray, positions: FloatArray) -> FloatArray:
    """Joint positions at the frames of an animation, the last position included.

    Parameters
    ----------
    times : array, shape (n_times,)
        Increasing times [s].
    positions : array, shape (n_times, n_joints)
        Positions at these times [rad or m].
    """
    n_frames = round((times[-1] - times[0]) * ANIMATION.rate) + 1
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

        figure.set_size_inches(ANIMATION.width, ANIMATION.height)
        figure.set_layout_engine("none")  # one is computed for each frame otherwise
        axes, writer = figure.add_axes(ANIMATION.axes), PillowWriter(fps=round(ANIMATION.rate))
        file = Path(folder, "animation.gif")
        with writer.saving(figure, file, ANIMATION.dpi):
            _draw_frames(axes, shown, executed, writer.grab_frame)
        content = file.read_bytes()
    write_whole(path, content, overwrite=force)


def _draw_frames(
    axes: Axes,
    shown: Sequence[FloatArray],
    executed: Sequence[FloatArray],
    grab: Callable[[], None],
) -> None:
    for k in range(max(map(len, shown)) + ANIMATION.pause):
        _draw_person(axes, "1. Motions are shown")
        for chain in shown:
            _draw_arm(axes, chain[: k + 1], GREY)
        grab()
    for chain in executed:
        for k in range(-ANIMATION.pause, len(chain) + ANIMATION.pause):
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
