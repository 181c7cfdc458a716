# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Anything that ROS can send, to every input of the running node."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Duration
from campaigns.node_fuzz import Fuzzer, as_message
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENTLY,
    START,
    NodeClient,
    call,
    described_client,
    goal_message,
    ros_node,
    running_node,
)
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mp_pca_planner.execution.parameters import (
    DECLARATIONS,
    LIMITS_PREFIX,
    Declaration,
    limit_declarations,
)
from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow

DECLARED = {d.name: d for d in (*DECLARATIONS, *limit_declarations(JOINTS))}


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    folder = tmp_path_factory.mktemp("fuzz")
    save_primitive(arm_primitive(), folder / "arm.npz")
    arguments = ("-p", f"primitives:=['{folder}']", *PATIENTLY, "-p", "max_solve_time:=0.05")
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 37)
        with running_node(folder / "log.txt", *arguments) as process:
            yield process


@pytest.fixture(scope="module")
def client(node: subprocess.Popen[str]) -> Iterator[NodeClient]:
    with described_client() as client:
        yield client


@pytest.fixture(scope="module")
def caller(node: subprocess.Popen[str]) -> Iterator[Node]:
    with ros_node("caller") as caller:
        yield caller


@pytest.fixture(scope="module", autouse=True)
def first_values(client: NodeClient, caller: Node) -> list[ParameterMessage]:
    """All parameters before any test."""
    values = get_values(caller)
    return [ParameterMessage(name=name, value=value) for name, value in values.items()]


def get_values(caller: Node) -> dict[str, ParameterValue]:
    request = GetParameters.Request(names=list(DECLARED))
    found = call(caller, GetParameters, "/mp_pca_planner/get_parameters", request).values
    return dict(zip(DECLARED, found, strict=True))


def set_at_once(caller: Node, values: list[ParameterMessage]) -> SetParametersResult:
    request = SetParametersAtomically.Request(parameters=values)
    service = "/mp_pca_planner/set_parameters_atomically"
    return call(caller, SetParametersAtomically, service, request).result


# What can be sent

TEXTS = st.sampled_from(["", *JOINTS, "wrist", "arm_arm_4", "/", "~", "a\nb"]) | st.text(max_size=9)
NUMBERS = st.floats(-0.3, 0.0) | st.floats()
SERIES = st.lists(NUMBERS, max_size=5)
NAMES = st.just(JOINTS) | st.lists(TEXTS, max_size=5)
INSIDE = st.lists(st.floats(-0.3, 0.0), min_size=4, max_size=4)
HEADERS = st.builds(Header) | st.builds(Header, frame_id=TEXTS)
TIMES = st.builds(Duration, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
# Messages are changed when they are sent, so that none may be drawn twice.
GOOD_STATES = INSIDE.map(lambda values: JointState(name=JOINTS, position=values))
STATES = GOOD_STATES | st.builds(
    JointState, header=HEADERS, name=NAMES, position=SERIES, velocity=SERIES, effort=SERIES
)
POSES = st.builds(
    PoseStamped,
    header=HEADERS,
    pose=st.builds(
        Pose,
        position=st.builds(Point, x=NUMBERS, y=NUMBERS, z=NUMBERS),
        orientation=st.just(Quaternion(w=1.0))
        | st.builds(Quaternion, x=NUMBERS, y=NUMBERS, z=NUMBERS, w=NUMBERS),
    ),
)
GOOD_POINTS = INSIDE.map(lambda values: JointTrajectoryPoint(positions=values))
POINTS = st.builds(
    JointTrajectoryPoint,
    positions=INSIDE | SERIES,
    velocities=st.just([]) | SERIES,
    accelerations=st.just([]) | SERIES,
    effort=st.just([]) | SERIES,
    time_from_start=TIMES,
)
SEQUENCES = st.builds(
    JointTrajectory,
    header=HEADERS,
    joint_names=NAMES,
    points=st.lists(GOOD_POINTS, max_size=3) | st.lists(POINTS, max_size=3),
)
GOALS = STATES | POSES | SEQUENCES

INTEGERS = st.integers(-(2**63), 2**63 - 1)
ANY_VALUE = st.one_of(
    st.none(),
    st.booleans(),
    INTEGERS,
    st.floats(),
    TEXTS,
    *(st.lists(kind, max_size=3) for kind in (st.booleans(), INTEGERS, st.floats(), TEXTS)),
)
ANY_NAME = st.sampled_from(sorted(DECLARED)) | TEXTS.map("limits.{}.max_jerk".format) | TEXTS


def plausible_values(name: str) -> st.SearchStrategy[Any]:
    """Values of the right type."""
    declaration = DECLARED[name]
    if isinstance(declaration.default, bool):
        return st.booleans()
    if isinstance(declaration.default, int):
        return st.integers(declaration.low, declaration.high)
    if isinstance(declaration.default, float):
        return st.floats(declaration.low, declaration.high)
    if isinstance(declaration.default, tuple):
        return st.lists(TEXTS, max_size=2)
    return st.sampled_from(declaration.choices) if declaration.choices else TEXTS


SETTINGS = st.tuples(ANY_NAME, ANY_VALUE) | st.sampled_from(sorted(DECLARED)).flatmap(
    lambda name: st.tuples(st.just(name), plausible_values(name))
)


@settings(max_examples=150)
@given(
    goals=st.lists(GOALS, min_size=1, max_size=2),
    state=st.builds(JointState, name=st.just(JOINTS), position=st.just(START)) | STATES,
)
def test_every_goal_gets_one_report_whatever_it_is(
    client: NodeClient, goals: list[Any], state: JointState
) -> None:
    client.publish_state_message(state)
    client.reports.clear()
    for k, goal in enumerate(goals):
        goal.header.stamp.sec = k + 1
        report = client.send(goal, with_trajectory=False).report
        assert report.message
        assert "internal error" not in report.message
    assert len(client.reports) == len(goals)


def is_valid(declaration: Declaration, value: Any) -> bool:
    default = declaration.default
    if value is None:
        # An empty list has no type, and without primitives there are no joints to limit.
        return isinstance(default, tuple) or declaration.name.startswith(LIMITS_PREFIX)
    if isinstance(default, tuple):
        return all(isinstance(text, str) for text in value)
    if type(default) in (int, float):
        return type(value) is type(default) and declaration.low <= value <= declaration.high
    is_choice = not declaration.choices or value in declaration.choices
    return type(value) is type(default) and is_choice


@settings(max_examples=80)
@given(values=st.lists(SETTINGS, min_size=1, max_size=3))
def test_parameters_stay_valid_whatever_they_are_set_to(
    client: NodeClient, caller: Node, values: list[tuple[str, Any]]
) -> None:
    messages = [as_message(name, value) for name, value in values]
    for result in client.set_parameters(*messages):
        assert result.successful or result.reason
    result = set_at_once(caller, messages)
    assert result.successful or result.reason
    for name, value in get_values(caller).items():
        assert is_valid(DECLARED[name], parameter_value_to_python(value)), name


def test_node_that_was_told_all_that_serves_goals_when_its_parameters_are_as_before(
    client: NodeClient, caller: Node, first_values: list[ParameterMessage]
) -> None:
    # Without primitives there are no limits to be set.
    for values in (first_values[: len(DECLARATIONS)], first_values):
        result = set_at_once(caller, values)
        assert result.successful, result.reason
    client.publish_state(JOINTS, START)
    trajectory = client.send(goal_message()).trajectory
    assert trajectory is not None
    assert list(trajectory.points[-1].positions) == GOAL


# `test/campaigns/node_fuzz.py` does more of these.


@pytest.fixture(scope="module")
def fuzzer(node: subprocess.Popen[str], client: NodeClient) -> Fuzzer:
    return Fuzzer(node, client)


def test_good_goals_are_served_after_garbage_on_every_topic(fuzzer: Fuzzer) -> None:
    fuzzer.send_garbage(60)


def test_good_goals_are_served_after_messages_that_are_far_too_large(fuzzer: Fuzzer) -> None:
    fuzzer.send_too_much()


def test_good_goals_are_served_after_odd_values_of_every_parameter(fuzzer: Fuzzer) -> None:
    fuzzer.set_odd_values(share=25)
