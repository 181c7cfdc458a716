# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Markers: how they are received, read, kept and forgotten."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from support.arm import URDF, arm_primitive
from support.domains import set_domain
from support.hostile_meshes import soup, write_stl
from support.nodes import START, ros_node
from support.patience import HANG
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, World
from mp_pca_planner.ros import markers, obstacles
from mp_pca_planner.ros.markers import (
    Frames,
    Markers,
    Obstacles,
    read_markers,
    to_obstacle,
)
from mp_pca_planner.ros.obstacles import MarkerSubscription
from mp_pca_planner.ros.world_markers import to_obstacle_markers

MODEL = assemble_model(URDF, [arm_primitive()], Settings())

LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


POINTS = [Point(), Point(x=1.0), Point(y=1.0)]


def box(number: int = 1, **fields: object) -> Marker:
    one = Marker(ns="test", id=number, type=Marker.CUBE)
    one.scale.x = one.scale.y = one.scale.z = 0.1
    for name, value in fields.items():
        setattr(one, name, value)
    return one


def written(*markers: Marker) -> bytes:
    return bytes(serialize_message(MarkerArray(markers=list(markers))))


def read(*markers: Marker) -> list[Marker]:
    return read_markers(written(*markers))


def test_a_world_as_markers_is_as_near_the_robot_as_before() -> None:
    turned, corners = [0.5, 0.5, 0.5, 0.5], [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]
    shapes = (
        Box([0.1, 0.2, 0.3], [0.5, 0.1, 0.2], turned),
        Sphere(0.07, [0.3, -0.4, 0.1]),
        Cylinder(0.05, 0.3, [-0.2, 0.4, 0.3], turned),
        Capsule(0.05, 0.3, [0.4, 0.4, -0.3], turned),
        Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], [0.1, 0.1, 0.6], turned),
    )
    q = np.random.default_rng(0).uniform(-0.4, 0.4, (20, MODEL.robot.n_joints)) + START

    def clearances(*obstacles: Obstacle) -> np.ndarray:
        model = CollisionModel(MODEL.robot, world=World(obstacles), self_collision=False)
        return model.near(q, np.inf).distances.reshape(len(q), -1).min(axis=1)

    for shape in shapes:
        obstacle = Obstacle("one", shape)
        content = bytes(serialize_message(to_obstacle_markers(World([obstacle]))))
        found = clearances(*map(to_obstacle, read_markers(content)))
        np.testing.assert_allclose(found, clearances(obstacle), atol=1e-6, err_msg=repr(shape))


def test_points_of_lists_are_moved_and_those_of_triangles_scaled_before() -> None:
    turned = Pose(position=Point(x=1.0), orientation=Quaternion(z=0.5**0.5, w=0.5**0.5))
    fields = {"pose": turned, "header": Header(frame_id="lower_arm"), "points": POINTS[1:]}
    obstacle = to_obstacle(*read(box(type=Marker.CUBE_LIST, **fields)))
    assert (obstacle.name, obstacle.frame) == ("test/1", "lower_arm")
    positions = [shape.position for shape in obstacle.shapes]
    np.testing.assert_allclose(positions, [[1.0, 1.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)
    scale = Vector3(x=2.0, y=3.0, z=4.0)
    (mesh,) = to_obstacle(*read(box(type=Marker.TRIANGLE_LIST, points=POINTS, scale=scale))).shapes
    np.testing.assert_allclose(mesh.vertices, [[0, 0, 0], [2, 0, 0], [0, 3, 0]])


# Keeping


class Kept:
    """The obstacles of a series of markers, at times of the test's own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.obstacles, self.now, self._stamp = Obstacles(), 0.0, 0
        self.obstacles.use(MODEL)
        monkeypatch.setattr(markers.time, "monotonic", lambda: self.now)

    def send(self, *sent: Marker) -> None:
        self._stamp += 1
        self.obstacles.apply(Markers(written(*sent), self._stamp, False))

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


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"pose": Pose(position=Point(x=np.nan))}, "is nan"),
        ({"type": Marker.TEXT_VIEW_FACING}, "type 9 is not supported"),
        ({"action": 8}, "its action is 8"),
        ({"type": Marker.MESH_RESOURCE, "mesh_resource": "package://x/y"}, "not found"),
        ({"type": Marker.MESH_RESOURCE, "mesh_resource": "file://{}/bad.dae"}, "can't be read: "),
        ({"type": Marker.TRIANGLE_LIST, "points": POINTS[:2]}, "3 points per triangle, got 2"),
        ({"type": Marker.TRIANGLE_LIST, "points": POINTS, "scale": Vector3()}, "must not be 0"),
        ({"type": Marker.SPHERE, "scale": Vector3(x=1.0, y=0.1, z=0.1)}, "diameters of a sphere"),
        ({"type": Marker.SPHERE_LIST, "points": [*POINTS * 333, Point()]}, "got 1001"),
    ],
)
def test_marker_that_can_not_be_used_changes_nothing_and_is_named_until_it_is_mended(
    kept: Kept, tmp_path: Path, fields: dict[str, Any], reason: str
) -> None:
    (tmp_path / "bad.dae").write_bytes(b"solid of nothing")
    if "mesh_resource" in fields:
        fields = fields | {"mesh_resource": fields["mesh_resource"].format(tmp_path)}
    kept.send(box(1), box(2))
    kept.send(box(1, **fields))
    assert kept.names == ["test/1", "test/2"]
    assert reason in kept.obstacles.facts.missing
    kept.send(box(2, action=Marker.DELETE))  # another one: the rejected one is still not avoided
    kept.send(box(1))
    assert kept.names == ["test/1"]
    assert not kept.obstacles.facts.missing


def test_malformed_messages_are_named_and_names_bounded_in_length_and_number(kept: Kept) -> None:
    for content in (b"\0\1\0\0", b"\0\1\0\0" + (8000).to_bytes(4, "little") + bytes(8000)):
        kept.obstacles.apply(Markers(content, 0, False))
        assert "the message of markers" in kept.obstacles.facts.missing
    kept.obstacles.apply(Markers(bytes(8_000_001), 0, False))
    assert "8000001 bytes, at most 8000000 are accepted" in kept.obstacles.facts.missing
    kept.send(box(ns="x" * 100_000))
    text = "a marker's name has 100002 characters, at most 500 are used"
    assert kept.obstacles.facts.missing == text and not kept.names
    kept.send(Marker(action=Marker.DELETEALL))
    for k in range(3 * kept.obstacles.most):
        kept.send(box(k + 1), box(0))
        kept.send(box(k + 1, action=Marker.DELETE))
    assert kept.names == ["test"]
    assert len(kept.obstacles._changed) <= kept.obstacles.most + 1
    # What was deleted last does not come back with an older latched message.
    kept.obstacles.apply(Markers(written(box(3 * kept.obstacles.most)), -1, True))
    assert kept.names == ["test"]


def test_obstacles_of_a_robot_without_its_meshes_are_kept_and_said_not_to_be_avoided() -> None:
    shape = '<collision><geometry><mesh filename="/no/such/hand.stl"/></geometry></collision>'
    urdf, obstacles = URDF.replace("</inertial>", f"</inertial>{shape}"), Obstacles()
    obstacles.use(assemble_model(urdf, [arm_primitive()], Settings()))
    obstacles.apply(Markers(written(box()), 1, False))
    assert obstacles.world.names == ("test/1",)
    assert "/no/such/hand.stl" in obstacles.facts.missing


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


class Listener:
    """A subscription of markers and the node of the publishers, spun together."""

    def __init__(self, node: Node, sender: Node) -> None:
        self.subscription = MarkerSubscription(node, "markers")
        self.numbers: dict[int, Markers] = {}
        self._executor = SingleThreadedExecutor(context=sender.context)
        self._executor.add_node(sender)

    def until(self, is_done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline
            self._executor.spin_once(0.01)
            for message in self.subscription.poll():
                for marker in read_markers(message.content):
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


def test_publishers_that_latch_nothing_are_not_asked_for_more_than_they_offer(
    nodes: tuple[Node, Node],
) -> None:
    listener, publisher = Listener(*nodes), Publisher(nodes[1], BEST_EFFORT)
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
    assert listener.numbers[1].is_late
    listener.until_it_hears(live, 2)
    listener.until_it_hears(latched, 3)
    assert latched.n_incompatible == 0
    # In the end, one subscription is left.
    later = SimpleNamespace(monotonic=lambda: time.monotonic() + 60.0)
    monkeypatch.setattr(obstacles, "time", later)
    listener.until(lambda: nodes[1].count_subscribers("markers") == 1)
