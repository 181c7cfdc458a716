# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS, arm_demonstrations, arm_primitive, arm_robot
from support.chain import (
    ACROSS_BASE,
    CHAIN,
    LENGTH,
    NAMES,
    RADIUS,
    chain,
    chain_planner,
    fold,
    motion,
)
from support.patience import PATIENT

import mp_pca_planner as mp
from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import Collision, CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.plan import INFEASIBLE, SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.model import Robot

WATCHED = [("base", "b"), ("base", "c"), ("a", "c")]


def worst(model: CollisionModel, trajectory: Trajectory) -> Collision | None:
    return next(iter(model.collisions(trajectory)), None)


@pytest.fixture(scope="module")
def model() -> CollisionModel:
    return CollisionModel(chain())


# The model


def test_spheres_meet_where_geometry_says(model):
    # The third joint alone folds the ends of `a` and `c` onto each other.
    three = np.linspace(0.0, 3.0, 100_001)
    apart = LENGTH * np.sqrt(2.0 * (1.0 + np.cos(three))) - 2.0 * RADIUS
    meeting = three[np.flatnonzero(apart <= 0.0)[0]]
    way = motion([0.0, 0.9, 0.0], [0.0, 0.9, 3.0])
    found = worst(model, way)
    assert found is not None and found.links == ("a", "c")
    dense = interpolate(way)
    first = dense.times[np.flatnonzero(dense.q[:, 2] >= meeting)[0]]
    assert found.first_time == pytest.approx(first, abs=1.1e-3)
    assert found.time == found.last_time == 1.0
    assert found.penetration == pytest.approx(-apart[-1], abs=1e-5)
    assert worst(model, motion([0.0, 0.9, 0.0], [0.0, 0.9, meeting - 0.01])) is None


def test_bodies_that_meet_between_two_milliseconds_are_found():
    sweep = motion([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.6)
    dense = interpolate(sweep)
    k = len(dense.times) // 2
    angle, tip = dense.q[k : k + 2, 0].mean(), 3 * LENGTH + RADIUS

    def found(gap: float) -> bool:
        at = (tip + 1e-3 + gap) * np.array([np.cos(angle), np.sin(angle), 0.0])
        world = mp.World([mp.Obstacle("speck", mp.Sphere(1e-3, at))])
        with_speck = CollisionModel(chain(), world=world)
        assert not any(map(with_speck.collides, dense.q))
        return bool(with_speck.collisions(sweep))

    assert found(-1e-5)
    assert not found(2e-3)


def test_looking_again_only_when_due_finds_what_looking_always_finds(model):
    rng = np.random.default_rng(4)
    distances = always_looking()
    outcomes = []
    for _ in range(12):
        ends = rng.uniform([-1.0, 1.5, 1.5], 3.0, (2, 3))
        way = motion(*ends, rng.uniform(0.2, 0.6))
        found = worst(model, way)
        dense = interpolate(way)
        clearance = np.array([distances(q) for q in dense.q])
        outcomes.append(found is not None)
        assert (found is not None) == (clearance.min() < 1e-6)
        if found is not None:
            assert found.penetration == pytest.approx(-clearance.min(), abs=1e-5)
            pair = clearance[:, WATCHED.index(found.links)]
            assert pair.min() == pytest.approx(clearance.min(), abs=1e-5)
            touching = dense.times[pair < 1e-6]
            assert found.first_time == pytest.approx(touching[0], abs=1e-9)
            assert found.last_time == pytest.approx(touching[-1], abs=1e-9)
    assert 2 < sum(outcomes) < 10


def always_looking() -> Callable[[np.ndarray], list[float]]:
    """Distances of the watched pairs by Pinocchio on a model of its own."""
    model = pin.buildModelFromXML(CHAIN)
    geometry = pin.buildGeomFromUrdfString(model, CHAIN, pin.GeometryType.COLLISION)
    for links in WATCHED:
        first, second = (["base", "a", "b", "c"].index(name) for name in links)
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    model_data, data = model.createData(), geometry.createData()

    def distances(q: np.ndarray) -> list[float]:
        pin.updateGeometryPlacements(model, model_data, geometry, data, q)
        return [pin.computeDistance(geometry, data, k).min_distance for k in range(len(WATCHED))]

    return distances


def test_joints_may_be_in_any_order_and_others_locked():
    other = CollisionModel(Robot(CHAIN, ("three", "one"), locked={"two": 0.9}))
    s = motion([0.0, 0.9, 0.0], [0.0, 0.9, 3.0])
    swapped = [x[:, [2, 0]] for x in (s.positions, s.velocities, s.accelerations)]
    found = worst(other, Trajectory(("three", "one"), s.times, *swapped))
    assert found is not None and found.links == ("a", "c")


def test_sliding_joints_reach_as_far_as_they_slide():
    slide = chain(**{'<joint name="two" type="revolute">': '<joint name="two" type="prismatic">'})
    model = CollisionModel(slide)
    # Along z: away from the base and back into the way of its box.
    found = worst(model, motion([0.0, 0.4, 3.0], [0.0, 0.0, 3.0]))
    assert found is not None and "c" in found.links


def two_cubes(path: Path) -> None:
    """A mesh of cubes of 0.1 m whose centres are 0.3 m before and behind the origin."""
    corners = 0.05 * np.array([[(i >> k & 1) * 2 - 1 for k in range(3)] for i in range(8)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = ["solid x"]
    for centre in (-0.3, 0.3):
        for a, b, c, d in sides:
            for triangle in ((a, b, c), (a, c, d)):
                lines += ["facet normal 0 0 0", "outer loop"]
                lines += [f"vertex {x + centre} {y} {z}" for x, y, z in corners[list(triangle)]]
                lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid x"]), encoding="utf-8")


def test_links_may_be_where_only_the_convex_hull_of_a_mesh_is(tmp_path):
    two_cubes(tmp_path / "x.stl")
    mesh = f'<mesh filename="file://{tmp_path}/x.stl"/>'
    model = CollisionModel(chain(**{'<box size="0.1 0.1 0.1"/>': mesh}))
    pair = model.pairs.index(("base", "c"))

    # An equilateral triangle: the last sphere is between the cubes.
    folded = np.array([0.0, 2.0 * np.pi / 3.0, 2.0 * np.pi / 3.0])
    assert model.near(folded[None], np.inf).distances[pair] == pytest.approx(
        0.25 - RADIUS, abs=1e-6
    )
    assert worst(model, motion([0.0, 2.0, 2.1], folded)) is None
    # Here it is at x = 0.22, half in a cube, and whole in the hull of both.
    into = np.array([0.0, 1.79773936, 2.68770658])
    assert model.near(into[None], np.inf).distances[pair] < -0.05 + 1e-6
    found = worst(model, motion(folded, into))
    assert found is not None and found.links == ("base", "c")


# The planner


def test_motion_of_least_effort_goes_around_the_body():
    robot = arm_robot()
    limits, primitive = robot.limits(), arm_primitive()
    model, options = CollisionModel(robot), replace(PATIENT, naturalness=0.0)
    n_through = 0
    for shown in arm_demonstrations(12, 7):
        start, goal = (JointState(JOINTS, shown.positions[end]) for end in (0, -1))
        request = JointGoal(goal, shown.duration), start
        bare = Planner(robot, [primitive], limits, options, collision=False).plan(*request)
        plan = Planner(robot, [primitive], limits, options, model).plan(*request)
        assert plan.status == SOLVED
        assert (
            plan.facts["start_error"] == 0.0
            and plan.goal_error == 0.0
            and not plan.limit_check.touched
        )
        through = deepest_in_chest(bare.trajectory) < -0.01
        n_through += through
        assert deepest_in_chest(plan.trajectory) > 0.0
        assert ("kept apart" in plan.message) == bool(model.collisions(bare.trajectory))
        # Not the cheapest motion any more, but not a dear one.
        assert bare.solution.effort_cost * (1.0 - 1e-4) <= plan.solution.effort_cost
        assert plan.solution.effort_cost < 1.4 * bare.solution.effort_cost
    assert n_through >= 2


def deepest_in_chest(trajectory: Trajectory) -> float:
    """Least distance of the lower arm from the trunk, on a model of its own."""
    urdf = str(config_file("human_arm.urdf"))
    model = pin.buildModelFromUrdf(urdf)
    geometry = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION)
    for i, first in enumerate(geometry.geometryObjects):
        for j, second in enumerate(geometry.geometryObjects):
            if first.name.startswith("chest") and second.name.startswith("lower_arm"):
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    model_data, data = model.createData(), geometry.createData()
    order = [trajectory.joint_names.index(name) for name in list(model.names)[1:]]
    least = np.inf
    for q in interpolate(trajectory).q[:, order]:
        pin.computeDistances(model, model_data, geometry, data, q)
        least = min(least, *(result.min_distance for result in data.distanceResults))
    return float(least)


@pytest.mark.parametrize("naturalness", [0.0, 1.0])
def test_what_components_cannot_avoid_splines_do(model, naturalness):
    start, goal = ACROSS_BASE
    through = chain_planner(None, naturalness=naturalness).plan(JointGoal(goal, 1.5), start)
    assert {one.links for one in model.collisions(through.trajectory)} == {("base", "c")}
    plan = chain_planner(model, naturalness=naturalness).plan(JointGoal(goal, 1.5), start)
    assert plan.is_executable
    assert plan.facts["correction"] > 0.0 or plan.solution.weights.size > 1
    look = always_looking()
    assert min(min(look(q)) for q in interpolate(plan.trajectory).q) > 0.0


def test_configuration_for_a_pose_is_one_without_collision():
    # The robot reaches a point before its base with the second link over it only from one side.
    robot = chain()
    planner = chain_planner(CollisionModel(robot))
    start = JointState(NAMES, [0.0, 1.5, 1.6])
    point = robot.frame_positions(np.array([[0.3, 1.9, 2.3]]), ["c"])[0, 0]
    plan = planner.plan(PoseGoal(Pose("c", point)), start)
    assert plan.is_executable
    look = always_looking()
    assert min(min(look(q)) for q in interpolate(plan.trajectory).q) > 0.0


def test_collision_at_an_end_is_infeasible_at_once_and_says_where(model):
    free = JointState(NAMES, [0.0, 0.9, 0.0])
    folded = JointState(NAMES, [0.0, 0.9, 3.0])
    for start, goal in ((free, folded), (folded, free)):
        plan = chain_planner(model).plan(JointGoal(goal, 1.0), start)
        assert plan.status == INFEASIBLE and not plan.is_executable
        name = "start" if start is folded else "goal"
        assert plan.message.startswith(f"the {name} is in collision: 'a' and 'c' collide by")
        assert "SRDF" in plan.message
        assert "another duration" not in plan.message


def test_robot_without_collision_geometry_is_said_so():
    robot = Robot(CHAIN.replace("collision>", "visual>"), NAMES)
    model = CollisionModel(robot)
    assert not model.has_geometry and model.pairs == ()
    start, goal = ACROSS_BASE
    planner = chain_planner(model)
    assert planner.plan(JointGoal(goal, 1.5), start).status == SOLVED
    assert "no collision geometry" in planner.remarks[0]


# Learning


# The command


@pytest.fixture
def files(tmp_path) -> list[str]:
    save_primitive(fold(), tmp_path / "fold.npz")
    (tmp_path / "chain.urdf").write_text(CHAIN, encoding="utf-8")
    return [str(tmp_path / "fold.npz"), "--robot", str(tmp_path / "chain.urdf")]


def test_plan_refuses_a_motion_that_ends_in_itself(files, capsys):
    ends = ["--start", "0,0.9,0", "--goal", "0,0.9,3.0", "--duration", "1", "--json"]
    assert main(["plan", *files, *ends, "--no-collision"]) == 0
    capsys.readouterr()
    assert main(["plan", *files, *ends]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["status"] == "infeasible"
    assert "'a' and 'c' collide" in facts["message"]
