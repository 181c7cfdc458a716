# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Conversions between values of the core and ROS messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Header
from support.arm import JOINTS, arm_primitive
from support.nodes import URDF
from support.patience import NODE_EVER
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.control.law import control_statement
from mp_pca_planner.exceptions import GoalError, TrajectoryError
from mp_pca_planner.execution.link import Planned, PlanRequest
from mp_pca_planner.execution.outcomes import ExecutionReport, GoalOutcome, MotionOutcome
from mp_pca_planner.execution.parameters import DECLARATIONS, Settings
from mp_pca_planner.execution.planning import GoalPlanner, assemble_model
from mp_pca_planner.execution.server import NodeModel
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, SequenceGoal
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.ros.goals import (
    GOAL_TOPICS,
    read_stamp,
    to_goal,
    to_sequence_goal,
    to_sequence_message,
)
from mp_pca_planner.ros.messages import (
    to_descriptor,
    to_execution_report,
    to_goal_report,
    to_plan_report,
    to_trajectory,
)
from mp_pca_planner.ros.serialised import serialize_trajectory

NAN, INF = float("nan"), float("inf")
STAMP = Time(sec=5, nanosec=7)


def message(names: list[str], positions: list[float], **fields: object) -> JointStateMessage:
    return JointStateMessage(name=names, position=positions, **fields)


def trajectory(times: list[float], efforts: bool = True) -> Trajectory:
    values = np.random.default_rng(1).normal(size=(4, len(times), 2))
    return Trajectory(["a", "b"], times, *values[:3], values[3] if efforts else None)


def written(sent: Trajectory, with_efforts: bool = False) -> JointTrajectory:
    return deserialize_message(
        serialize_trajectory(sent, with_efforts=with_efforts), JointTrajectory
    )


SETTINGS = Settings(max_solve_time=NODE_EVER)
ASSEMBLED = assemble_model(URDF, [arm_primitive()], SETTINGS)
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


def test_goal_takes_positions_velocities_and_the_primitive_from_the_frame() -> None:
    wanted = message(["b", "a"], [1.0, 2.0], velocity=[3.0, 4.0])
    wanted.header.frame_id = "reach"
    goal = to_goal(wanted, 1.5)
    assert goal.state.joint_names == ("b", "a")
    assert goal.state.positions.tolist() == [1.0, 2.0]
    assert goal.state.velocities.tolist() == [3.0, 4.0]
    assert (goal.duration, goal.primitive) == (1.5, "reach")


def test_sequence_survives_the_way_through_a_message() -> None:
    states = tuple(JointState(["a", "b"], q) for q in ([0.1, 0.2], [0.3, -0.4], [0.0, 1.0]))
    goal = SequenceGoal(states, (None, 0.25, 1e9 + 0.5), "reach", (False, True, False))
    raw = serialize_message(to_sequence_message(goal))
    back = to_sequence_goal(deserialize_message(raw, JointTrajectory))
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


def test_duration_zero_and_empty_frame_leave_the_choice_to_the_planner() -> None:
    goal = to_goal(message(["a"], [1.0]), 0.0)
    assert (goal.duration, goal.primitive) == (None, None)
    assert goal.state.velocities.tolist() == [0.0]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (message([], []), "at least one"),
        (message(["a"], []), "1 joints and has 0 positions"),
        (message(["a"], [1.0], velocity=[1.0, 2.0]), "1 joints and has 2 velocities"),
        (message(["a", "a"], [1.0, 2.0]), "'a' given more than once"),
        (message([""], [1.0]), "non-empty"),
        (message(["a", "b"], [1.0, NAN]), "goal position of joint 'b' is nan"),
        (message(["a", "b"], [1.0, 2.0], velocity=[-INF, 0.0]), "velocity of joint 'a' is -inf"),
    ],
)
def test_malformed_goals_are_refused_by_name(wrong: JointStateMessage, words: str) -> None:
    with pytest.raises(GoalError, match=words):
        to_goal(wrong, 0.0)


def test_goals_that_are_far_too_large_are_refused_before_they_are_read() -> None:
    topic, model = GOAL_TOPICS[0], MODEL
    content = bytes(serialize_message(message([f"joint_{k}" for k in range(30_000)], [])))
    with pytest.raises(GoalError, match=r"has \d+ bytes, at most 200000 are accepted"):
        topic.request(content, model, lambda _: None)


@given(st.binary(max_size=80))
def test_stamp_of_any_bytes_is_read(content: bytes) -> None:
    read_stamp(content)
    stamped = JointStateMessage()
    stamped.header.stamp = STAMP
    assert read_stamp(bytes(serialize_message(stamped))) == STAMP


# Trajectories


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=20))
def test_times_from_start_are_exact_to_the_nanosecond(steps: list[int]) -> None:
    stamps = np.cumsum([0, *steps])
    points = written(trajectory((stamps * 1e-9).tolist())).points
    found = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in points]
    assert found == stamps.tolist()


# Of all lengths that fields may be aligned differently behind.
NAMES = st.lists(st.text("aé", min_size=1, max_size=9), min_size=1, max_size=4, unique=True)


@given(NAMES, st.integers(1, 3), st.booleans(), st.booleans())
def test_ros_reads_serialised_trajectories_of_any_alignment(
    names: list[str], n_points: int, with_efforts: bool, last_point_only: bool
) -> None:
    values = np.random.default_rng(1).normal(size=(4, n_points, len(names)))
    sent = Trajectory(names, 0.75 * np.arange(n_points), *values)
    raw = serialize_trajectory(sent, with_efforts=with_efforts, last_point_only=last_point_only)
    message = deserialize_message(raw, JointTrajectory)
    first = n_points - 1 if last_point_only else 0
    assert message.header == Header()
    assert message.joint_names == names
    for k, point in enumerate(message.points, start=first):
        for field, column in zip(
            ("positions", "velocities", "accelerations"), values, strict=False
        ):
            assert list(getattr(point, field)) == list(column[k])
        assert list(point.effort) == (list(values[3, k]) if with_efforts else [])
        assert point.time_from_start.sec + point.time_from_start.nanosec * 1e-9 == 0.75 * k
    assert len(message.points) == n_points - first


@pytest.mark.parametrize("with_efforts", [True, False])
def test_trajectory_survives_the_wire_to_the_last_bit(with_efforts: bool) -> None:
    sent = trajectory([0.0, 0.25, 1.5])
    received = to_trajectory(written(sent, with_efforts))
    assert received.joint_names == sent.joint_names
    for field in ("times", "positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(received, field), getattr(sent, field))
    if with_efforts:
        np.testing.assert_array_equal(received.efforts, sent.efforts)
    else:
        assert received.efforts is None


def test_received_trajectory_with_a_point_that_lacks_velocities_is_refused() -> None:
    message = written(trajectory([0.0, 1.0]))
    message.points[1].velocities = []
    with pytest.raises(TrajectoryError, match="velocities"):
        to_trajectory(message)


def test_efforts_that_are_asked_for_are_missed() -> None:
    with pytest.raises(TrajectoryError, match="no efforts"):
        serialize_trajectory(trajectory([0.0, 1.0], efforts=False), with_efforts=True)


def test_points_that_would_get_the_same_stamp_are_refused() -> None:
    with pytest.raises(TrajectoryError, match="1 ns"):
        serialize_trajectory(trajectory([0.0, 1e-12]), with_efforts=False)


# Reports


def values(report: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in report.values}


def test_report_of_a_solved_plan_is_ok_and_holds_its_summary_to_the_last_bit(plan: Planned) -> None:
    report = to_plan_report(plan, STAMP)
    found = values(report)
    assert report.level == DiagnosticStatus.OK
    assert found.pop("goal_stamp") == "5.000000007"
    for key, value in plan.values.items():
        assert repr(type(value)(found[key])) == repr(value)  # NaN is as good as any number


def test_report_of_an_unusual_plan_is_a_warning(plan: Planned) -> None:
    report = to_plan_report(replace(plan, remarks=("time ran out", "unlike")), STAMP)
    assert report.level == DiagnosticStatus.WARN
    assert report.message == f"{plan.message}; time ran out; unlike"


def test_report_states_the_control_law_of_the_primitive_used(plan: Planned) -> None:
    report = to_plan_report(plan, STAMP)
    laws = {key: value for key, value in values(report).items() if key.startswith("control_law")}
    assert laws == {f"control_law.{arm_primitive().name}": control_statement(arm_primitive())}


def test_refusal_is_an_error_with_the_plan_if_there_is_one(plan: Planned) -> None:
    without, refused = (
        to_goal_report(GoalOutcome.REFUSED, "because", STAMP, one) for one in ({}, plan.values)
    )
    assert without.level == refused.level == DiagnosticStatus.ERROR
    assert without.message == refused.message == "because"
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


def test_refusal_is_one_line_of_bounded_length_whatever_names_it_quotes() -> None:
    assert (
        to_goal_report(GoalOutcome.REFUSED, "no joint 'a\nb\x00関節'", STAMP, {}).message
        == r"no joint 'a\nb\x00関節'"
    )
    assert len(to_goal_report(GoalOutcome.REFUSED, "x" * 10**6, STAMP, {}).message) == 1000


# Parameters


def test_descriptors_tell_tools_what_the_table_says() -> None:
    for declaration in DECLARATIONS:
        descriptor = to_descriptor(declaration)
        assert descriptor.description == declaration.description
        assert declaration.accepted in descriptor.additional_constraints
        if isinstance(declaration.default, float):
            (accepted,) = descriptor.floating_point_range
            assert (accepted.from_value, accepted.to_value) == (declaration.low, declaration.high)
