# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of primitives: the demonstrations and the components, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..primitives.differences import PHASES
from ..primitives.primitive import MovementPrimitive
from ..primitives.timing import own_phases
from .style import (
    LINES,
    MAX_COMPONENTS,
    Line,
    add_header,
    joint_panels,
    label_left,
    palette_line,
    styled_figure,
)
from .text import prismatic_joints, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _plot_demonstrations(
    axes: Axes, primitive: MovementPrimitive, joint: int, demonstrations: FloatArray
) -> None:
    """Plot the demonstrations of one joint over the phase."""
    unit = unit_of([primitive.joint_names[joint]], prismatic_joints(primitive))
    shown = unit.factor * demonstrations[:, :, joint]
    axes.plot(PHASES, shown.T, **LINES["demonstration"])
    axes.set(xlabel="phase", ylabel=f"position [{unit.name}]", xlim=(0.0, 1.0))


def _plot_components(axes: Axes, primitive: MovementPrimitive, joint: int) -> None:
    """Plot what a standard deviation along each component adds to the motion of one joint."""
    unit = unit_of([primitive.joint_names[joint]], prismatic_joints(primitive))
    basis = primitive.basis
    deviations = unit.factor * (basis.functions(PHASES) * basis.scales)[:, joint]
    indices = np.arange(primitive.n_components)
    if primitive.coupling == "joint":
        indices = np.flatnonzero(np.equal(primitive.joint_of_component, joint))
    for style, k in zip(_component_lines(primitive), indices, strict=False):
        added = deviations[:, k]
        axes.fill_between(PHASES, -added, added, color=style["color"], alpha=0.12, linewidth=0)
        axes.plot(PHASES, added, **style)
    axes.set(xlabel="phase", ylabel=f"added [{unit.name}]", xlim=(0.0, 1.0))


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
    lines = [LINES["demonstration"], *_component_lines(primitive)]
    panels = joint_panels(figure, primitive.joint_names, 2)
    add_header(figure, title, lines)
    for joint, (above, below) in enumerate(panels):
        _plot_demonstrations(above, primitive, joint, shown)
        _plot_components(below, primitive, joint)
        if primitive.coupling == "joint":
            shares = primitive.explained_variance_ratio[primitive.joint_names[joint]]
            percents = ", ".join(f"{100 * share:.1f}" for share in shares[:MAX_COMPONENTS])
            below.set_title(f"variance: {percents} %", fontsize="small", fontweight="normal")
        if not prismatic_joints(primitive):
            for axes in (above, below):
                label_left(axes)
    return panels


def plot_primitive(primitive: MovementPrimitive) -> NDArray[np.object_]:
    """Plot a primitive in a new pyplot figure; returns its Axes, shape (n_joints, 2)."""
    with styled_figure(interactive=True) as figure:
        return np.array(primitive_figure(figure, primitive, title=f"'{primitive.name}'"))


def _component_lines(primitive: MovementPrimitive) -> list[Line]:
    """Labels of the first components; if these move all joints, with shares of the variance."""
    ratios = primitive.explained_variance_ratio
    shares = ratios.get("arm") if primitive.coupling == "arm" else None
    n_most = max(map(len, ratios.values()), default=0)
    return [
        palette_line(
            f"component {k + 1}, 1 sd" + (f" ({100 * shares[k]:.1f} %)" if shares else ""), k, 1.8
        )
        for k in range(min(n_most, MAX_COMPONENTS))
    ]


def reproductions(primitive: MovementPrimitive, chosen: Sequence[int]) -> FloatArray:
    """Some demonstrations as the components reproduce them, shape (n_chosen, 101, n_joints)."""
    times = [primitive.durations[i] * own_phases(primitive.warps[i], PHASES) for i in chosen]
    return np.array(list(map(primitive.reproduction, chosen, times)))
