# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm import JOINTS, arm_demonstrations, arm_primitive, arm_robot

from mp_pca_planner.cli.plan import main
from mp_pca_planner.cli.sequence import main as sequence
from mp_pca_planner.exceptions import RobotError
from mp_pca_planner.goal import JointGoal, JointState, SequenceGoal
from mp_pca_planner.planning.collision import (
    Collision,
    CollisionFreePlanner,
    CollisionFreeSequencePlanner,
    CollisionModel,
    package_folders,
)
from mp_pca_planner.planning.planner import INFEASIBLE, SOLVED, Planner, PlannerOptions
from mp_pca_planner.planning.sequence import OPTIMAL, REAL_TIME, SequencePlanner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot import Robot
from mp_pca_planner.trajectory import Trajectory
from mp_pca_planner.validation import interpolate

NAMES = ("one", "two", "three")
WATCHED = [("base", "b"), ("base", "c"), ("a", "c")]
RADIUS, LENGTH = 0.04, 0.4


def link(name: str, geometry: str = f'<sphere radius="{RADIUS}"/>') -> str:
    return f"""
  <link name="{name}">
    <inertial><origin xyz="{LENGTH / 2} 0 0"/><mass value="1"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <collision><origin xyz="{LENGTH} 0 0"/><geometry>{geometry}</geometry></collision>
  </link>"""


def joint(name: str, parent: str, child: str, x: float) -> str:
    return f"""
  <joint name="{name}" type="revolute">
    <origin xyz="{x} 0 0"/><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" velocity="20" effort="1000"/>
  </joint>"""


# Three links in a plane, with a sphere at the end of each and one at the base.
CHAIN = (
    '<robot name="chain"><link name="base"><collision><geometry><box size="0.1 0.1 0.1"/>'
    "</geometry></collision></link>"
    + link("a")
    + link("b", '<cylinder radius="0.04" length="0.05"/>')
    + link("c")
    + joint("one", "base", "a", 0.0)
    + joint("two", "a", "b", LENGTH)
    + joint("three", "b", "c", LENGTH)
    + "</robot>"
)


def chain(**changes: str) -> Robot:
    text = CHAIN
    for old, new in changes.items():
        text = text.replace(old, new)
    return Robot(text, NAMES)


def motion(start: np.ndarray, goal: np.ndarray, duration: float = 1.0) -> Trajectory:
    s = np.linspace(0.0, 1.0, 21)[:, None]
    way = np.subtract(goal, start)
    return Trajectory(
        NAMES,
        s[:, 0] * duration,
        start + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
    )


@pytest.fixture(scope="module")
def model() -> CollisionModel:
    return CollisionModel(chain())


# The model


def test_neighbours_are_not_watched_and_all_others_are(model):
    assert set(model.pairs) == set(WATCHED)


def test_what_touches_at_neutral_is_not_watched():
    wide = chain(**{'<box size="0.1 0.1 0.1"/>': '<box size="1.55 0.1 0.1"/>'})
    assert set(CollisionModel(wide).pairs) == {("base", "c"), ("a", "c")}


def test_srdf_says_which_pairs_need_no_look(tmp_path):
    srdf = tmp_path / "chain.srdf"
    srdf.write_text(
        '<robot name="chain"><disable_collisions link1="base" link2="a" reason="Adjacent"/>'
        '<disable_collisions link1="c" link2="a" reason="Never"/></robot>',
        encoding="utf-8",
    )
    pairs = CollisionModel(chain(), srdf=srdf).pairs
    assert set(pairs) == {("a", "b"), ("b", "c"), ("base", "b"), ("base", "c")}


def test_spheres_meet_where_geometry_says(model):
    # The third joint alone folds the ends of `a` and `c` onto each other.
    three = np.linspace(0.0, 3.0, 100_001)
    apart = LENGTH * np.sqrt(2.0 * (1.0 + np.cos(three))) - 2.0 * RADIUS
    meeting = three[np.flatnonzero(apart <= 0.0)[0]]
    way = motion([0.0, 0.9, 0.0], [0.0, 0.9, 3.0])
    found = model.worst_collision(way)
    assert found is not None and found.links == ("a", "c")
    dense = interpolate(way)
    first = dense.times[np.flatnonzero(dense.q[:, 2] >= meeting)[0]]
    assert found.first_time == pytest.approx(first, abs=1.1e-3)
    assert found.time == found.last_time == 1.0
    assert found.penetration == pytest.approx(-apart[-1], abs=1e-5)
    assert model.worst_collision(motion([0.0, 0.9, 0.0], [0.0, 0.9, meeting - 0.01])) is None


def test_looking_again_only_when_due_finds_what_looking_always_finds(model):
    rng = np.random.default_rng(4)
    distances = always_looking()
    outcomes = []
    for _ in range(12):
        ends = rng.uniform([-1.0, 1.5, 1.5], 3.0, (2, 3))
        way = motion(*ends, rng.uniform(0.2, 0.6))
        found = model.worst_collision(way)
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
    found = other.worst_collision(Trajectory(("three", "one"), s.times, *swapped))
    assert found is not None and found.links == ("a", "c")


def test_sliding_joints_reach_as_far_as_they_slide():
    slide = chain(**{'<joint name="two" type="revolute">': '<joint name="two" type="prismatic">'})
    model = CollisionModel(slide)
    # Along z: away from the base and back into the way of its box.
    found = model.worst_collision(motion([0.0, 0.4, 3.0], [0.0, 0.0, 3.0]))
    assert found is not None and "c" in found.links


def test_missing_mesh_is_refused_with_where_it_was_looked_for(tmp_path):
    mesh = chain(**{'<box size="0.1 0.1 0.1"/>': '<mesh filename="package://nobody/x.stl"/>'})
    with pytest.raises(RobotError, match=r"nobody/x\.stl.*looked for in '.*here'"):
        CollisionModel(mesh, package_dirs=[tmp_path / "here"])


def test_mesh_of_a_package_is_found(tmp_path):
    (tmp_path / "somebody").mkdir()
    triangle = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    stl = tmp_path / "somebody/x.stl"
    stl.write_text(f"solid x\n{triangle}endloop\nendfacet\nendsolid x\n", encoding="utf-8")
    mesh = chain(**{'<box size="0.1 0.1 0.1"/>': '<mesh filename="package://somebody/x.stl"/>'})
    assert CollisionModel(mesh, package_dirs=[tmp_path]).has_geometry


def test_unreadable_srdf_is_refused(tmp_path):
    with pytest.raises(RobotError, match="SRDF file"):
        CollisionModel(chain(), srdf=tmp_path / "none.srdf")
    (tmp_path / "bad.srdf").write_text("<robot", encoding="utf-8")
    with pytest.raises(RobotError, match="SRDF file"):
        CollisionModel(chain(), srdf=tmp_path / "bad.srdf")


def test_packages_are_looked_for_where_ros_and_the_urdf_are(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_PACKAGE_PATH", "/one:/two")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros")
    folders = package_folders(tmp_path / "robot.urdf", [Path("/given")])
    known = [Path("/given"), Path("/one"), Path("/two"), Path("/opt/ros/share")]
    assert folders[:5] == [*known, tmp_path.resolve()]


# The planner


class Scripted:
    """Stands for a collision model that finds these collisions, one motion after the other."""

    has_geometry = True

    def __init__(self, *found: Collision | None) -> None:
        self._found = iter(found)

    def worst_collision(self, trajectory: Trajectory) -> Collision | None:
        return next(self._found)


@pytest.fixture(scope="module")
def request_of_arm() -> tuple[JointGoal, JointState]:
    shown = arm_demonstrations()[0]
    goal = JointGoal(JointState(JOINTS, shown.positions[-1]), shown.duration)
    return goal, JointState(JOINTS, shown.positions[0])


def arm_planner() -> Planner:
    robot = arm_robot()
    options = PlannerOptions(naturalness=1e-3)
    return Planner(robot, [arm_primitive()], robot.limits(), options)


MEETING = Collision(("hand", "trunk"), 0.3, 0.02, 0.2, 0.4)


def test_motion_that_collides_is_pulled_towards_the_demonstrations(request_of_arm):
    planner = CollisionFreePlanner(arm_planner(), Scripted(MEETING, MEETING, None))
    plan = planner.plan(*request_of_arm)
    assert plan.status == SOLVED
    assert plan.naturalness == 0.1
    assert "to avoid self-collision, the naturalness was raised from 0.001 to 0.1" in plan.message


def test_motion_that_always_collides_is_infeasible_and_says_where(request_of_arm):
    plan = CollisionFreePlanner(arm_planner(), Scripted(*[MEETING] * 9)).plan(*request_of_arm)
    assert plan.status == INFEASIBLE and not plan.is_executable
    assert "'hand' and 'trunk' collide from 0.200 s on" in plan.message
    assert "20.0 mm" in plan.message


def test_collision_at_an_end_is_not_planned_again(request_of_arm):
    at_start = Collision(("hand", "trunk"), 0.0, 0.02, 0.0, 0.1)
    plan = CollisionFreePlanner(arm_planner(), Scripted(at_start)).plan(*request_of_arm)
    assert plan.status == INFEASIBLE


def test_robot_without_collision_geometry_is_said_so(request_of_arm):
    robot = Robot(CHAIN.replace("collision>", "visual>"), NAMES)
    model = CollisionModel(robot)
    assert not model.has_geometry and model.pairs == ()
    plan = CollisionFreePlanner(arm_planner(), model).plan(*request_of_arm)
    assert plan.status == SOLVED
    assert "self-collisions were not checked" in plan.message


def sequence_of_arm() -> tuple[SequencePlanner, SequenceGoal, JointState]:
    robot = arm_robot()
    start, *targets = (JointState(JOINTS, d.positions[-1]) for d in arm_demonstrations()[:3])
    planner = SequencePlanner(robot, [arm_primitive()], robot.limits())
    return planner, SequenceGoal(tuple(targets)), start


def test_sequence_that_collides_is_joined_instead_or_infeasible():
    planner, *request = sequence_of_arm()
    found = CollisionFreeSequencePlanner(planner, Scripted(MEETING, None)).plan(*request)
    assert (found.status, found.mode) == (SOLVED, REAL_TIME)
    assert "in the optimal one 'hand' and 'trunk' collide" in found.message
    free = CollisionFreeSequencePlanner(planner, Scripted(None)).plan(*request)
    assert (free.status, free.mode) == (SOLVED, OPTIMAL)
    for script, mode in (((MEETING, MEETING), OPTIMAL), ((MEETING,), REAL_TIME)):
        plan = CollisionFreeSequencePlanner(planner, Scripted(*script)).plan(*request, mode)
        assert plan.status == INFEASIBLE
        assert "'hand' and 'trunk' collide from 0.200 s on" in plan.message
    blind = CollisionModel(Robot(CHAIN.replace("collision>", "visual>"), NAMES))
    plan = CollisionFreeSequencePlanner(planner, blind).plan(*request)
    assert plan.is_executable and "self-collisions were not checked" in plan.message


# The command


@pytest.fixture
def files(tmp_path) -> list[str]:
    demonstrations = [
        Demonstration(
            NAMES, m.times, m.positions, m.velocities, m.accelerations,
            recording=f"{k}", start_time=0.0, end_time=1.0,
        )
        for k in range(6)
        for m in [motion([0.0, 0.5, 0.1 * k], [0.1 * k, 0.9, 1.0 + 0.1 * k**2])]
    ]  # fmt: skip
    options = PrimitiveOptions(n_components=1)
    save_primitive(build_primitive(demonstrations, "fold", options), tmp_path / "fold.npz")
    (tmp_path / "chain.urdf").write_text(CHAIN, encoding="utf-8")
    return [str(tmp_path / "fold.npz"), "--robot", str(tmp_path / "chain.urdf")]


def test_plan_refuses_a_motion_that_ends_in_itself(files, capsys):
    ends = ["--start", "0,0.9,0", "--goal", "0,0.9,3.0", "--duration", "1", "--json"]
    assert main([*files, *ends]) == 0
    capsys.readouterr()
    assert main([*files, *ends, "--collision"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["status"] == "infeasible"
    assert "'a' and 'c' collide" in facts["message"]


def test_plan_goes_where_nothing_is_in_the_way(files, capsys):
    ends = ["--start", "0,0.5,0", "--goal", "0.2,0.9,1.1", "--duration", "1"]
    assert main([*files, *ends, "--collision"]) == 0
    assert "not checked" not in capsys.readouterr().out


def test_plan_refuses_an_srdf_without_collision(files, capsys):
    ends = ["--start", "0,0.5,0", "--goal", "0.2,0.9,1.1", "--srdf", "x.srdf"]
    assert main([*files, *ends]) == 2
    assert "are for --collision" in capsys.readouterr().err


def test_sequence_refuses_to_end_in_itself_too(files, capsys):
    ends = ["--start", "0,0.9,0", "--via", "0.1,0.9,0.5", "--goal", "0,0.9,3.0", "--json"]
    assert sequence([*files, *ends]) == 0
    capsys.readouterr()
    assert sequence([*files, *ends, "--collision"]) == 1
    assert "'a' and 'c' collide" in json.loads(capsys.readouterr().out)["message"]
