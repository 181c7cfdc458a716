# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals are taken as soon as they come, whatever the executor does, until the intake is closed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from nodes import ros_node, set_domain
from patience import HANG
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64

from mp_pca_planner.ros.goal_intake import FetchedByHand, GoalIntake, Inlet

DEPTH = 5


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    set_domain(monkeypatch, 75)
    with ros_node("planner") as node:
        yield node


class Kitchen:
    """Notes what it gets."""

    def __init__(self, node: Node, topic: str) -> None:
        self.got: list[list[float]] = []
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        subscription = node.create_subscription(
            Float64, topic, lambda _: None, DEPTH, callback_group=FetchedByHand()
        )
        self.inlet = Inlet(subscription, self._receive)
        self.publisher = node.create_publisher(Float64, topic, 10)
        while not self.publisher.get_subscription_count():
            time.sleep(0.01)

    def _receive(self, messages: list[Float64]) -> None:
        self.got.append([message.data for message in messages])
        self.may_go_on.wait(HANG)

    def wait_for(self, *expected: list[float]) -> None:
        deadline = time.monotonic() + HANG
        while self.got != list(expected) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert self.got == list(expected)


def test_messages_of_all_topics_are_handed_over_without_an_executor(node: Node) -> None:
    here, there = Kitchen(node, "here"), Kitchen(node, "there")
    intake = GoalIntake(node.context, [here.inlet, there.inlet])
    here.publisher.publish(Float64(data=1.0))
    here.wait_for([1.0])
    there.publisher.publish(Float64(data=2.0))
    there.wait_for([2.0])
    assert here.got == [[1.0]]
    intake.close()
    here.publisher.publish(Float64(data=3.0))
    time.sleep(0.2)
    assert here.got == [[1.0]]


def test_what_comes_meanwhile_is_handed_over_together_the_newest_last(node: Node) -> None:
    kitchen = Kitchen(node, "here")
    intake = GoalIntake(node.context, [kitchen.inlet])
    kitchen.may_go_on.clear()
    kitchen.publisher.publish(Float64(data=0.0))
    kitchen.wait_for([0.0])
    for number in range(1, 8):
        kitchen.publisher.publish(Float64(data=float(number)))
    assert kitchen.publisher.wait_for_all_acked(Duration(seconds=HANG))
    kitchen.may_go_on.set()
    kitchen.wait_for([0.0], [3.0, 4.0, 5.0, 6.0, 7.0])
    intake.close()


def test_intake_ends_with_its_context(node: Node) -> None:
    kitchen = Kitchen(node, "here")
    intake = GoalIntake(node.context, [kitchen.inlet])
    rclpy.shutdown(context=node.context)
    intake._thread.join(HANG)
    assert not intake._thread.is_alive()
    intake.close()
