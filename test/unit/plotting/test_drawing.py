# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The pictures: valid files, something in them, and nothing drawn from wrong input."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.arm import arm_primitive, arm_robot

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.plotting.motion import motion_figure, outlines, plan_figure
from mp_pca_planner.plotting.primitive import primitive_figure
from mp_pca_planner.plotting.style import MAX_NAMED, picture, styled_figure
from mp_pca_planner.primitives.differences import PHASES
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, World

image = pytest.importorskip("matplotlib.image", reason="matplotlib is not installed")


BLUE, ORANGE = "#0072B2", "#D55E00"


def n_pixels(path: Path, colour: str) -> int:
    """How many pixels of a picture have a colour."""
    rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    pixels = np.asarray(image.imread(path))
    return int(np.all(np.abs(pixels[:, :, :3] - rgb) < 0.02, axis=2).sum())


def trajectory(scale: float = 1.0) -> Trajectory:
    t = np.linspace(0.0, 0.8, 41)
    q = scale * np.outer(np.sin(2 * t), [1, 2])
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)
    return Trajectory(["joint0", "joint1"], t, q, v, a, 3 * a)


def test_pictures_show_components_and_motions_and_repeat_themselves(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("p.png", "again.png", "motion.png")]
    for file in files[:2]:
        with picture(file) as figure:
            primitive_figure(figure, arm_primitive(), title="A primitive")
    assert files[0].read_bytes() == files[1].read_bytes()
    with picture(files[2]) as figure:
        motion_figure(figure, trajectory(), "A motion")
    assert [n_pixels(file, BLUE) > 1000 for file in files] == [True] * 3
    assert [n_pixels(file, ORANGE) > 400 for file in files] == [True, True, False]


def test_prismatic_joints_are_drawn_in_metres() -> None:
    motion, shown = trajectory(), arm_primitive()
    with styled_figure() as figure:
        rows = motion_figure(figure, motion, "A motion", prismatic=["joint1"])
    assert [axes.get_ylabel() for axes in rows] == ["deg", "m"]
    np.testing.assert_allclose(rows[0].lines[0].get_ydata(), np.rad2deg(motion.positions[:, 0]))
    np.testing.assert_allclose(rows[1].lines[0].get_ydata(), motion.positions[:, 1])
    shown = replace(shown, metadata={**shown.metadata, "prismatic_joints": shown.joint_names[:1]})
    demonstrations = np.random.default_rng(1).normal(size=(3, PHASES.size, shown.n_joints))
    with styled_figure() as figure:
        primitive_figure(figure, shown, demonstrations)
    labels = [axes.get_ylabel() for axes in figure.axes]
    first = figure.axes[labels.index("position [m]")].lines[0]
    np.testing.assert_allclose(first.get_ydata(), demonstrations[0, :, 0])
    second = figure.axes[labels.index("position [deg]")].lines[0]
    np.testing.assert_allclose(second.get_ydata(), np.rad2deg(demonstrations[0, :, 1]))
    assert "added [m]" in labels and "added [deg]" in labels


@pytest.mark.parametrize("share", [0.99, 0.5])
def test_the_limit_that_a_joint_uses_most_is_stated(share: float) -> None:
    motion = trajectory()
    largest = {
        name: float(np.abs(getattr(motion, name)[:, 1]).max())
        for name in ("velocities", "accelerations", "efforts")
    }
    bounds = {
        "max_velocity": largest["velocities"] / 0.7,
        "max_acceleration": largest["accelerations"] / share,
        "max_effort": largest["efforts"] / 0.3,
    }
    limits = JointLimits(["joint0", "joint1"], {"joint1": bounds})
    with styled_figure() as figure:
        rows = motion_figure(figure, motion, "Motion", limits)
    name, most = ("acceleration", 99) if share > 0.7 else ("velocity", 70)
    assert [axes.get_title(loc="right") for axes in rows] == ["", f"{most} % of the {name} limit"]


TURN = Rotation.from_rotvec([0.3, -0.5, 0.9])


@pytest.mark.parametrize(
    "shape",
    [Box([0.3, 0.2, 0.5]), Sphere(0.2), Cylinder(0.1, 0.6), Capsule(0.1, 0.4)],
)
@pytest.mark.parametrize("plane", [[0, 1], [1, 2]])
def test_outlines_are_the_shadows_of_obstacles(shape: Shape, plane: list[int]) -> None:
    """The width of a shadow in every direction is that of the surface made by trimesh."""
    trimesh = pytest.importorskip("trimesh")
    solids = {
        Box: lambda x: trimesh.creation.box(x.size),
        Sphere: lambda x: trimesh.creation.icosphere(4, x.radius),
        Cylinder: lambda x: trimesh.creation.cylinder(x.radius, x.height, sections=96),
        Capsule: lambda x: trimesh.creation.capsule(x.height, x.radius, count=[64, 64]),
    }
    placed = shape.moved(np.concatenate([[1.0, 2.0, 3.0], TURN.as_quat()]))
    (outline,) = outlines(Obstacle("it", placed), plane)
    surface = TURN.apply(solids[type(shape)](shape).vertices)
    points = np.add(surface, [1.0, 2.0, 3.0])[:, plane]
    angles = np.linspace(0.0, 2.0 * np.pi, 16)
    directions = np.array([np.cos(angles), np.sin(angles)])
    widths = [(shadow @ directions).max(axis=0) for shadow in (outline, points)]
    np.testing.assert_allclose(*widths, atol=2e-3)


def test_a_flat_mesh_is_a_line_from_its_side() -> None:
    floor = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    (outline,) = outlines(Obstacle("floor", floor), [0, 2])
    np.testing.assert_allclose(np.ptp(outline, axis=0), [1.0, 0.0])


def all_legends_inside(figure: Any) -> bool:
    """Whether every legend lies in its figure, and none on another's."""
    figure.draw_without_rendering()
    found = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    boxes = [legend.get_window_extent() for legend in found if legend is not None]
    apart = all(not a.overlaps(b) for a, b in combinations(boxes, 2))
    return apart and all(
        box.x0 >= 0.0 and box.y0 >= 0.0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        for box in boxes
    )


# Figures of plans


def plan_between(
    start: int, goal: int, shares: tuple[float, ...] = (), scale: float = 1.0
) -> tuple[Plan, Planner]:
    """A plan between ends of demonstrations, stretched about their mean, and its planner."""
    robot, shown = arm_robot(), arm_primitive()
    ends = shown.boundary_states[[start, goal], [0, 3]]
    q0, q1 = ends.mean(axis=0) + scale * (ends - ends.mean(axis=0))
    wide = {n: {"max_position": 9.0, "min_position": -9.0} for n in robot.joint_names}
    planner = Planner(robot, [shown], robot.limits(wide))
    places = [JointState(robot.joint_names, q0 + x * (q1 - q0)) for x in (*shares, 1.0)]
    goal_state = places if shares else places[0]
    return planner.plan(goal_state, JointState(robot.joint_names, q0)), planner


def test_plan_shows_its_vias_where_it_passes_them() -> None:
    found, planner = plan_between(0, 0, shares=(0.4,))
    with styled_figure() as figure:
        panels = plan_figure(figure, found, planner)
        assert all_legends_inside(figure)
    motion = found.trajectory
    for joint, above in enumerate(panels):
        (via,) = (x for x in above.lines if x.get_marker() == "D")
        passed = found.via_phases[0] * motion.duration
        expected = np.interp(passed, motion.times, motion.positions[:, joint])
        np.testing.assert_allclose(via.get_xdata(), passed)
        np.testing.assert_allclose(via.get_ydata(), np.rad2deg(expected))
    shown = [x.get_text() for x in figure.legends[0].get_texts()]
    expected = "planned", "nearest demonstrations, re-timed", "arm at start and goal", "via"
    assert shown == list(expected)


def test_plan_shows_the_path_of_the_hand_and_the_obstacles_beside_it() -> None:
    """Each obstacle has an edge, and the nearest ones colours and names of their own."""
    found, planner = plan_between(3, 3)
    hand = arm_robot().frame_positions(found.trajectory.positions, [arm_robot().end_effector])[:, 0]
    places = {f"ball {i}": hand[-1] + [0.3 + 0.2 * i, 0.0, 0.0] for i in range(MAX_NAMED + 2)}
    world = World([Obstacle(name, Sphere(0.1, x)) for name, x in reversed(places.items())])
    planner = Planner(planner.robot, planner.primitives, planner.limits, world=world)
    with styled_figure() as figure:
        rows = plan_figure(figure, found, planner)
        assert all_legends_inside(figure)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names[-MAX_NAMED - 1 :] == [
        *(f"'ball {i}'" for i in range(MAX_NAMED)),
        "other obstacles",
    ]
    assert len(figure.axes) == len(rows) + 2
    side = int(np.argmax(np.ptp(hand[:, :2], axis=0)))
    for axes, plane in zip(figure.axes[len(rows) :], ([0, 1], [side, 2]), strict=True):
        (path,) = (x for x in axes.lines if x.get_label() == "planned")
        np.testing.assert_allclose(path.get_xydata(), hand[:, plane])
        middles = [0.5 * (x.get_xy().min(axis=0) + x.get_xy().max(axis=0)) for x in axes.patches]
        np.testing.assert_allclose(middles, [x[plane] for x in places.values()], atol=1e-9)
        edges = [patch.get_edgecolor() for patch in axes.patches]
        assert len(set(edges)) == MAX_NAMED + 1
        assert all(
            patch.get_facecolor()[3] < edge[3]
            for patch, edge in zip(axes.patches, edges, strict=True)
        )


def test_a_floor_does_not_make_the_path_small() -> None:
    found, planner = plan_between(3, 3)
    floor = Obstacle("floor", Box([50.0, 50.0, 0.1], [0.0, 0.0, -3.0]))
    widths = []
    for world in (World(), World([floor])):
        shown = Planner(planner.robot, planner.primitives, planner.limits, world=world)
        with styled_figure() as figure:
            rows = plan_figure(figure, found, shown)
            figure.draw_without_rendering()
        widths.append([np.ptp(axes.get_xlim()) for axes in figure.axes[len(rows) :]])
    np.testing.assert_allclose(*widths, rtol=0.1)


def test_each_row_shows_its_limits_and_what_is_used_of_them() -> None:
    motion = trajectory()
    ranges = {"joint0": {"min_position": -9.0, "max_position": 5.0}}
    limits = JointLimits(["joint0", "joint1"], ranges)
    with styled_figure() as figure:
        rows = motion_figure(figure, motion, "Motion", limits)
    (bar,) = rows[0].child_axes
    np.testing.assert_allclose(bar.get_ylim(), np.rad2deg([-9.0, 5.0]))
    (used,) = bar.patches
    ends = [used.get_window_extent().y0, used.get_window_extent().y1]
    q = np.rad2deg(motion.positions[:, 0])
    np.testing.assert_allclose(
        bar.transData.inverted().transform([[0.0, y] for y in ends])[:, 1], [q.min(), q.max()]
    )
    assert [x.get_text() for x in bar.get_yticklabels()] == ["-516", "286"]
    assert not rows[1].child_axes


def test_a_prediction_without_a_robot_is_drawn_as_it_is() -> None:
    from matplotlib import pyplot

    primitive = arm_primitive()
    motion = primitive.predict(*primitive.boundary_states[0, [0, 3]])
    panels = motion.plot()
    assert panels.shape == (primitive.n_joints,)
    for axes, q in zip(panels, motion.positions.T, strict=True):
        (drawn,) = [one for one in axes.lines if len(one.get_ydata()) == motion.n_steps]
        np.testing.assert_allclose(drawn.get_ydata(), np.rad2deg(q), atol=1e-9)
    assert pyplot.gcf() is panels[0].figure.figure
    pyplot.close(pyplot.gcf())
