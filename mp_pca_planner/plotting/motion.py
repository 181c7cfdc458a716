# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of motions and plans: positions, velocities, accelerations, torques over time."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, by_name
from ..exceptions import PlannerError
from ..motion.interpolation import quintics
from ..motion.trajectory import Trajectory
from ..planning.motion import Motion
from ..planning.plan import Plan
from ..primitives.differences import PHASES
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .style import (
    COLOURS,
    LINES,
    MAX_BEHIND,
    MIN_EFFORT_SPAN,
    MIN_SPAN,
    NEAR_LIMIT,
    REACHED_LIMIT,
    STYLES,
    add_header,
    joint_panels,
    label_left,
    line,
    styled_figure,
)
from .text import unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..planning.planner import Planner

QUANTITIES = ("positions", "velocities", "accelerations", "efforts")
"""Plotted quantities of a motion, from top to bottom."""

Curve = tuple[str, FloatArray, FloatArray]
"""A name in `LINES`, times [s] and positions [rad or m], of shapes (n_times,) and
(n_times, n_joints)."""


def motion_figure(
    figure: Figure,
    motions: Mapping[str, Trajectory],
    title: str,
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
    curves: Sequence[Curve] = (),
    vias: Collection[float] = (),
    warnings: Sequence[str] = (),
) -> list[list[Axes]]:
    """Plot motions of the same joints, with a column of panels per joint.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    motions : mapping of str to Trajectory
        The motions, by their labels.
    title : str
        Title of the figure.
    limits : JointLimits, optional
        Limits of the same joints, drawn if the motions are near them. Accelerations have panels if
        one of their limits is reached.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.
    curves : sequence of Curve
        Curves behind the positions, such as demonstrations.
    vias : collection of float
        Times at which the first motion passes its vias [s].
    warnings : sequence of str
        Warnings above the panels.

    Returns
    -------
    panels : list of list of Axes
        By joint, the Axes of positions, velocities, accelerations if a limit is reached, and
        efforts if they are known.

    Raises
    ------
    PlannerError
        If the motions have one point each.
    """
    first = next(iter(motions.values()))
    names = first.joint_names
    duration = max(motion.duration for motion in motions.values())
    if duration == 0.0:
        raise PlannerError("a motion of one point can't be drawn: at least two are needed")
    quantities = [q for q in QUANTITIES if _is_shown(q, motions.values(), limits)]
    n = len(COLOURS)
    entries = [line(x, COLOURS[i % n], STYLES[i % len(STYLES)]) for i, x in enumerate(motions)]
    panels, drawn_limits = joint_panels(figure, names, len(quantities)), 0
    for name, column in zip(names, panels, strict=True):
        for axes, quantity in zip(column, quantities, strict=True):
            factor, label = _scale(quantity, [name], prismatic)
            for entry, motion in zip(entries, motions.values(), strict=True):
                values = getattr(motion, quantity)
                if values is not None:
                    joint = motion.joint_names.index(name)
                    axes.plot(motion.times, factor * values[:, joint], **entry)
            axes.set(xlabel="time [s]", ylabel=label)
            drawn_limits += _show_limits(axes, quantity, name, limits, prismatic)
            axes.set_xlim(0.0, duration)
            if not prismatic:
                label_left(axes)
        factor, _ = _scale("positions", [name], prismatic)
        _show_behind(column[0], curves, factor, names.index(name))
        for via in vias:
            passed = np.interp(via, first.times, first.positions[:, names.index(name)])
            column[0].plot(via, factor * passed, **LINES["via"] | {"label": None})
        for axes in column[:-1]:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    beside = [*(["limit"] if drawn_limits else []), *dict.fromkeys(curve[0] for curve in curves)]
    beside += ["via"] if vias else []
    header = [*entries, *(LINES[kind] for kind in beside)]
    add_header(figure, title, [*header, *(LINES["warning"] | {"label": x} for x in warnings)])
    return panels


def _is_shown(quantity: str, motions: Iterable[Trajectory], limits: JointLimits | None) -> bool:
    """Whether a quantity is known; of accelerations, whether a motion reaches their limits."""
    if quantity != "accelerations":
        return any(getattr(motion, quantity) is not None for motion in motions)
    if limits is None:
        return False
    largest = max(np.max(np.abs(m.accelerations) / limits.acceleration) for m in motions)
    return bool(largest > REACHED_LIMIT)


def _show_behind(axes: Axes, curves: Sequence[Curve], factor: float, joint: int) -> None:
    """Draw curves behind the positions of a joint, in an extended range of values."""
    low, high = axes.get_ylim()
    for kind, times, positions in curves:
        values = factor * positions[:, joint]
        axes.plot(times, values, **LINES[kind] | {"label": None})
        margin = 0.05 * (high - low)
        low, high = min(low, values.min() - margin), max(high, values.max() + margin)
    axes.set_ylim(low, high)


def _scale(quantity: str, names: Sequence[str], prismatic: Collection[str]) -> tuple[float, str]:
    """Factor from SI units, and label of the axis."""
    unit = unit_of(names, prismatic)
    return {
        "positions": (unit.factor, f"position [{unit.name}]"),
        "velocities": (unit.factor, f"velocity [{unit.speed}]"),
        "accelerations": (unit.factor, f"acceleration [{unit.speed}²]"),
        "efforts": (1.0, unit.torque),  # the effort is a cost of the motion
    }[quantity]


def _show_limits(
    axes: Axes,
    quantity: str,
    name: str,
    limits: JointLimits | None,
    prismatic: Collection[str],
) -> int:
    """Set the range of values, and draw the limits of a joint that are near.

    Returns the number of limits drawn.
    """
    factor, _ = _scale(quantity, [name], prismatic)
    low, high = axes.dataLim.intervaly
    least = MIN_EFFORT_SPAN if quantity == "efforts" else MIN_SPAN
    span = max(high - low, factor * least)
    low, high = (low + high - span) / 2, (low + high + span) / 2
    reach = low - NEAR_LIMIT * span, high + NEAR_LIMIT * span
    bounds = factor * _bounds(limits, quantity, name)
    near = [bound for bound in bounds if reach[0] < bound < reach[1]]
    for bound in near:
        axes.axhline(bound, **LINES["limit"])
    axes.set_ylim(min([low, *near]) - 0.08 * span, max([high, *near]) + 0.08 * span)
    return len(near)


def _bounds(limits: JointLimits | None, quantity: str, name: str) -> FloatArray:
    """Lower and upper limit of a joint; none without limits."""
    if limits is None:
        return np.array([])
    joint = limits.joint_names.index(name)
    if quantity == "positions":
        return np.array([limits.lower[joint], limits.upper[joint]])
    magnitudes = {
        "velocities": limits.velocity,
        "accelerations": limits.acceleration,
        "efforts": limits.effort,
    }
    magnitude = float(magnitudes[quantity][joint])
    return np.array([-magnitude, magnitude])


def plan_figure(figure: Figure, plan: Plan, planner: Planner | None = None) -> list[list[Axes]]:
    """Plot a plan, with a column of panels per joint.

    The limits that the motion is near are drawn. Behind each segment are the demonstrations whose
    ends are nearest to its own, re-timed to its duration; for a single goal also the predicted
    motion and the minimum-jerk motion.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    plan : Plan
        The plan.
    planner : Planner, optional
        The planner, for limits and demonstrations; none of these are drawn without it.

    Returns
    -------
    panels : list of list of Axes
        By joint, the Axes of positions, velocities, accelerations if a limit of them is reached,
        and efforts if they are known.
    """
    curves: list[Curve] = []
    begin, joints = 0.0, plan.trajectory.joint_names
    for motion, name in zip(plan.motions, plan.primitives, strict=True):
        if planner is None:
            break
        primitive = planner.primitives.named(name)
        states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
        ends = np.array([[state[joint] for joint in joints] for state in states])
        curves += nearest_curves(primitive, joints, ends, begin, motion.duration)
        if not plan.mode:  # segments have no prediction of their own
            times, straight = motion.duration * PHASES, quintics(PHASES, motion.boundary, 0)[0]
            curves.append(("predicted", times, _predicted(planner.robot, primitive, motion)))
            curves.append(("minimum jerk", times, straight))
        begin += motion.duration
    n, score = len(plan.motions), plan.in_span_score
    drawn = f"{n} {'segment' if n == 1 else 'segments'}" if plan.mode else f"'{plan.primitive}'"
    unlike = f"unlike the demonstrations (in-span score {score:.1f}, usual: about 1)"
    return motion_figure(
        figure,
        {"planned": plan.trajectory},
        f"{drawn}: {plan.message}",
        None if planner is None else planner.limits,
        () if planner is None else planner.robot.prismatic_joints,
        curves,
        [plan.duration * phase for phase in plan.via_phases],
        [unlike] if score > UNUSUAL_IN_SPAN_SCORE else [],
    )


def _predicted(robot: Robot, primitive: MovementPrimitive, motion: Motion) -> FloatArray:
    """Positions that the primitive predicts for a motion, shape (n_phases, n_joints)."""
    start, goal = motion.start.positions, motion.goal.positions
    turns = np.round((primitive.model.mean[: primitive.n_joints] - start) / (2.0 * np.pi))
    shift = np.where(robot.continuous, 2.0 * np.pi * turns, 0.0)
    expected = primitive.model.predict(start + shift, goal + shift, motion.duration)
    basis = primitive.paced_basis(start, goal, expected.pace)
    predicted = replace(motion, basis=basis, weights=expected.weights)
    return np.asarray(predicted.evaluate(motion.duration * PHASES)[0])


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
        ("behind", times, primitive.reproduction(int(i), primitive.durations[i] * PHASES)[:, order])
        for i in primitive.nearest_demonstrations(own_ends)[:MAX_BEHIND]
    ]


def plot_plan(plan: Plan, planner: Planner | None = None) -> NDArray[np.object_]:
    """Plot a plan in a new pyplot figure, see :func:`plan_figure`; returns its Axes."""
    with styled_figure(interactive=True) as figure:
        return np.array(plan_figure(figure, plan, planner))


def plot_trajectory(trajectory: Trajectory) -> NDArray[np.object_]:
    """Plot a trajectory in a new pyplot figure; returns its Axes, one row for each joint."""
    with styled_figure(interactive=True) as figure:
        return np.array(motion_figure(figure, {"motion": trajectory}, ""))
