# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of motions and plans: a row for each joint, and the path of the hand beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
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
from ..robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from .style import (
    COLOURS,
    LINES,
    MAX_BEHIND,
    MAX_NAMED,
    MIN_SPAN,
    NEAR_LIMIT,
    ROOM,
    Line,
    add_header,
    styled_figure,
)
from .text import Unit, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..planning.planner import Planner
    from ..robot.model import Robot

Curve = tuple[FloatArray, FloatArray]
"""Times [s] and positions [rad or m], of shapes (n_times,) and (n_times, n_joints)."""


def motion_figure(
    figure: Figure,
    motion: Trajectory,
    title: str,
    limits: JointLimits | None = None,
    *,
    prismatic: Collection[str] = (),
    behind: Sequence[Curve] = (),
    vias: Collection[float] = (),
    robot: Robot | None = None,
    world: Iterable[Obstacle] = (),
) -> list[Axes]:
    """Plot a motion: a row of positions for each joint, and the path of the hand beside them.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    motion : Trajectory
        The motion.
    title : str
        Title of the figure.
    limits : JointLimits, optional
        Limits of its joints. Those of the position are lines where the motion comes near them, and
        the ends of a bar beside the row, with what the motion uses of the range. Of the others, the
        one of which the motion uses most is stated.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.
    behind : sequence of Curve
        Curves behind the positions, such as demonstrations.
    vias : collection of float
        Times at which the motion passes its vias [s].
    robot : Robot, optional
        The robot of the joints. The path of its hand is drawn from above, and from the side or the
        front, with its joints at both ends.
    world : iterable of Obstacle
        The obstacles. Those nearest to the path have their own colours and names; those attached to
        links are not drawn.

    Returns
    -------
    rows : list of Axes
        Those of each joint.

    Raises
    ------
    PlannerError
        If the motion has one point.
    """
    if motion.duration == 0.0:
        raise PlannerError("a motion of one point can't be drawn: at least two are needed")
    rows, views = _panels(figure, motion.n_joints, robot is not None)
    obstacles = list[Line]()
    for joint, (name, axes) in enumerate(zip(motion.joint_names, rows, strict=True)):
        unit, q = unit_of([name], prismatic), motion.positions[:, joint]
        for times, positions in behind:
            axes.plot(times, unit.factor * positions[:, joint], **LINES["behind"])
        axes.plot(motion.times, unit.factor * q, **LINES["planned"])
        for via in vias:
            axes.plot(via, unit.factor * np.interp(via, motion.times, q), **LINES["via"])
        axes.set_title(printable(name), loc="left", fontsize="medium")
        axes.set(ylabel=unit.name, xlim=(0.0, motion.duration))
        _show_limits(axes, motion, joint, limits, unit)
    rows[-1].set_xlabel("time [s]")
    if robot is not None:
        paths = [
            np.asarray(robot.frame_positions(q, [robot.end_effector])[:, 0])
            for q in (motion.positions, *(positions for _, positions in behind))
        ]
        near = sorted((x for x in world if not x.frame), key=lambda x: _distance(x, paths[0]))
        lines = [_obstacle_line(x, i) for i, x in enumerate(near)]
        _show_hand(views, robot, motion, paths, list(zip(near, lines, strict=True)))
        obstacles = lines[: MAX_NAMED + 1]
    drawn = {artist.get_label() for axes in figure.axes for artist in axes.get_children()}
    add_header(figure, title, [*(x for x in LINES.values() if x["label"] in drawn), *obstacles])
    return rows


def _panels(figure: Figure, n_joints: int, has_hand: bool) -> tuple[list[Axes], list[Axes]]:
    """A row for each joint, and beside them two views of the hand; sets the size of the figure."""
    figure.set_size_inches(12.0 if has_hand else 8.0, max(1.25 * n_joints, 5.0) + 0.4)
    parts = figure.subfigures(1, 1 + has_hand, width_ratios=[3, 2][: 1 + has_hand], squeeze=False)
    rows = parts[0, 0].subplots(n_joints, 1, sharex=True, squeeze=False)[:, 0]
    return list(rows), list(parts[0, 1].subplots(2, 1)) if has_hand else []


def _show_limits(
    axes: Axes, motion: Trajectory, joint: int, limits: JointLimits | None, unit: Unit
) -> None:
    """Set the range of positions, show its limits, state of which other limit is used most."""
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
        if np.isfinite(ends).all():
            texts = [unit.text(x) for x in (limits.lower[i], limits.upper[i])]
            _show_range(axes, unit.factor * motion.positions[:, joint], ends, texts)
        text = _most_used(motion, joint, limits, i, unit)
        axes.set_title(text, loc="right", fontsize="small", fontweight="normal")
    axes.set_ylim(min([low, *near]) - 0.08 * span, max([high, *near]) + 0.08 * span)


def _show_range(axes: Axes, q: FloatArray, ends: FloatArray, texts: Sequence[str]) -> None:
    """Draw the range of a joint beside its row, and the part of it that a motion uses."""
    bar = axes.inset_axes((1.015, 0.0, 0.02, 1.0))
    bar.axhspan(q.min(), q.max(), color=COLOURS[0])
    bar.set(xticks=[], yticks=ends, yticklabels=texts, ylim=ends)
    bar.set_title("range", loc="left", fontsize=9, fontweight="normal")
    bar.yaxis.tick_right()
    bar.tick_params(labelsize=9, length=0)
    for side in ("bottom", "top"):
        bar.spines[side].set(linestyle=LINES["limit"]["linestyle"], linewidth=1.5)


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


def _distance(obstacle: Obstacle, path: FloatArray) -> float:
    """About how far a path, shape (n_steps, 3), is from an obstacle [m]: from a box around it."""
    corners = np.concatenate([_corners(shape) for shape in obstacle.shapes])
    outside = np.maximum(corners.min(axis=0) - path, path - corners.max(axis=0)).clip(0.0)
    return float(np.linalg.norm(outside, axis=1).min())


def _obstacle_line(obstacle: Obstacle, index: int) -> Line:
    """Colour and label of the obstacle that is the index-nearest."""
    if index >= MAX_NAMED:
        return LINES["obstacle"]
    return LINES["obstacle"] | {"label": f"'{obstacle.name}'", "color": COLOURS[1 + index]}


def _show_hand(
    views: Sequence[Axes],
    robot: Robot,
    motion: Trajectory,
    paths: Sequence[FloatArray],
    obstacles: Sequence[tuple[Obstacle, Line]],
) -> None:
    """Draw the path of the hand before others, from above, and from the side or the front."""
    path, *behind = paths
    side = int(np.argmax(np.ptp(path[:, :2], axis=0)))
    words = "above", ("the side", "the front")[side]
    arms = robot.frame_positions(motion.positions[[0, -1]], _chain(robot))
    motions = np.concatenate([*paths, *arms])
    room = ROOM * np.ptp(motions, axis=0).max()
    low, high = motions.min(axis=0) - room, motions.max(axis=0) + room
    for axes, plane, where in zip(views, ([0, 1], [side, 2]), words, strict=True):
        for obstacle, line in obstacles:
            edge = line["color"]
            for outline in outlines(obstacle, plane):
                axes.fill(*outline.T, facecolor=edge + "40", edgecolor=edge, lw=1.5, zorder=1.2)
        for arm in arms:
            axes.plot(*arm[:, plane].T, **LINES["arm"])
        for other in behind:
            axes.plot(*other[:, plane].T, **LINES["behind"])
        axes.plot(*path[:, plane].T, **LINES["planned"])
        across = np.sign(path[-1, plane[0]] - path[0, plane[0]]) or 1.0
        for place, text, away in ((path[0], "start", -across), (path[-1], "goal", across)):
            axes.plot(*place[plane], "o", color=COLOURS[0])
            axes.annotate(
                text,
                place[plane],
                xytext=(8 * away, 0),
                textcoords="offset points",
                ha="left" if away > 0 else "right",
                va="center",
            )
        axes.set_title(f"'{printable(robot.end_effector)}' from {where}", loc="left")
        axes.set(xlabel="xyz"[plane[0]] + " [m]", ylabel="xyz"[plane[1]] + " [m]")
        axes.margins(0.0)
        axes.dataLim.set_points(np.array([low[plane], high[plane]]))
        axes.set_aspect("equal", adjustable="datalim")


def _chain(robot: Robot) -> list[str]:
    """The links from the base to the hand, one for each joint, whose origins are at the joints."""
    model, _ = robot.pinocchio_model()
    links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    hand = next(link for link in links if link.name == robot.end_effector)
    chain = [
        next(link.name for link in links if link.parentJoint == joint)
        for joint in model.supports[hand.parentJoint]
    ]
    return [*chain, hand.name]


def _corners(shape: Shape) -> FloatArray:
    """Corners of the surface of a shape in its place, shape (n_points, 3) [m]."""
    placed = pin.XYZQUATToSE3(shape.pose)
    points = np.asarray(surface(shape).vertices)
    return np.asarray(points @ placed.rotation.T + placed.translation)


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
        flat = _corners(shape)[:, plane]
        # Joggled, because a flat mesh has no area from its side.
        found.append(flat[ConvexHull(flat, qhull_options="QJ").vertices])
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
    n, behind, begin = len(plan.motions), list[Curve](), 0.0
    drawn = f"{n} {'segment' if n == 1 else 'segments'}" if plan.mode else f"'{plan.primitive}'"
    title, joints = f"{drawn}: {plan.message}", plan.trajectory.joint_names
    vias = [plan.duration * phase for phase in plan.via_phases]
    if planner is None:
        return motion_figure(figure, plan.trajectory, title, vias=vias)
    for motion, name in zip(plan.motions, plan.primitives, strict=True):
        states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
        ends = np.array([[state[joint] for joint in joints] for state in states])
        primitive = planner.primitives.named(name)
        behind += nearest_curves(primitive, joints, ends, begin, motion.duration)
        begin += motion.duration
    return motion_figure(
        figure,
        plan.trajectory,
        title,
        planner.limits,
        prismatic=planner.robot.prismatic_joints,
        behind=behind,
        vias=vias,
        robot=planner.robot,
        world=() if planner.collision is None else planner.collision.world,
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
        return np.array(motion_figure(figure, trajectory, ""))
