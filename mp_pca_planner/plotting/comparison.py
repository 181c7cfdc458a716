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
