# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages that are polled wait for that, whatever the executor does."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from support.domains import set_domain
from support.nodes import ros_node
from support.patience import HANG

from mp_pca_planner.ros import nodes
from mp_pca_planner.ros.live_node import JointStateSource
from mp_pca_planner.ros.nodes import PolledSubscription, message_age, thinned

DEPTH = 5


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    set_domain(monkeypatch, 75)
    with ros_node("planner") as node:
        yield node


def matched_publisher(node: Node, topic: str, kind: type = Float64) -> Publisher:
    publisher = node.create_publisher(kind, topic, 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    return publisher


def test_polled_messages_wait_for_the_poll_the_newest_last(node: Node) -> None:
    subscription = PolledSubscription(node, Float64, "here", DEPTH)
    publisher = matched_publisher(node, "here")
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    for number in range(8):
        publisher.publish(Float64(data=float(number)))
    assert publisher.wait_for_all_acked(Duration(seconds=HANG))
    executor.spin_once(0.1)
    polled = [deserialize_message(content, Float64).data for content, _ in subscription.poll()]
    assert polled == [3.0, 4.0, 5.0, 6.0, 7.0]
    assert subscription.poll() == []
    executor.shutdown()


@pytest.mark.parametrize(
    ("wall_clock", "age"), [(1000.25, 0.25), (4600.0, 0.4), (970.0, 0.0)], ids=str
)
def test_age_of_a_message_is_bounded_where_the_wall_clock_is_set(
    monkeypatch: pytest.MonkeyPatch, wall_clock: float, age: float
) -> None:
    monkeypatch.setattr(nodes.time, "time_ns", lambda: round(1e9 * wall_clock))
    facts = {"received_timestamp": 1000 * 10**9}
    assert message_age(facts, 0.4) == pytest.approx(age)
    assert message_age({"received_timestamp": 0}, 0.4) == 0.0  # a middleware that does not say


def test_states_at_1_khz_are_thinned_and_the_newest_of_each_source_kept() -> None:
    def taken(name: str, time: int) -> tuple[bytes, dict[str, int]]:
        message = JointState(name=[name], position=[0.1])
        message.header.stamp.nanosec = time
        return bytes(serialize_message(message)), {"received_timestamp": time}

    arm = [taken("shoulder_of_the_left_arm_of_the_robot_at_work", 10**6 * k) for k in range(1, 51)]
    gripper = [taken("finger_of_the_gripper_of_the_robot_at_work_", 10**6 * 25)]
    found = thinned([*arm[:25], *gripper, *arm[25:]])
    assert found == [arm[0], arm[10], arm[20], *gripper, arm[30], arm[40], arm[49]]
    unknown = [(content, {"received_timestamp": 0}) for content, _ in arm]
    assert thinned(unknown) == unknown


def test_topic_that_nobody_publishes_on_is_named_beside_the_others(node: Node) -> None:
    node.create_publisher(JointState, "/joint_states", 10)
    deadline = time.monotonic() + HANG
    with JointStateSource("/typo") as typo, JointStateSource("/joint_states") as right:
        # Each finds the publisher in its own time.
        while "'/joint_states'" not in typo.silence() or "no node" in right.silence():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        text = "no node publishes on '/typo' yet; topics with joint states: '/joint_states'"
        assert typo.silence() == text
        assert right.silence() == "nothing has been received on '/joint_states' yet"
