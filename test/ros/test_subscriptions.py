# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages are polled, or handled in a thread of their own, whatever the executor does."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64, String
from support.domains import set_domain
from support.nodes import ros_node
from support.patience import HANG

from mp_pca_planner.ros.nodes import GroupExecutor, PolledSubscription, ThreadGroup

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


def wait_for(received: list[float], *expected: float) -> None:
    deadline = time.monotonic() + HANG
    while received != list(expected) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert received == list(expected)


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


@pytest.mark.parametrize("gives_way", [True, False])
def test_thread_that_gives_way_sleeps_after_each_large_message(
    node: Node, monkeypatch: pytest.MonkeyPatch, gives_way: bool
) -> None:
    subscription = PolledSubscription(node, String, "here", DEPTH, gives_way=gives_way)
    publisher = matched_publisher(node, "here", String)
    for length in (10, 1_000_000, 10, 2_000_000):
        publisher.publish(String(data="a" * length))
    assert publisher.wait_for_all_acked(Duration(seconds=HANG))
    naps: list[float] = []
    with monkeypatch.context() as during:
        during.setattr(time, "sleep", naps.append)
        assert len(subscription.poll()) == 4
    assert naps == (pytest.approx([2e-3, 4e-3], rel=1e-3) if gives_way else [])


def test_messages_of_all_topics_of_a_group_are_handled_without_an_executor(node: Node) -> None:
    group, received = ThreadGroup(), []
    for topic in ("here", "there"):
        node.create_subscription(
            Float64, topic, lambda m: received.append(m.data), DEPTH, callback_group=group
        )
    here, there = (matched_publisher(node, topic) for topic in ("here", "there"))
    executor = GroupExecutor(node, group)
    here.publish(Float64(data=1.0))
    wait_for(received, 1.0)
    there.publish(Float64(data=2.0))
    wait_for(received, 1.0, 2.0)
    executor.shutdown()
    here.publish(Float64(data=3.0))
    time.sleep(0.2)
    assert received == [1.0, 2.0]


def test_callback_that_raises_does_not_end_the_thread(node: Node) -> None:
    group, received = ThreadGroup(), []

    def receive(message: Float64) -> None:
        received.append(message.data)
        raise ValueError("a defect")

    node.create_subscription(Float64, "here", receive, DEPTH, callback_group=group)
    publisher = matched_publisher(node, "here")
    executor = GroupExecutor(node, group)
    for number in (1.0, 2.0):
        publisher.publish(Float64(data=number))
        assert publisher.wait_for_all_acked(Duration(seconds=HANG))
    wait_for(received, 1.0, 2.0)
    executor.shutdown()


def test_thread_ends_with_its_context(node: Node) -> None:
    group = ThreadGroup()
    executor = GroupExecutor(node, group)
    rclpy.shutdown(context=node.context)
    assert isinstance(group.thread, threading.Thread)
    group.thread.join(HANG)
    assert not group.thread.is_alive()
    executor.shutdown()
