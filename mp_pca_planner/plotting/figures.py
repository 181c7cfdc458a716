# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of plans, and figures for notebooks and windows on Matplotlib Axes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import by_name
from ..planning.plan import Plan
from ..planning.remarks import UNUSUAL_IN_SPAN_SCORE
from ..primitives.differences import PHASES
from ..primitives.prediction import nearest_demonstrations
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from .motion import QUANTITIES, Curve, MotionContext, motion_figure, plot_motion
from .primitive import plot_components, primitive_figure
from .style import FIGURES, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plan_figure(
    figure: Figure,
    plan: Plan,
    primitives: Sequence[MovementPrimitive] = (),
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
) -> list[list[Axes]]:
    """Plot a plan, at most twelve panels.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    plan : Plan
        The plan.
    primitives : sequence of MovementPrimitive
        Primitives of the planner. The demonstrations of those in use whose ends are nearest to
        those of each segment are drawn behind it, re-timed to its duration.
    limits : JointLimits, optional
        Limits of the joints, drawn where the motion is near them.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.

    Returns
    -------
    panels : list of list of Axes
        By column, the Axes of positions, velocities and, if known, efforts.
    """
    drawn = f"{len(plan.motions)} segments" if plan.mode else f"'{plan.primitive}'"
    title = f"{drawn}: {plan.message}"
    context = plan_context(plan, primitives)
    return motion_figure(figure, {"planned": plan.trajectory}, title, limits, prismatic, context)


def plan_context(plan: Plan, primitives: Sequence[MovementPrimitive]) -> MotionContext:
    """What the figure of a plan shows beside its trajectory."""
    known = {primitive.name: primitive for primitive in primitives}
    joints = list(plan.trajectory.joint_names)
    behind: list[Curve] = []
    begin = 0.0
    for motion, name in zip(plan.motions, plan.primitives, strict=True):
        if (primitive := known.get(name)) is not None:
            order = [primitive.joint_names.index(joint) for joint in joints]
            states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
            ends = np.array([[state[joint] for joint in primitive.joint_names] for state in states])
            times = begin + motion.duration * PHASES
            for i in nearest_demonstrations(primitive, ends)[: FIGURES.max_behind]:
                own = primitive.durations[i] * PHASES
                behind.append((times, primitive.reproduction(int(i), own)[:, order]))
        begin += motion.duration
    score = plan.in_span_score
    unlike = f"unlike the demonstrations (in-span score {score:.1f}, usual: about 1)"
    warnings = [unlike] if score > UNUSUAL_IN_SPAN_SCORE else []
    return MotionContext(behind, plan.duration * np.array(plan.via_phases), warnings)


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
