# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of plans, and figures for notebooks and windows on Matplotlib Axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, by_name
from ..planning.plan import Plan
from ..planning.report import UNUSUAL_IN_SPAN_SCORE
from ..primitives.differences import PHASES
from ..primitives.primitive import MovementPrimitive
from .motion import Curve, MotionContext, motion_figure, plot_motion
from .primitive import plot_components, primitive_figure
from .style import FIGURES, styled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plan_figure(figure: Figure, plan: Plan) -> list[list[Axes]]:
    """Plot a plan, with a column of panels per joint.

    The limits that the motion is near are drawn, and behind each segment the demonstrations whose
    ends are nearest to its own, re-timed to its duration.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    plan : Plan
        The plan.

    Returns
    -------
    panels : list of list of Axes
        By joint, the Axes of positions, velocities, accelerations if a limit of them is reached,
        and efforts if they are known.
    """
    drawn = f"{len(plan.motions)} segments" if plan.mode else f"'{plan.primitive}'"
    title = f"{drawn}: {plan.message}"
    limits = None if plan.planner is None else plan.planner.limits
    motions, context = {"planned": plan.trajectory}, plan_context(plan)
    return motion_figure(figure, motions, title, limits, _prismatic(plan), context)


def _prismatic(plan: Plan) -> tuple[str, ...]:
    return () if plan.planner is None else plan.planner.robot.prismatic_joints


def plan_context(plan: Plan) -> MotionContext:
    """What the figure of a plan shows beside its trajectory."""
    joints = list(plan.trajectory.joint_names)
    behind: list[Curve] = []
    begin = 0.0
    for motion, name in zip(plan.motions, plan.primitives, strict=True):
        if plan.planner is not None:
            primitive = plan.planner.primitives.named(name)
            states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
            ends = np.array([[state[joint] for joint in joints] for state in states])
            behind += nearest_curves(primitive, joints, ends, begin, motion.duration)
        begin += motion.duration
    score = plan.in_span_score
    unlike = f"unlike the demonstrations (in-span score {score:.1f}, usual: about 1)"
    warnings = [unlike] if score > UNUSUAL_IN_SPAN_SCORE else []
    return MotionContext(behind, plan.duration * np.array(plan.via_phases), warnings)


def nearest_curves(
    primitive: MovementPrimitive,
    joint_names: Sequence[str],
    ends: FloatArray,
    begin: float,
    duration: float,
) -> list[Curve]:
    """The demonstrations whose ends are nearest to those of a motion, re-timed to it.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive, which has learned the demonstrations.
    joint_names : sequence of str
        The joints of the primitive, in any order.
    ends : array, shape (2, n_joints)
        First and last position of these joints [rad or m].
    begin, duration : float
        Start and duration of the motion [s].
    """
    order = [primitive.joint_names.index(joint) for joint in joint_names]
    own_ends = np.empty_like(ends)
    own_ends[:, order] = ends
    times = begin + duration * PHASES
    return [
        (times, primitive.reproduction(int(i), primitive.durations[i] * PHASES)[:, order])
        for i in primitive.nearest_demonstrations(own_ends)[: FIGURES.max_behind]
    ]


def plot_plan(plan: Plan, axes: Axes | Sequence[Axes] | None = None) -> NDArray[np.object_]:
    """Plot the trajectory of a plan.

    Parameters
    ----------
    plan : Plan
        The plan.
    axes : Axes or sequence of Axes, optional
        Where to plot positions, velocities and efforts, as many as there are Axes, each of all
        joints. By default a new pyplot figure, see :func:`plan_figure`.

    Returns
    -------
    axes : array of Axes
        The Axes, shape (n_joints, n_quantities) of a new figure.
    """
    trajectory = plan.trajectory
    if axes is None:
        with styled_figure(interactive=True) as figure:
            return np.array(plan_figure(figure, plan))
    given = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    for one, quantity in zip(given, ("positions", "velocities", "efforts"), strict=False):
        plot_motion(one, trajectory, quantity, prismatic=_prismatic(plan))
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
