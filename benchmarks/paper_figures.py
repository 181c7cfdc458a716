# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures 2 to 4 of the case study: components, and stills of the arm-raising motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from paper_method import N_COMPONENTS, PAPER, CaseStudy
from prediction import BSPLINES, LEAST_EFFORT, PLANNED

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import printable
from mp_pca_planner.plotting.style import (
    BLACK,
    COLOURS,
    Line,
    add_header,
    joint_panels,
    label_left,
    line,
    palette_line,
    picture,
)
from mp_pca_planner.robot.model import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_START: Line = {"marker": "o", "markersize": 8, "markerfacecolor": "white"}
_END: Line = {"marker": "s", "markersize": 8}
# Coordinates and labels of the horizontal axes of the front view and of the side view.
_VIEWS = (
    (1, "front view, from +x", "y [m] (left of the body →)"),
    (0, "side view, from -y", "x [m] (forward →)"),
)


def draw_pictures(study: CaseStudy, robot: Robot, frames: Sequence[str], folder: Path) -> None:
    """Draw Figure 2, and Figures 3 and 4, of [P] into a folder."""
    with picture(folder / "figure_2.png", force=True) as figure:
        lines = [palette_line(f"PC{k + 1}", k) for k in range(N_COMPONENTS)]
        panels = joint_panels(figure, study.motions[0].joint_names, 1)
        add_header(figure, "Principal components of the joint angles (paper: Fig. 2)", lines)
        for (axes,), found in zip(panels, study.components, strict=True):
            for row, style in zip(found.components[:N_COMPONENTS], lines, strict=False):
                axes.plot(np.linspace(0.0, 1.0, row.size), row, **style)
            axes.set(xlabel="share of the duration", ylabel="component [–]", xlim=(0.0, 1.0))
            label_left(axes)
    with picture(folder / "figures_3_4.png", force=True) as figure:
        title = "The arm-raising motion (paper: Figs. 3 and 4)"
        arm_figure(figure, _chains(study, robot, frames), title, frames[-1])


def _chains(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of the frames, shape (n_frames, n_points, 3), by the label of the motion."""
    n_frames = 61
    chosen = np.linspace(0, 1000, n_frames).round().astype(int)
    names = (BSPLINES, PAPER, LEAST_EFFORT, PLANNED)
    positions = {name: study.raised[name].positions[chosen] for name in names}
    positions["demonstrated"] = study.raising.time_normalised(n_frames)
    return {name: robot.frame_positions(q, frames) for name, q in positions.items()}


def plot_arm(
    axes: Axes, chain: FloatArray, horizontal: int, colour: str, n_stills: int = 8
) -> Axes:
    """Plot stills of an arm that fade in, and the path of its tip; z is the vertical axis.

    A chain are origins of the frames along the arm [m], shape (n_steps, n_points, 3).
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
) -> None:
    """Plot motions of an arm from the front and from the side ([P] Figs. 3 and 4).

    One row per motion, all in the same scale. The front view looks along -x, facing a person who
    looks along x; the side view looks along y, at the person's right.
    """
    box = _view_box(np.concatenate([chain.reshape(-1, 3) for chain in motions.values()]))
    side, front, up = box[:, 1] - box[:, 0]
    entries = [
        line(f"path of {tip}", BLACK, (0, (3, 2)), 1.5),
        line("start (pale)", BLACK, "", **_START),
        line("end (dark)", BLACK, "", **_END),
    ]
    width = max(3.1 * (front + side) / up + 2.0, 7.0)
    figure.set_size_inches(width, 4.0 * len(motions))
    add_header(figure, title, entries)
    grid = figure.subplots(len(motions), 2, squeeze=False, width_ratios=[front, side])
    for i, (label, chain) in enumerate(motions.items()):
        for axes, (horizontal, view, name) in zip(grid[i], _VIEWS, strict=True):
            plot_arm(axes, chain, horizontal, COLOURS[i % len(COLOURS)])
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
