# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures for notebooks and windows: plans and primitives on Matplotlib Axes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..planning.plan import Plan
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from .motion import QUANTITIES, plot_motion
from .plan import plan_figure
from .primitive import plot_components, primitive_figure
from .style import styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_plan(
    plan: Plan,
    axes: Axes | Sequence[Axes] | None = None,
    *,
    primitives: Sequence[MovementPrimitive] = (),
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
) -> NDArray[np.object_]:
    """Plot the trajectory of a plan.

    Parameters
    ----------
    plan : Plan
        The plan.
    axes : Axes or sequence of Axes, optional
        Where to plot positions, velocities and efforts, as many as there are Axes, each of all
        joints. By default a new pyplot figure of at most twelve panels, with vias and warnings.
    primitives : sequence of MovementPrimitive
        Primitives whose nearest demonstrations are shown in a new figure.
    limits : JointLimits, optional
        Limits to show in a new figure if the motion is near them.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.

    Returns
    -------
    axes : array of Axes
        The Axes, shape (n_columns, n_quantities) of a new figure.
    """
    trajectory = plan.trajectory
    if axes is None:
        with styled_figure(interactive=True) as figure:
            return np.array(plan_figure(figure, plan, primitives, limits, prismatic))
    given = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    for one, quantity in zip(given, QUANTITIES, strict=False):
        plot_motion(one, trajectory, quantity, prismatic=prismatic)
    return given


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
    """
    if axes is None:
        with styled_figure(interactive=True) as figure:
            return np.array(primitive_figure(figure, primitive, title=f"'{primitive.name}'"))
    given = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    for joint, one in enumerate(given[: primitive.n_joints]):
        plot_components(one, primitive, joint)
    return given
