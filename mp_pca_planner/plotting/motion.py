# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of motions and plans: a row for each joint, and the path of the hand beside them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray, by_name
from ..exceptions import PlannerError, printable
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..primitives.differences import PHASES
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, World
from .style import (
    COLOURS,
    LINES,
    MAX_BEHIND,
    MIN_SPAN,
    NEAR_LIMIT,
    STYLES,
    Line,
    add_header,
    line,
    styled_figure,
)
from .text import Unit, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..planning.planner import Planner

Curve = tuple[FloatArray, FloatArray]
"""Times [s] and positions [rad or m], of shapes (n_times,) and (n_times, n_joints)."""


@dataclass(frozen=True, eq=False)
class HandPath:
    """The way of the end effector, and what stands beside it.

    Attributes
    ----------
    frame : str
        The link.
    path : array, shape (n_steps, 3)
        Its positions in the base frame [m].
    behind : sequence of array, shape (n_phases, 3)
        Those along demonstrations [m].
    world : World
        The obstacles; those attached to links are not drawn.
    """

    frame: str
    path: FloatArray
    behind: Sequence[FloatArray]
    world: World


def motion_figure(
    figure: Figure,
    motions: Mapping[str, Trajectory],
    title: str,
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
    behind: Sequence[Curve] = (),
    vias: Collection[float] = (),
    hand: HandPath | None = None,
) -> list[Axes]:
    """Plot motions of the same joints: a row of positions for each joint, and the hand's path.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    motions : mapping of str to Trajectory
        The motions, by their labels.
    title : str
        Title of the figure.
    limits : JointLimits, optional
        Limits of the same joints. Those of the position are lines where the motion comes near them;
        the shares that the first motion uses of the others are stated.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.
    behind : sequence of Curve
        Curves behind the positions, such as demonstrations.
    vias : collection of float
        Times at which the first motion passes its vias [s].
    hand : HandPath, optional
        The path of the hand, drawn from above and from the side.

    Returns
    -------
    rows : list of Axes
        Those of each joint.

    Raises
    ------
    PlannerError
        If the motions have one point each.
    """
    first = next(iter(motions.values()))
    duration = max(motion.duration for motion in motions.values())
    if duration == 0.0:
        raise PlannerError("a motion of one point can't be drawn: at least two are needed")
    n = len(COLOURS)
    entries = [line(x, COLOURS[i % n], STYLES[i % len(STYLES)]) for i, x in enumerate(motions)]
    rows, views = _panels(figure, first.n_joints, hand is not None)
    has_limits = False
    for joint, (name, axes) in enumerate(zip(first.joint_names, rows, strict=True)):
        unit = unit_of([name], prismatic)
        for times, positions in behind:
            axes.plot(times, unit.factor * positions[:, joint], **LINES["behind"])
        for entry, motion in zip(entries, motions.values(), strict=True):
            positions = motion.positions[:, motion.joint_names.index(name)]
            axes.plot(motion.times, unit.factor * positions, **entry)
        for via in vias:
            passed = np.interp(via, first.times, first.positions[:, joint])
            axes.plot(via, unit.factor * passed, **LINES["via"])
        axes.set_title(printable(name), loc="left", fontsize="medium")
        axes.set(ylabel=unit.name, xlim=(0.0, duration))
        has_limits |= _show_limits(axes, first, joint, limits, unit)
    rows[-1].set_xlabel("time [s]")
    if hand is not None:
        _show_hand(views, hand, entries[0])
    beside = {"limit": has_limits, "behind": bool(behind), "via": bool(vias)}
    header = [*entries, *(LINES[kind] for kind, is_drawn in beside.items() if is_drawn)]
    header += [LINES["obstacle"]] if hand is not None and len(hand.world) else []
    add_header(figure, title, header)
    return rows


def _panels(figure: Figure, n_joints: int, has_hand: bool) -> tuple[list[Axes], list[Axes]]:
    """A row for each joint, and beside them two views of the hand; sets the size of the figure."""
    figure.set_size_inches(12.0 if has_hand else 8.0, max(1.25 * n_joints, 5.0) + 0.4)
    parts = figure.subfigures(1, 1 + has_hand, width_ratios=[3, 2][: 1 + has_hand], squeeze=False)
    rows = parts[0, 0].subplots(n_joints, 1, sharex=True, squeeze=False)[:, 0]
    return list(rows), list(parts[0, 1].subplots(2, 1)) if has_hand else []


def _show_limits(
    axes: Axes, motion: Trajectory, joint: int, limits: JointLimits | None, unit: Unit
) -> bool:
    """Set the range of positions, draw limits that are near, state the others and their shares.

    Returns whether a limit was drawn.
    """
    low, high = axes.dataLim.intervaly
    span = max(high - low, unit.factor * MIN_SPAN)
    low, high = (low + high - span) / 2, (low + high + span) / 2
    near = []
    if limits is not None:
        i = limits.joint_names.index(motion.joint_names[joint])
        ends = unit.factor * np.array([limits.lower[i], limits.upper[i]])
        near = [x for x in ends if low - NEAR_LIMIT * span < x < high + NEAR_LIMIT * span]
        for end in near:
            axes.axhline(end, **LINES["limit"])
        words = [_most_used(motion, joint, limits, i, unit)]
        if len(near) < 2 and np.isfinite(ends).any():
            low_text, high_text = (unit.text(x) for x in (limits.lower[i], limits.upper[i]))
            words.append(f"range {low_text} to {high_text} {unit.name}")
        text = "; ".join(filter(None, words))
        axes.set_title(text, loc="right", fontsize="small", fontweight="normal")
    axes.set_ylim(min([low, *near]) - 0.08 * span, max([high, *near]) + 0.08 * span)
    return bool(near)


def _most_used(motion: Trajectory, joint: int, limits: JointLimits, i: int, unit: Unit) -> str:
    """The limit of a joint, but its range, of which a motion uses most; empty without any."""
    values = {
        "velocity": (motion.velocities, limits.velocity),
        "acceleration": (motion.accelerations, limits.acceleration),
        unit.torque.split(" [")[0]: (motion.efforts, limits.effort),
    }
    shares = {
        name: 100.0 * float(np.abs(value[:, joint]).max()) / limit[i]
        for name, (value, limit) in values.items()
        if value is not None and np.isfinite(limit[i])
    }
    name = max(shares, key=lambda x: shares[x], default="")
    return f"{shares[name]:.0f} % of the {name} limit" if name else ""


def _show_hand(views: Sequence[Axes], hand: HandPath, planned: Line) -> None:
    """Draw the path of the hand and the obstacles from above and from the side that shows most."""
    obstacles = [obstacle for obstacle in hand.world if not obstacle.frame]
    side = int(np.argmax(np.ptp(hand.path[:, :2], axis=0)))
    for axes, plane, where in zip(views, ([0, 1], [side, 2]), ("above", "the side"), strict=True):
        for obstacle in obstacles:
            for outline in outlines(obstacle, plane):
                axes.fill(*outline.T, **LINES["obstacle"] | {"linewidth": 1.0})
            x, y = _middle(obstacle)[plane]
            axes.text(x, y, printable(obstacle.name), ha="center", va="center", size=9)
        for path in hand.behind:
            axes.plot(*path[:, plane].T, **LINES["behind"])
        axes.plot(*hand.path[:, plane].T, **planned)
        for place, text in ((hand.path[0], "start"), (hand.path[-1], "goal")):
            axes.plot(*place[plane], "o", color=COLOURS[0])
            axes.annotate(text, place[plane], xytext=(6, 6), textcoords="offset points")
        axes.set_title(f"'{printable(hand.frame)}' from {where}", loc="left", fontsize="medium")
        axes.set(xlabel="xyz"[plane[0]] + " [m]", ylabel="xyz"[plane[1]] + " [m]")
        axes.margins(0.15)
        axes.set_aspect("equal", adjustable="datalim")


def _middle(obstacle: Obstacle) -> FloatArray:
    return np.asarray(np.mean([shape.position for shape in obstacle.shapes], axis=0))


def outlines(obstacle: Obstacle, plane: Sequence[int]) -> list[FloatArray]:
    """Outlines of the convex hulls of an obstacle's shapes in a plane.

    Parameters
    ----------
    obstacle : Obstacle
        The obstacle.
    plane : sequence of int
        The two axes of the plane.

    Returns
    -------
    outlines : list of array, shape (n_points, 2)
        Corners of each outline in turn [m].
    """
    from scipy.spatial import ConvexHull

    found = []
    for shape in obstacle.shapes:
        placed = pin.XYZQUATToSE3(shape.pose)
        points = [placed.act(x) for x in np.asarray(surface(shape).vertices)]
        flat = np.array(points)[:, plane]
        found.append(flat[ConvexHull(flat).vertices])
    return found


def surface(shape: Shape) -> Any:
    """The surface of a shape in its own frame, a trimesh.Trimesh."""
    from trimesh import Trimesh, creation

    if isinstance(shape, Box):
        return creation.box(shape.size)
    if isinstance(shape, Sphere):
        return creation.icosphere(radius=shape.radius, subdivisions=3)
    if isinstance(shape, Capsule):
        return creation.capsule(shape.height, shape.radius)
    if isinstance(shape, Cylinder):
        return creation.cylinder(shape.radius, shape.height, sections=32)
    assert isinstance(shape, Mesh)
    return Trimesh(shape.vertices, shape.triangles, process=False)


def plan_figure(figure: Figure, plan: Plan, planner: Planner | None = None) -> list[Axes]:
    """Plot a plan: a row of positions for each joint, and the path of the hand with the obstacles.

    Behind each segment are the demonstrations whose ends are nearest to its own, re-timed to its
    duration.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    plan : Plan
        The plan.
    planner : Planner, optional
        The planner, for limits, demonstrations and the hand; none of these are drawn without it.

    Returns
    -------
    rows : list of Axes
        Those of each joint.
    """
    behind, hand = list[Curve](), None
    begin, joints = 0.0, plan.trajectory.joint_names
    if planner is not None:
        for motion, name in zip(plan.motions, plan.primitives, strict=True):
            primitive = planner.primitives.named(name)
            states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
            ends = np.array([[state[joint] for joint in joints] for state in states])
            behind += nearest_curves(primitive, joints, ends, begin, motion.duration)
            begin += motion.duration
        frame = planner.robot.end_effector
        paths = [
            np.asarray(planner.robot.frame_positions(q, [frame])[:, 0])
            for q in (plan.trajectory.positions, *(positions for _, positions in behind))
        ]
        world = World() if planner.collision is None else planner.collision.world
        hand = HandPath(frame, paths[0], paths[1:], world)
    n = len(plan.motions)
    drawn = f"{n} {'segment' if n == 1 else 'segments'}" if plan.mode else f"'{plan.primitive}'"
    return motion_figure(
        figure,
        {"planned": plan.trajectory},
        f"{drawn}: {plan.message}",
        None if planner is None else planner.limits,
        () if planner is None else planner.robot.prismatic_joints,
        behind,
        [plan.duration * phase for phase in plan.via_phases],
        hand,
    )


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
        for i in primitive.nearest_demonstrations(own_ends)[:MAX_BEHIND]
    ]


def plot_plan(plan: Plan, planner: Planner | None = None) -> NDArray[np.object_]:
    """Plot a plan in a new pyplot figure, see :func:`plan_figure`; returns the Axes of its rows."""
    with styled_figure(interactive=True) as figure:
        return np.array(plan_figure(figure, plan, planner))


def plot_trajectory(trajectory: Trajectory) -> NDArray[np.object_]:
    """Plot a trajectory in a new pyplot figure; returns its Axes, one row for each joint."""
    with styled_figure(interactive=True) as figure:
        return np.array(motion_figure(figure, {"motion": trajectory}, ""))
