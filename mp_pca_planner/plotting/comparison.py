# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures that compare methods, on logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .style import BLACK, COLOURS, Line, add_header, line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Points = Sequence[tuple[float, float]]
_MARKERS = "osD^vP*X<>"


def trade_off_figure(
    figure: Figure,
    curve: Mapping[str, tuple[float, float]],
    points: Mapping[str, tuple[float, float]],
    title: str,
) -> None:
    """Plot errors over efforts: a curve of one method's settings, and other methods.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    curve, points : mapping of str to (effort, error)
        By label: effort as a multiple of the least, error [deg].
    title : str
        Title of the figure.
    """
    entries = [
        line(name, COLOURS[1 + i % (len(COLOURS) - 1)], "", marker=mark, markersize=9)
        for i, (name, mark) in enumerate(zip(points, _MARKERS[1:] * len(points), strict=False))
    ]
    add_header(figure, title, entries, 8.0, 4.8)
    axes = figure.subplots()
    colour = COLOURS[0]
    axes.plot(*np.array(list(curve.values())).T, color=colour, linewidth=2.2, marker="o")
    for place, entry in zip(points.values(), entries, strict=True):
        axes.plot(*place, **entry)
    text: Line = {"rotation": 45, "rotation_mode": "anchor", "fontsize": "small", "color": colour}
    for name, place in curve.items():
        axes.annotate(name, place, (2, 10), textcoords="offset points", **text)
    axes.set(
        xlabel="effort, as a multiple of that of B-splines (median)",
        ylabel="RMS error in path [deg]",
    )
    _logarithmic(axes)
    axes.margins(0.15, 0.2)


def comparison_figure(
    figure: Figure, clouds: Mapping[str, Points], x: str, y: str, title: str
) -> None:
    """Plot clouds of positive points, each with its median.

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
    """
    n = len(COLOURS)
    medians = [
        line(
            label, COLOURS[i % n], "", marker=_MARKERS[i // n], markersize=11, markeredgecolor=BLACK
        )
        for i, label in enumerate(clouds)
    ]
    add_header(figure, title, medians, 11.0, 7.0)
    axes = figure.subplots()
    for median, points in zip(medians, clouds.values(), strict=True):
        values = np.array(points, dtype=np.float64)
        small = {"markersize": 4, "markeredgewidth": 0, "alpha": 0.3}
        axes.plot(*values.T, **median | small)
        axes.plot(*np.median(values, axis=0), **median)
    axes.set(xlabel=x, ylabel=y)
    _logarithmic(axes)


def _logarithmic(axes: Axes) -> None:
    """Scale both axes logarithmically, with plain numbers at the ticks."""
    from matplotlib.ticker import LogLocator

    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
