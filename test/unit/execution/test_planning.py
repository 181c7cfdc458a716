# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files and settings become a planner, or are refused by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.arm import GRIPPER_URDF, JOINTS, URDF, arm_demonstrations, arm_primitive, arm_robot

from mp_pca_planner.exceptions import PlannerError, RobotError
from mp_pca_planner.execution.link import Planned, PlanRequest, Rejected, RunningMotion, SetUp
from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import (
    GoalPlanner,
    Model,
    assemble_model,
    in_world,
    is_outdated,
    unknown_positions,
)
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from mp_pca_planner.planning.objectives import effort, time
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.locked import mimicking_joints
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Obstacle, Sphere, World

MESHED = URDF.replace(
    "</robot>",
    '<link name="tool"><collision><geometry><mesh filename="package://tools/tool.stl"/></geometry>'
    '</collision></link><joint name="flange" type="fixed"><parent link="wrist"/>'
    '<child link="tool"/></joint></robot>',
)
PRIMITIVES = (arm_primitive(),)
START = PRIMITIVES[0].boundary_states[0][0]
GOAL = JointGoal(JointState(JOINTS, PRIMITIVES[0].boundary_states[0][3]))


def test_limits_of_parameters_win_over_the_file_and_the_file_over_the_urdf(tmp_path: Path) -> None:
    file = tmp_path / "limits.yaml"
    file.write_text("joint_limits: {elbow: {max_velocity: 3.0, max_jerk: 50.0}}")
    others = {
        "timing": "free",
        "objective": "time=1e3, effort",
        "constraints": "upright=wrist,170",
    }
    settings = Settings(limits_file=str(file), limits={"elbow": {"max_velocity": 2.0}}, **others)
    model = assemble_model(URDF, PRIMITIVES, settings)
    limits, options = model.limits, model.planner.options
    elbow = JOINTS.index("elbow")
    assert (limits.velocity[elbow], limits.jerk[elbow], limits.effort[elbow]) == (2.0, 50.0, 70.0)
    assert ([one for _, one in options.objectives], options.timing) == ([time, effort], "free")
    assert str(*options.constraints) == "'wrist' within 170° of upright"
    assert model.constraints == options.constraints


def test_missing_meshes_are_noted_once_and_needed_among_obstacles(tmp_path: Path) -> None:
    model = assemble_model(MESHED, PRIMITIVES, Settings())
    assert model.planner.collision is None
    (note,) = (note for note in model.facts.notes if "tool.stl" in note)
    assert "self-collision is not checked" in note and "--package-dirs" in note
    assert assemble_model(MESHED, PRIMITIVES, Settings(collision=False)).remarks == ()
    with pytest.raises(RobotError, match="--package-dirs"):
        in_world(model, World([Obstacle("ball", [Sphere(0.1, [0.5, 0.5, 0.0])])]))
    (tmp_path / "tools").mkdir()
    triangle = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.05 0 0\nvertex 0 0.05 0\n"
    text = f"solid x\n{triangle}endloop\nendfacet\nendsolid x\n"
    (tmp_path / "tools" / "tool.stl").write_text(text, encoding="utf-8")
    settings = Settings(package_dirs=("", str(tmp_path)))
    collision = assemble_model(MESHED, PRIMITIVES, settings).planner.collision
    assert collision is not None and ("chest", "tool") in collision.pairs


def finger_clearance(model: Model, q: np.ndarray) -> float:
    """Distance of the finger from a ball beside the arm."""
    world = World([Obstacle("ball", [Sphere(0.1, [0.5, 0.5, 0.0])])])
    pairs = in_world(model, world)
    found = pairs.near(q[None], np.inf)
    return float(found.distances[found.pairs == pairs.pairs.index(("finger_link", "ball"))][0])


def test_a_joint_that_mimics_one_that_moves_is_rejected_even_if_it_is_measured() -> None:
    # Its position changes during the motion, and the model has it fixed.
    mimic = f'<mimic joint="{JOINTS[3]}" multiplier="0.1"/>'
    urdf = GRIPPER_URDF.replace('<limit lower="0" ', f'{mimic}<limit lower="0" ')
    model = assemble_model(urdf, PRIMITIVES, Settings(), {"finger": 0.04})
    text = f"joint 'finger' mimics '{JOINTS[3]}', which the primitives move"
    assert unknown_positions(model, World()).startswith(text)
    assert mimicking_joints(model.robot) == {"finger": JOINTS[3]}


def test_joints_that_the_primitives_do_not_move_are_locked_where_they_are_measured() -> None:
    q = arm_demonstrations()[0].positions[0]
    settings = Settings(obstacle_margin=0.0)
    given = assemble_model(GRIPPER_URDF, PRIMITIVES, Settings(locked_joints="finger = 0.05"))
    assert dict(given.robot.locked_positions) == {"finger": 0.05}
    for name, words in (("fingerp", "did you mean 'finger'"), (JOINTS[0], "do not move")):
        with pytest.raises(PlannerError, match=words):
            assemble_model(GRIPPER_URDF, PRIMITIVES, Settings(locked_joints=f"{name}=0.05"))
    before = assemble_model(GRIPPER_URDF, PRIMITIVES, settings)
    assert "'finger' are not known" in unknown_positions(before, World())
    measured = {"finger": 0.08, JOINTS[0]: 0.3, "elsewhere": 1.0}
    assert is_outdated(before, measured, World())
    model = assemble_model(GRIPPER_URDF, PRIMITIVES, settings, measured)
    assert not unknown_positions(model, World())
    assert dict(model.robot.locked_positions) == {"finger": 0.08}
    assert abs(finger_clearance(model, q) - finger_clearance(before, q)) > 0.004
    for noise in (-9e-4, 9e-4):
        assert not is_outdated(model, {"finger": 0.08 + noise}, World())
    assert is_outdated(model, {"finger": 0.0788}, World())
    assert not is_outdated(model, {}, World())


# Set-ups and requests of the node


@pytest.fixture
def library(tmp_path: Path) -> str:
    save_primitive(PRIMITIVES[0], tmp_path / "reach.npz")
    return str(tmp_path / "reach.npz")


@pytest.fixture
def planner(library: str) -> GoalPlanner:
    planner = GoalPlanner()
    done = planner.set_up(SetUp(1, GRIPPER_URDF, Settings(primitives=(library,)), {"finger": 0.02}))
    assert (done.number, done.problem, done.joint_names) == (1, "", JOINTS)
    assert done.model is not None
    assert dict(done.model.locked) == {"finger": 0.02}
    return planner


def request(key: int = 1, goal: Any = GOAL, **others: Any) -> PlanRequest:
    return PlanRequest(key, goal, JointState(JOINTS, START), **others)


def test_goals_are_rejected_until_all_that_a_plan_needs_is_known(library: str) -> None:
    planner = GoalPlanner()
    none = planner.set_up(SetUp(1, URDF, Settings()))
    assert (none.joint_names, none.model, none.problem) == ((), None, "")
    without_robot = planner.set_up(SetUp(2, "", Settings(primitives=(library,))))
    assert (without_robot.joint_names, without_robot.model) == (JOINTS, None)
    rejected = planner.plan(request())
    assert isinstance(rejected, Rejected) and "being set up" in rejected.reason
    done = planner.set_up(SetUp(3, GRIPPER_URDF, Settings(primitives=(library,))))
    assert done.model is not None and "'finger'" in done.model.unknown
    rejected = planner.plan(request(2))
    assert isinstance(rejected, Rejected) and "'finger'" in rejected.reason
    # Where it was measured last, it is locked.
    for position, is_new in ((0.09, True), (0.09, False), (0.02, True)):
        before = planner.model
        assert isinstance(planner.plan(request(3, measured={"finger": position})), Planned)
        assert (planner.model is not before) == is_new
        assert dict(planner.model.facts.locked) == {"finger": position}


@pytest.mark.parametrize(
    ("urdf", "settings", "is_unreadable"),
    [
        ("<robot", {}, False),
        (URDF.replace('"elbow"', '"knee"'), {}, False),
        (URDF, {"limits_file": "/nowhere.yaml"}, False),
        (URDF, {"srdf": __file__}, False),
        (URDF, {"constraints": "upright=palm,30"}, False),
        (URDF, {"primitives": ("/nowhere.npz",)}, True),
        (URDF, {"limits": {"elbow": {"max_velocity": -1.0}}}, False),
        (URDF, {"end_effector_frame": "hend"}, False),
    ],
)
def test_set_up_that_is_refused_leaves_the_one_before(
    planner: GoalPlanner, library: str, urdf: str, settings: dict[str, Any], is_unreadable: bool
) -> None:
    model = planner.model
    refused = SetUp(2, urdf, Settings(**{"primitives": (library,), **settings}))
    done = planner.set_up(refused)
    assert done.model is None and done.problem
    assert done.is_unreadable == is_unreadable
    assert planner.model is model
    assert isinstance(planner.plan(request(measured={"finger": 0.02})), Planned)


def test_primitives_are_read_again_only_when_that_is_asked_for(
    planner: GoalPlanner, library: str
) -> None:
    Path(library).unlink()
    settings = Settings(primitives=(library,), naturalness=0.5)
    assert not planner.set_up(SetUp(2, GRIPPER_URDF, settings)).problem
    again = planner.set_up(SetUp(3, GRIPPER_URDF, settings, rereads=True))
    assert again.is_unreadable and library in again.problem


@pytest.mark.parametrize(("action", "is_served"), [("refuse", False), ("warn", True)])
def test_obstacle_of_unknown_place_rejects_goals_unless_it_only_warns(
    library: str, action: str, is_served: bool
) -> None:
    planner = GoalPlanner()
    planner.set_up(SetUp(1, URDF, Settings(primitives=(library,), unplaced_obstacles=action)))
    planner.unplaced = "obstacle 'box' is stated in the frame 'map'"
    found = planner.plan(request())
    assert isinstance(found, Planned) == is_served
    if isinstance(found, Rejected):
        assert found.reason.startswith(planner.unplaced)


def test_obstacle_that_comes_during_planning_is_not_hit(planner: GoalPlanner) -> None:
    robot = arm_robot()
    hand = robot.frame_positions(GOAL.state.positions[None], [robot.frame_names[-1]])[0, 0]
    ball = World([Obstacle("ball", Sphere(0.05, hand))])
    planner.settle = lambda: setattr(planner, "world", ball)
    rejected = planner.plan(request(measured={"finger": 0.0}))
    assert isinstance(rejected, Rejected)
    assert rejected.reason.startswith("the obstacles changed during planning")


@pytest.mark.parametrize("is_sequence", [False, True])
def test_goal_that_is_cancelled_during_the_solve_ends_it(library: str, is_sequence: bool) -> None:
    asked: list[int] = []

    def is_cancelled(key: int) -> bool:
        asked.append(key)
        return len(asked) > 1

    planner = GoalPlanner(is_cancelled)
    planner.set_up(SetUp(1, URDF, Settings(primitives=(library,))))
    asked.clear()
    goal = SequenceGoal((GOAL.state, JointState(JOINTS, START))) if is_sequence else GOAL
    rejected = planner.plan(request(7, goal))
    assert isinstance(rejected, Rejected) and rejected.is_preempted
    assert set(asked) == {7} and len(asked) < 10


def under_way(planned: Planned) -> RunningMotion:
    """A planned motion whose middle is reached when the next one begins."""
    return RunningMotion(planned, 0.5 * planned.trajectory.duration, False)


def from_there(goal: Any, running: RunningMotion, key: int = 2) -> PlanRequest:
    """The request of a goal from where a running motion is left."""
    start = PublishedMotion(running.planned.trajectory, 0.0).state(running.place)
    return PlanRequest(key, goal, start, {}, running)


def beside(change: Any, **others: Any) -> JointGoal:
    return JointGoal(JointState(JOINTS, GOAL.state.positions + change), **others)


@pytest.fixture
def first(planner: GoalPlanner) -> Planned:
    planned = planner.plan(request(measured={"finger": 0.02}))
    assert isinstance(planned, Planned)
    return planned


def test_goal_that_drifts_displaces_the_motion_that_is_under_way(
    planner: GoalPlanner, first: Planned
) -> None:
    goal = beside(0.01)
    found = planner.plan(from_there(goal, under_way(first)))
    assert isinstance(found, Planned)
    assert found.message == "the motion is continued to the new goal"
    assert found.primitives == first.primitives
    assert found.values["effort_cost"] == found.trajectory.effort_cost
    np.testing.assert_array_equal(found.trajectory.positions[-1], goal.state.positions)


def test_plan_of_a_pose_is_not_kept_if_the_motion_is_displaced_to_it(
    planner: GoalPlanner, first: Planned
) -> None:
    wrist = arm_robot().frame_positions(GOAL.state.positions[None], ["wrist"])[0, 0]
    for key, change, is_continued in ((2, 0.01, True), (3, 0.15, False)):
        goal = PoseGoal(Pose("wrist", wrist - [change, 0.0, 0.0]))
        found = planner.plan(from_there(goal, under_way(first), key))
        assert isinstance(found, Planned) and ("continued" in found.message) == is_continued
        assert (key in planner.plans) != is_continued


def test_displaced_motion_keeps_the_constraints(planner: GoalPlanner, first: Planned) -> None:
    class Forbidden:
        """A constraint that a motion breaks once."""

        frame = "wrist"

        def values(self, robot: Robot, q: np.ndarray) -> tuple[np.ndarray, None]:
            return np.where(np.arange(len(q)) == len(q) // 2, -1.0, 1.0)[:, None], None

    assert planner.model is not None
    planner.model = replace(planner.model, constraints=(Forbidden(),))
    found = planner.plan(from_there(beside(0.01), under_way(first)))
    assert not isinstance(found, Planned) or "continued" not in found.message


ONE_JOINT = np.array([0.0, -1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("goal", "at_end", "is_reloaded", "is_continued"),
    [
        (beside(0.02), True, False, True),
        (beside(0.04), True, False, False),
        (beside(0.14 * ONE_JOINT), False, False, True),
        (beside(0.16 * ONE_JOINT), False, False, False),
        (beside(0.01 * ONE_JOINT, duration=3.0), False, False, False),
        (beside(0.0), False, True, False),
    ],
)
def test_motion_is_displaced_to_a_near_goal_and_else_planned(
    planner: GoalPlanner,
    first: Planned,
    goal: JointGoal,
    at_end: bool,
    is_reloaded: bool,
    is_continued: bool,
) -> None:
    if is_reloaded:
        first = replace(first, primitives=("reloaded since",))
    running = under_way(first)
    if at_end:
        running = RunningMotion(first, first.trajectory.duration, True)
    found = planner.plan(from_there(goal, running))
    assert isinstance(found, Planned)
    assert ("continued" in found.message) == is_continued
    np.testing.assert_allclose(found.trajectory.positions[-1], goal.state.positions, atol=1e-9)


def test_goal_unlike_the_demonstrations_is_rejected_in_motion_as_at_rest(library: str) -> None:
    planner = GoalPlanner()
    planner.set_up(SetUp(1, URDF, Settings(primitives=(library,))))
    first = planner.plan(request())
    assert isinstance(first, Planned)
    most = float(first.values["in_span_score"]) + 1.0
    planner.set_up(SetUp(2, URDF, Settings(primitives=(library,), max_in_span_score=most)))
    away = beside(np.array([0.0, 0.9, -0.6, 0.0]))
    for one in (request(2, away), from_there(away, under_way(first))):
        found = planner.plan(one)
        assert isinstance(found, Rejected) and "in-span score is" in found.reason
