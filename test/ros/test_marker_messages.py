# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Markers: how they are received, read, kept and forgotten."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Duration
from campaigns.stop_latency import soup, write_stl
from geometry_msgs.msg import Point
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from support.domains import set_domain
from support.nodes import ros_node
from support.patience import HANG
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.exceptions import GoalError, WorldError
from mp_pca_planner.robot.world import World
from mp_pca_planner.ros import obstacle_topic
from mp_pca_planner.ros.obstacle_markers import (
    MarkerMessage,
    MarkerMessages,
    MarkerSubscription,
)
from mp_pca_planner.ros.obstacle_topic import ObstacleTopic
from mp_pca_planner.ros.serialised import MarkerData, read_markers

LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=5)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


def box(number: int = 1, **fields: object) -> Marker:
    one = Marker(ns="test", id=number, type=Marker.CUBE)
    one.scale.x = one.scale.y = one.scale.z = 0.1
    for name, value in fields.items():
        setattr(one, name, value)
    return one


def written(*markers: Marker) -> bytes:
    return bytes(serialize_message(MarkerArray(markers=list(markers))))


def read(*markers: Marker) -> list[MarkerData]:
    return read_markers(written(*markers))


# Reading


def test_fields_are_read_as_they_were_written() -> None:
    random = np.random.default_rng(1)
    sent = []
    for k in range(20):
        one = box(k - 5, ns="näme" * k, action=k % 4, mesh_resource="file:///m.stl" * (k % 2))
        one.header.frame_id, one.text, one.texture_resource = "l" * k, "t" * (k % 7), "x" * (k % 3)
        one.mesh_file.filename, one.mesh_file.data = "f" * (k % 5), list(range(k))
        one.texture.data, one.colors = list(range(k % 6)), [ColorRGBA()] * (k % 3)
        one.points = [Point(x=x, y=y, z=z) for x, y, z in random.normal(size=(k, 3)).tolist()]
        one.lifetime = Duration(sec=k, nanosec=500_000_000)
        one.pose.position.x, one.pose.orientation.w, one.scale.y = random.normal(size=3).tolist()
        sent.append(one)
    for one, data in zip(sent, read(*sent), strict=True):
        p, o, s = one.pose.position, one.pose.orientation, one.scale
        assert (data.frame_id, data.ns, data.id) == (one.header.frame_id, one.ns, one.id)
        assert (data.type, data.action) == (one.type, one.action)
        assert (data.lifetime, data.mesh_resource) == (one.lifetime.sec + 0.5, one.mesh_resource)
        np.testing.assert_array_equal(data.pose, [p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        np.testing.assert_array_equal(data.scale, [s.x, s.y, s.z])
        points = np.reshape([(q.x, q.y, q.z) for q in one.points], (-1, 3))
        np.testing.assert_array_equal(data.points, points)


def test_damaged_messages_are_rejected_or_read_and_never_raise_anything_else() -> None:
    content = bytes(serialize_message(MarkerArray(markers=[box(points=[Point()] * 9)] * 2)))
    random = np.random.default_rng(2)
    n_rejected = 0
    for k in range(3000):
        damaged = bytearray(content)
        for at in random.integers(0, len(content), random.integers(1, 6)).tolist():
            damaged[at] = int(random.integers(0, 256))
        try:
            read_markers(bytes(damaged[: len(content) - (k % 3) * int(random.integers(200))]))
        except WorldError:
            n_rejected += 1
    assert 0 < n_rejected < 3000
    for short in (b"", b"\0", b"\0\1\0\0", content[:7]):
        with pytest.raises(WorldError, match="the message of markers is malformed"):
            read_markers(short)


# Keeping


class Kept:
    """The world of a series of markers, at times of the test's own."""

    def __init__(self) -> None:
        self.messages, self.world, self.now, self._stamp = MarkerMessages(), World(), 0.0, 0
        self.problems: list[str] = []

    def send(self, *markers: Marker) -> None:
        self._stamp += 1
        message = written(*markers), self._stamp, False
        self._use(self.messages.apply(self.world, message, folders=(), now=self.now))

    def refresh(self) -> None:
        self._use(self.messages.refresh(self.world, self.now))

    def wait_for_meshes(self) -> None:
        deadline = time.monotonic() + HANG
        while len(set(self.messages.meshes)) > 1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
            self.refresh()

    @property
    def names(self) -> list[str]:
        return sorted(one.name for one in self.world)

    def _use(self, applied: tuple[list, list[str]] | None) -> None:
        if applied is not None:
            self.world, self.problems = World(applied[0]), applied[1]


@pytest.fixture
def kept() -> Iterator[Kept]:
    kept = Kept()
    yield kept
    kept.messages.close()


def test_obstacle_vanishes_at_the_end_of_its_lifetime_unless_it_is_sent_again(kept: Kept) -> None:
    kept.send(box(1, lifetime=Duration(sec=2)), box(2, lifetime=Duration(sec=1)), box(3))
    kept.now = 0.9
    kept.refresh()
    assert kept.names == ["test/1", "test/2", "test/3"]
    kept.send(box(1, lifetime=Duration(sec=2)))
    kept.now = 2.5
    kept.refresh()
    assert kept.names == ["test/1", "test/3"]
    kept.send(box(1))  # without a lifetime now
    kept.now = 1e9
    kept.refresh()
    assert kept.names == ["test/1", "test/3"]


def test_large_meshes_appear_when_they_are_ready_and_others_do_not_wait(
    kept: Kept, tmp_path: Path
) -> None:
    write_stl(tmp_path / "mesh.stl", soup(20_000))
    mesh = f"file://{tmp_path / 'mesh.stl'}"
    kept.send(box(1, type=Marker.MESH_RESOURCE, mesh_resource=mesh), box(2))
    assert kept.names == ["test/2"]
    kept.send(box(3, type=Marker.MESH_RESOURCE, mesh_resource="file:///no/such/mesh.stl"))
    kept.send(box(4, type=Marker.MESH_RESOURCE, mesh_resource=mesh))
    kept.send(box(4))  # in its place
    kept.send(box(5, type=Marker.MESH_RESOURCE, mesh_resource=mesh))
    kept.send(box(5, action=Marker.DELETE))
    kept.wait_for_meshes()
    assert kept.names == ["test/1", "test/2", "test/4"]
    (problem,) = kept.messages.rejected.values()
    assert problem.startswith("marker 'test/3': mesh 'file:///no/such/mesh.stl'")
    assert len({one.name: one for one in kept.world}["test/4"].shapes) == 1


def test_mesh_that_is_sent_again_and_again_becomes_an_obstacle(kept: Kept, tmp_path: Path) -> None:
    write_stl(tmp_path / "mesh.stl", soup(5000))
    one = box(type=Marker.MESH_RESOURCE, mesh_resource=f"file://{tmp_path / 'mesh.stl'}")
    deadline = time.monotonic() + HANG
    while not kept.names:
        kept.send(one)
        kept.refresh()
        assert time.monotonic() < deadline
    assert not kept.problems


# Receiving


class Publisher:
    """A publisher that counts subscriptions which request more than it offers."""

    def __init__(self, node: Node, qos: QoSProfile) -> None:
        self.n_incompatible = 0
        events = PublisherEventCallbacks(incompatible_qos=self._on_incompatible)
        self._publisher = node.create_publisher(MarkerArray, "markers", qos, event_callbacks=events)

    def _on_incompatible(self, _: object) -> None:
        self.n_incompatible += 1

    def send(self, number: int) -> None:
        self._publisher.publish(MarkerArray(markers=[box(number)]))

    @property
    def is_met(self) -> bool:
        return self._publisher.get_subscription_count() > 0


class Listener:
    """A subscription of markers and the node of the publishers, spun together."""

    def __init__(self, node: Node, sender: Node) -> None:
        self.subscription = MarkerSubscription(node, "markers")
        self.numbers: dict[int, MarkerMessage] = {}
        self._executor = SingleThreadedExecutor(context=sender.context)
        self._executor.add_node(sender)

    def until(self, is_done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline
            self._executor.spin_once(0.01)
            for message in self.subscription.poll():
                for marker in read_markers(message[0]):
                    self.numbers[marker.id] = message

    def until_it_hears(self, publisher: Publisher, number: int) -> None:
        def hears() -> bool:
            publisher.send(number)
            return number in self.numbers

        self.until(hears)

    def listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Node, Node]]:
    set_domain(monkeypatch, 71)
    with ros_node("listener") as node, ros_node("sender") as sender:
        yield node, sender


@pytest.mark.parametrize("qos", [RELIABLE, BEST_EFFORT], ids=["reliable", "best_effort"])
def test_publishers_that_latch_nothing_are_not_asked_for_more_than_they_offer(
    nodes: tuple[Node, Node], qos: QoSProfile
) -> None:
    listener, publisher = Listener(*nodes), Publisher(nodes[1], qos)
    listener.until_it_hears(publisher, 1)
    listener.listen(1.0)  # the subscription follows what was discovered
    listener.until_it_hears(publisher, 2)
    assert publisher.n_incompatible == 0


def test_latched_markers_are_heard_late_beside_other_publishers(nodes: tuple[Node, Node]) -> None:
    latched, live = Publisher(nodes[1], LATCHED), Publisher(nodes[1], BEST_EFFORT)
    latched.send(1)
    listener = Listener(*nodes)
    listener.until(lambda: 1 in listener.numbers)
    *_, is_late = listener.numbers[1]
    assert is_late
    listener.until_it_hears(live, 2)
    listener.until_it_hears(latched, 3)
    assert latched.n_incompatible == 0


# Waiting


class Meshes:
    """Markers of which one mesh is still being read."""

    def __init__(self) -> None:
        self.meshes, self.used = (1, 0), (0, 0)
        self.rejected: dict[str, str] = {}

    def refresh(self, *_: object) -> None:
        self.used = self.meshes

    def close(self) -> None:
        pass


@pytest.fixture
def topic(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ObstacleTopic, Meshes]]:
    """The topic without a middleware."""
    meshes, silence = Meshes(), SimpleNamespace(poll=list)
    monkeypatch.setattr(obstacle_topic, "MarkerMessages", lambda: meshes)
    monkeypatch.setattr(obstacle_topic, "MarkerSubscription", lambda *_: silence)
    node = SimpleNamespace(guarded=lambda function: function, seconds=time.monotonic)
    setup = SimpleNamespace(context=None, last_context=None)
    made = ObstacleTopic(node, setup, SimpleNamespace(), None)
    yield made, meshes
    made.close()


def test_goal_waits_until_the_meshes_of_obstacles_are_read_and_used(
    topic: tuple[ObstacleTopic, Meshes],
) -> None:
    waiting, meshes = topic
    looks = iter(range(10_000))

    def is_cancelled() -> bool:
        if next(looks) == 5:
            meshes.meshes = 1, 1
        return False

    waiting.settle(is_cancelled)
    assert meshes.used == (1, 1)
    waiting.settle(lambda: False)  # nothing is waited for


def test_goal_waits_for_meshes_until_it_is_cancelled_or_a_time_is_over(
    topic: tuple[ObstacleTopic, Meshes],
) -> None:
    waiting, _ = topic
    waiting.mesh_timeout = 0.05
    with pytest.raises(GoalError, match="still being read; send the goal again"):
        waiting.settle(lambda: False)
    looks = iter([False, False])
    with pytest.raises(CancelledError):
        waiting.settle(lambda: next(looks, True))
