# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Markers: how they are received, read, kept and forgotten."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Quaternion, Vector3
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import ColorRGBA, Header
from support.arm import arm_primitive
from support.domains import set_domain
from support.hostile_meshes import soup, write_stl
from support.nodes import URDF, ros_node
from support.patience import HANG
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.ros import markers, obstacles
from mp_pca_planner.ros.markers import Frames, MarkerData, Markers, Obstacles, read_markers
from mp_pca_planner.ros.obstacles import MarkerMessage, MarkerSubscription

MODEL = assemble_model(URDF, [arm_primitive()], Settings())

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
    """The obstacles of a series of markers, at times of the test's own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.obstacles, self.now, self._stamp = Obstacles(), 0.0, 0
        self.obstacles.use(MODEL)
        monkeypatch.setattr(markers.time, "monotonic", lambda: self.now)

    def send(self, *sent: Marker) -> None:
        self._stamp += 1
        self.obstacles.apply(Markers(written(*sent), self._stamp, False, 0.0))

    @property
    def names(self) -> list[str]:
        return sorted(one.name for one in self.obstacles.world)


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> Kept:
    return Kept(monkeypatch)


def test_obstacle_vanishes_at_the_end_of_its_lifetime_unless_it_is_sent_again(kept: Kept) -> None:
    kept.send(box(1, lifetime=Duration(sec=2)), box(2, lifetime=Duration(sec=1)), box(3))
    kept.now = 0.9
    assert not kept.obstacles.refresh()
    assert kept.names == ["test/1", "test/2", "test/3"]
    kept.send(box(1, lifetime=Duration(sec=2)))
    kept.now = 2.5
    assert kept.obstacles.refresh()
    assert kept.names == ["test/1", "test/3"]
    kept.send(box(1))  # without a lifetime now
    kept.now = 1e9
    assert not kept.obstacles.refresh()
    assert kept.names == ["test/1", "test/3"]


def test_meshes_are_obstacles_and_one_that_is_missing_is_named(kept: Kept, tmp_path: Path) -> None:
    write_stl(tmp_path / "mesh.stl", soup(2000))
    mesh = f"file://{tmp_path / 'mesh.stl'}"
    kept.send(box(1, type=Marker.MESH_RESOURCE, mesh_resource=mesh), box(2))
    kept.send(box(3, type=Marker.MESH_RESOURCE, mesh_resource="file:///no/such/mesh.stl"))
    assert kept.names == ["test/1", "test/2"]
    missing = "marker 'test/3': mesh 'file:///no/such/mesh.stl'"
    assert kept.obstacles.facts.missing.startswith(missing)
    kept.send(box(3))
    assert kept.names == ["test/1", "test/2", "test/3"]
    assert not kept.obstacles.facts.missing


def test_obstacle_in_a_frame_that_is_turned_is_where_that_frame_says(kept: Kept) -> None:
    rng = np.random.default_rng(3)
    turned, camera = Rotation.random(2, rng=rng)
    p, at = rng.normal(size=(2, 3))
    one = box(1, scale=Vector3(x=0.1, y=0.2, z=0.3), header=Header(frame_id="/camera"))
    one.pose.position = Point(**dict(zip("xyz", p.tolist(), strict=True)))
    one.pose.orientation = Quaternion(**dict(zip("xyzw", turned.as_quat().tolist(), strict=True)))
    kept.send(one)
    assert kept.obstacles.facts.frames == ("camera",)
    assert "in the frame 'camera', which is not a link" in kept.obstacles.unplaced
    kept.obstacles.use_frames(Frames({"camera": np.array([*at, *camera.as_quat()])}))
    assert not kept.obstacles.unplaced
    ((shape,),) = (obstacle.shapes for obstacle in kept.obstacles.world)
    np.testing.assert_allclose(shape.position, at + camera.apply(p), atol=1e-12)
    found = Rotation.from_quat(shape.orientation)
    assert (found.inv() * camera * turned).magnitude() < 1e-9
    # A frame that goes makes it unknown again.
    kept.obstacles.use_frames(Frames({"camera": None}))
    assert "in the frame 'camera'" in kept.obstacles.unplaced


def test_obstacles_survive_the_way_to_another_worker(kept: Kept, tmp_path: Path) -> None:
    write_stl(tmp_path / "mesh.stl", soup(2000))
    mesh = f"file://{tmp_path / 'mesh.stl'}"
    kept.send(box(1, type=Marker.MESH_RESOURCE, mesh_resource=mesh), box(2))
    other = pickle.loads(pickle.dumps(kept.obstacles))
    other.use(MODEL)
    assert [one.name for one in other.world] == [one.name for one in kept.obstacles.world]
    other.apply(Markers(written(box(2, action=Marker.DELETE)), 9, False, 0.0))
    assert [one.name for one in other.world] == ["test/1"]


def test_lost_obstacles_are_unknown_until_markers_come(kept: Kept) -> None:
    kept.obstacles.lose("they were lost")
    kept.obstacles.use(MODEL)
    assert kept.obstacles.unplaced == "they were lost"
    kept.send(box(1))
    assert not kept.obstacles.unplaced


# Over the middleware


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


def test_latched_markers_are_heard_late_beside_other_publishers(
    nodes: tuple[Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    latched, live = Publisher(nodes[1], LATCHED), Publisher(nodes[1], BEST_EFFORT)
    latched.send(1)
    listener = Listener(*nodes)
    listener.until(lambda: 1 in listener.numbers)
    *_, is_late = listener.numbers[1]
    assert is_late
    listener.until_it_hears(live, 2)
    listener.until_it_hears(latched, 3)
    assert latched.n_incompatible == 0
    # In the end, one subscription is left.
    later = SimpleNamespace(monotonic=lambda: time.monotonic() + 60.0)
    monkeypatch.setattr(obstacles, "time", later)
    listener.until(lambda: nodes[1].count_subscribers("markers") == 1)
