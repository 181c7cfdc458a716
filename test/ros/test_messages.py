# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Conversions between values of the core and ROS messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Header
from support.arm import GRIPPER_URDF, JOINTS, arm_primitive
from support.nodes import GOAL, START
from support.patience import NODE_EVER
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mp_pca_planner.control.law import control_statement
from mp_pca_planner.exceptions import GoalError, TrajectoryError
from mp_pca_planner.execution.link import Planned, PlanRequest
from mp_pca_planner.execution.outcomes import ExecutionReport, GoalOutcome, MotionOutcome
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import GoalPlanner, assemble_model
from mp_pca_planner.execution.server import GoalRequest, NodeModel
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, SequenceGoal
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.ros.goals import (
    GOAL_TOPICS,
    read_stamp,
    to_sequence_message,
)
from mp_pca_planner.ros.messages import (
    to_execution_report,
    to_goal_report,
    to_plan_report,
    to_trajectory,
)
from mp_pca_planner.ros.obstacles import ForeignFrames
from mp_pca_planner.ros.serialised import serialize_trajectory

NAN, INF = float("nan"), float("inf")
STAMP = Time(sec=5, nanosec=7)


CAMERA = f"camera: 0.5 0 1 0 0 {0.5**0.5} {0.5**0.5}"  # turned by 90° about z
SETTINGS = Settings(max_solve_time=NODE_EVER, end_effector_frame="wrist", fixed_frames=(CAMERA,))
ASSEMBLED = assemble_model(GRIPPER_URDF, [arm_primitive()], SETTINGS, {"finger": 0.0})
MODEL = NodeModel(ASSEMBLED.robot, ASSEMBLED.facts, SETTINGS)


@pytest.fixture(scope="module")
def plan() -> Planned:
    planner = GoalPlanner()
    planner.model = ASSEMBLED
    start, goal = (JointState(JOINTS, arm_primitive().boundary_states[0][i]) for i in (0, 3))
    planned = planner.plan(PlanRequest(1, JointGoal(goal), start))
    assert isinstance(planned, Planned), planned
    return planned


# Goals


def request(message: Any, model: NodeModel = MODEL) -> GoalRequest:
    """The request of a goal, as the node makes it of the bytes of a message."""
    (topic,) = (one for one in GOAL_TOPICS if one.message_type is type(message))
    poses = ForeignFrames(None)  # type: ignore[arg-type]
    content = bytes(serialize_message(message))
    return topic.request(content, model, lambda frame: poses.pose(frame, model))


def configuration(position: Any = GOAL, name: Any = JOINTS, **fields: Any) -> JointStateMessage:
    return JointStateMessage(name=list(name), position=list(position), **fields)


def sequence(*points: JointTrajectoryPoint, names: Any = JOINTS) -> JointTrajectory:
    return JointTrajectory(joint_names=list(names), points=points)


def passing(positions: Any = GOAL, seconds: int = 0, **fields: Any) -> JointTrajectoryPoint:
    point = JointTrajectoryPoint(positions=list(positions), **fields)
    point.time_from_start.sec = seconds
    return point


def pose_message(turn: Any = (0.0, 0.0, 0.0, 1.0), at: Any = (0, 0, 0), frame: str = "") -> Any:
    message = PoseStamped(header=Header(frame_id=frame))
    message.pose.position = Point(**dict(zip("xyz", map(float, at), strict=True)))
    message.pose.orientation = Quaternion(**dict(zip("xyzw", turn, strict=True)))
    return message


def test_goal_takes_positions_velocities_and_the_primitive_from_the_frame() -> None:
    wanted = configuration([1.0, 2.0], ["elbow", "shoulder1"], velocity=[3.0, 4.0])
    wanted.header.frame_id = "reach"
    goal = request(wanted).goal
    assert goal.state.joint_names == ("elbow", "shoulder1")
    assert goal.state.positions.tolist() == [1.0, 2.0]
    assert goal.state.velocities.tolist() == [3.0, 4.0]
    assert (goal.duration, goal.primitive) == (None, "reach")
    goal = request(configuration(), replace(MODEL, settings=Settings(duration=1.5))).goal
    assert (goal.duration, goal.primitive) == (1.5, None)
    assert not goal.state.velocities.any()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (configuration([], []), "joints of a state: non-empty"),
        (configuration([]), "has 0 positions .* for 4 joints"),
        (configuration(velocity=[1.0, 2.0]), "has 4 positions and 2 velocities for 4 joints"),
        (configuration([1.0, 2.0], ["a", "a"]), "'a' given more than once"),
        (configuration([*GOAL[:3], NAN]), "the goal has nan for joint 'elbow'"),
        (configuration([0.0], ["finger"]), "primitives do not move 'finger' of the goal"),
        (configuration([0.0] * 30_000, ["joint"] * 30_000), r"has \d+ bytes, at most 200000 are"),
        (configuration([0.0] * 1001, ["joint"] * 1001), "names 1001 joints, at most 1000"),
        (sequence(), "the number of targets must be .* from 1"),
        (sequence(passing(seconds=2), passing(START, 1)), "positive and increase, got .2.0, 1.0"),
        (sequence(passing(seconds=-1)), "positive"),
        (sequence(passing([*GOAL[:3], NAN])), "point 1 of the goal has nan for joint 'elbow'"),
        (sequence(passing(GOAL[:2])), "point 1 of the goal has 2 positions .* for 4 joints"),
        (sequence(passing(velocities=[0.1] * 4)), "point 1 of the goal specifies velocities"),
        (sequence(passing(), passing(velocities=[0.0])), "point 2 of the goal has .* 1 velocities"),
        (sequence(passing([0.0]), names=["finger"]), "primitives do not move 'finger'"),
        (pose_message(frame="world"), "'world'.*empty frame_id means the base.*'fixed_frames'"),
        (pose_message((0.0, 0.0, 0.0, 0.5)), "length 1"),
        (pose_message(at=(NAN, 0, 0)), "nan"),
    ],
)
def test_malformed_goals_are_refused_by_name(wrong: Any, words: str) -> None:
    with pytest.raises(GoalError, match=words):
        request(wrong)


def test_joints_that_the_primitives_do_not_move_are_left_out_and_named() -> None:
    names = ("finger", *JOINTS)
    found = request(configuration([0.0, *GOAL], names))
    assert found.ignored_joints == ("finger",)
    assert dict(zip(found.goal.state.joint_names, found.goal.state.positions, strict=True)) == (
        dict(zip(JOINTS, GOAL, strict=True))
    )
    found = request(sequence(passing([0.0, *GOAL]), passing([0.0, *START]), names=names))
    assert found.ignored_joints == ("finger",)
    assert [target.positions.tolist() for target in found.goal.targets] == [GOAL, START]


def test_pose_is_the_same_in_whichever_frame_it_is_stated() -> None:
    robot, start = MODEL.robot, JointState(JOINTS, START)
    at, turn = np.array([0.3, 0.2, 0.9]), Rotation.from_euler("xyz", [0.4, -0.5, 0.6])
    camera = Rotation.from_euler("z", 90, degrees=True)
    (hand,) = robot.attached_poses(np.array([START]), ["wrist"], np.zeros((1, 6)))[0]
    for frame, origin, turned in (
        ("", np.zeros(3), Rotation.identity()),
        ("camera", [0.5, 0.0, 1.0], camera),
        ("wrist", hand[:3], Rotation.from_quat(hand[3:])),  # at the start of the motion
    ):
        seen = turned.inv().apply(at - origin)
        message = pose_message((turned.inv() * turn).as_quat(), seen, frame)
        found = request(message)
        goal = found.make_goal(start) if found.make_goal else found.goal
        np.testing.assert_allclose(goal.pose.position, at, atol=1e-9)
        assert (Rotation.from_quat(goal.pose.orientation).inv() * turn).magnitude() < 1e-9
    free = request(pose_message((0.0, 0.0, 0.0, 0.0), at, "camera")).goal
    assert free.pose.orientation is None


def test_sequence_survives_the_way_through_a_message() -> None:
    states = tuple(JointState(JOINTS, q) for q in (START, GOAL, [0.0, 1.0, -0.4, 0.3]))
    goal = SequenceGoal(states, (None, 0.25, 1e9 + 0.5), "reach", (False, True, False))
    back = request(to_sequence_message(goal)).goal
    assert back.times == goal.times
    assert back.stops == goal.stops
    assert back.primitive == "reach"
    for before, after in zip(states, back.targets, strict=True):
        assert isinstance(after, JointState)
        assert after.joint_names == before.joint_names
        assert np.array_equal(after.positions, before.positions)


def test_sequence_that_no_message_can_say_is_refused() -> None:
    state = JointState(["a"], [0.0])
    with pytest.raises(GoalError, match="same joints"):
        to_sequence_message(SequenceGoal((state, Pose("hand", [0, 0, 0]))))
    with pytest.raises(GoalError, match="same joints"):
        to_sequence_message(SequenceGoal((state, JointState(["b"], [0.0]))))
    with pytest.raises(GoalError, match="longer than a message"):
        to_sequence_message(SequenceGoal((state,), (1e10,)))


@given(st.binary(max_size=80))
def test_stamp_of_any_bytes_is_read(content: bytes) -> None:
    read_stamp(content)
    stamped = JointStateMessage()
    stamped.header.stamp = STAMP
    assert read_stamp(bytes(serialize_message(stamped))) == STAMP


# Trajectories


# Of all lengths that fields may be aligned differently behind.
NAMES = st.lists(st.text("aé", min_size=1, max_size=9), min_size=1, max_size=4, unique=True)
STEPS = st.lists(st.integers(1, 10**10), max_size=4)


@given(NAMES, STEPS, st.booleans(), st.booleans())
def test_ros_reads_serialised_trajectories_of_any_alignment_to_the_last_bit(
    names: list[str], steps: list[int], with_efforts: bool, last_point_only: bool
) -> None:
    stamps = np.cumsum([0, *steps])
    values = np.random.default_rng(1).normal(size=(4, len(stamps), len(names)))
    sent = Trajectory(names, stamps * 1e-9, *values)
    raw = serialize_trajectory(sent, with_efforts=with_efforts, last_point_only=last_point_only)
    message = deserialize_message(raw, JointTrajectory)
    assert message.header == Header()
    since = [point.time_from_start for point in message.points]
    first = len(stamps) - 1 if last_point_only else 0
    assert [one.sec * 10**9 + one.nanosec for one in since] == stamps[first:].tolist()
    message.points[0].time_from_start = Duration()  # a trajectory begins at 0
    received = to_trajectory(message)
    assert list(received.joint_names) == names
    for field in ("positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(received, field), getattr(sent, field)[first:])
    if with_efforts:
        np.testing.assert_array_equal(received.efforts, sent.efforts[first:])
    else:
        assert received.efforts is None


def test_trajectories_that_are_not_well_formed_are_refused() -> None:
    still = np.zeros((2, 2))
    sent = Trajectory(["a", "b"], [0.0, 1.0], still, still, still)
    message = deserialize_message(serialize_trajectory(sent, with_efforts=False), JointTrajectory)
    message.points[1].velocities = []
    with pytest.raises(TrajectoryError, match="velocities"):
        to_trajectory(message)
    with pytest.raises(TrajectoryError, match="no efforts"):
        serialize_trajectory(sent, with_efforts=True)
    near = Trajectory(["a", "b"], [0.0, 1e-12], still, still, still)
    with pytest.raises(TrajectoryError, match="1 ns"):
        serialize_trajectory(near, with_efforts=False)


# Reports


def values(report: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in report.values}


def test_report_of_a_plan_holds_its_summary_to_the_last_bit_and_its_control_law(
    plan: Planned,
) -> None:
    report = to_plan_report(plan, STAMP)
    found = values(report)
    assert report.level == DiagnosticStatus.OK
    assert found.pop("goal_stamp") == "5.000000007"
    name = f"control_law.{arm_primitive().name}"
    assert found.pop(name) == control_statement(arm_primitive())
    assert found.keys() == plan.values.keys()
    for key, value in plan.values.items():
        assert repr(type(value)(found[key])) == repr(value)  # NaN is as good as any number
    report = to_plan_report(replace(plan, remarks=("time ran out", "unlike")), STAMP)
    assert report.level == DiagnosticStatus.WARN
    assert report.message == f"{plan.message}; time ran out; unlike"
    report = to_plan_report(plan, STAMP, ("finger",), "no mesh")
    assert report.level == DiagnosticStatus.WARN
    assert "not avoided: no mesh; joints 'finger' of the goal are not moved" in report.message


def test_refusal_is_an_error_in_one_line_with_the_plan_if_there_is_one(plan: Planned) -> None:
    text = "no joint 'a\nb\x00関節'" + "x" * 10**6
    without, refused = (
        to_goal_report(GoalOutcome.REFUSED, text, STAMP, one) for one in ({}, plan.values)
    )
    assert without.level == refused.level == DiagnosticStatus.ERROR
    assert without.message.startswith(r"no joint 'a\nb\x00関節'") and len(without.message) < 1020
    assert values(without) == {"status": "refused", "goal_stamp": "5.000000007"}
    assert values(refused)["effort_cost"] == str(plan.values["effort_cost"])


@pytest.mark.parametrize("outcome", MotionOutcome)
def test_report_of_a_motion_is_an_error_unless_it_went_as_was_asked(outcome: MotionOutcome) -> None:
    report = to_execution_report(ExecutionReport(STAMP, outcome, "so", 0.5, 0.1, 0.2, 0.3))
    failed = outcome in ("not_followed", "never_started")
    assert report.level == (DiagnosticStatus.ERROR if failed else DiagnosticStatus.OK)
    found = values(report)
    assert (found["outcome"], found["goal_stamp"]) == (outcome, "5.000000007")
    numbers = [float(found[name]) for name in ("progress", "error", "deviation_time")]
    assert numbers == [0.5, 0.1, 0.3]
