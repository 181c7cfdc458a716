# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of a running node and a simulated robot, over the middleware."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Quaternion
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from support.arm import JOINTS, arm_primitive, arm_robot
from support.bench import Bench, benched
from support.domains import set_domain
from support.nodes import GOAL, START, URDF, NodeClient, column, running_node, times
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.cli.main import main
from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, World
from mp_pca_planner.ros.markers import Markers, Obstacles, read_markers, to_obstacle
from mp_pca_planner.ros.world_markers import to_obstacle_markers

LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RADIUS, MARGIN = 0.03, 0.01


def marker(number: int, position: np.ndarray, **fields: object) -> Marker:
    one = Marker(ns="test", id=number, type=Marker.SPHERE)
    one.scale.x = one.scale.y = one.scale.z = 2.0 * RADIUS
    one.pose.position.x, one.pose.position.y, one.pose.position.z = map(float, position)
    for name, value in fields.items():
        setattr(one, name, value)
    return one


def deletion(number: int) -> Marker:
    return marker(number, np.zeros(3), action=Marker.DELETE)


class MarkerUser:
    """A user who publishes markers, and sees in the diagnostics what the node made of them."""

    def __init__(self, client: NodeClient, qos: QoSProfile = LATCHED) -> None:
        self._client = client
        name = f"{client.planner}/obstacles"
        self._publisher = client.node.create_publisher(MarkerArray, name, qos)

    def send(self, *markers: Marker) -> None:
        self._publisher.publish(MarkerArray(markers=list(markers)))

    def wait(self, **expected: str) -> None:
        self._client.wait_for_diagnostics(
            lambda values: all(text in values[key] for key, text in expected.items()), HANG
        )

    def meet(self, n: int = 1) -> None:
        """Wait until the node listens on so many subscriptions."""
        self._client.wait(
            lambda: self._publisher.get_subscription_count() >= n, HANG, "does not listen"
        )


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Bench, MarkerUser]]:
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 91)
        with benched(tmp_path_factory.mktemp("robot")) as bench:
            user = MarkerUser(bench.client)
            user.meet()
            yield bench, user


@pytest.fixture
def bench(shared: tuple[Bench, MarkerUser]) -> Bench:
    """The robot at rest at the start, without obstacles."""
    bench, user = shared
    user.send(Marker(action=Marker.DELETEALL))
    user.wait(obstacles="0", obstacle_rejected="none")
    answer = bench.send(START)
    if answer.trajectory is not None:
        bench.execution(answer)
    return bench


@pytest.fixture
def user(shared: tuple[Bench, MarkerUser]) -> MarkerUser:
    return shared[1]


def hand(positions: Sequence[Sequence[float]]) -> np.ndarray:
    robot = arm_robot()
    return robot.frame_positions(np.array(positions), [robot.frame_names[-1]])[:, 0]


def middle(trajectory: JointTrajectory) -> np.ndarray:
    """Where the hand is in the middle of a motion."""
    return hand([trajectory.points[len(trajectory.points) // 2].positions])[0]


def least_clearance(message: JointTrajectory, centre: np.ndarray) -> float:
    """Least distance of the arm from the sphere on a grid of 1 ms."""
    columns = (column(message, kind) for kind in ("positions", "velocities", "accelerations"))
    seconds = 1e-9 * np.array(times(message))
    dense = interpolate(Trajectory(JOINTS, seconds, *columns))
    world = World([Obstacle("ball", Sphere(RADIUS, centre))])
    model = CollisionModel(arm_robot(), world=world, self_collision=False)
    return float(model.near(dense.q, np.inf).distances.min())


def test_goal_is_planned_around_an_obstacle(bench: Bench, user: MarkerUser) -> None:
    through = bench.send(GOAL)
    centre = middle(through.trajectory)
    bench.execution(through)
    bench.execution(bench.send(START))
    user.send(marker(1, centre))
    user.wait(obstacles="1")
    around = bench.send(GOAL)
    assert least_clearance(through.trajectory, centre) < 0.0
    assert least_clearance(around.trajectory, centre) >= MARGIN
    assert bench.execution(around)["outcome"] == "arrived"


@pytest.mark.realtime
def test_goal_in_an_obstacle_is_refused_with_both_names(bench: Bench, user: MarkerUser) -> None:
    user.send(marker(7, hand([GOAL])[0]))
    user.wait(obstacles="1")
    answer = bench.send(GOAL)
    assert answer.trajectory is None
    assert "'lower_arm' and 'test/7'" in answer.report.message
    assert "the goal is in collision" in answer.report.message
    user.send(deletion(7))
    user.wait(obstacles="0")
    bench.arrive(GOAL)


def test_running_motion_leads_around_a_new_obstacle(bench: Bench, user: MarkerUser) -> None:
    goals = (GOAL, START)
    for k in count():
        n, goal = len(bench.client.trajectories), goals[k % 2]
        moving = bench.begin_slowly(goal)
        centre = middle(moving.trajectory)
        user.send(marker(1, centre))
        outcome = bench.execution(moving)["outcome"]
        # On a busy machine, the obstacle or the motion around it may come too late.
        if outcome == "arrived" and len(bench.client.trajectories) > n + 1:
            break
        assert outcome in ("stopped", "arrived") and k < 10
        user.send(deletion(1))
        user.wait(obstacles="0")
    assert least_clearance(bench.client.trajectories[-1], centre) >= MARGIN
    np.testing.assert_allclose(bench.position, goal, atol=1e-3)


@pytest.mark.slow
def test_robot_stops_where_no_motion_leads_around(bench: Bench, user: MarkerUser) -> None:
    moving = bench.begin_slowly(GOAL)
    user.send(marker(1, hand([GOAL])[0]))
    report = bench.execution(moving)
    assert report["outcome"] == "stopped"
    assert "'lower_arm' would hit 'test/1'" in bench.client.executions[-1].message
    assert np.abs(bench.position - GOAL).max() > 0.1


@pytest.mark.slow
def test_markers_that_can_not_be_used_change_nothing(bench: Bench, user: MarkerUser) -> None:
    far = np.array([2.0, 0.0, 0.0])
    user.send(marker(1, far))
    user.wait(obstacles="1", obstacle_rejected="none")
    for reason, bad in (
        ("is nan", marker(1, np.array([np.nan, 0.0, 0.0]))),
        ("type 9 is not supported", marker(1, far, type=Marker.TEXT_VIEW_FACING)),
        ("action is 8", marker(1, far, action=8)),
        ("not found", marker(1, far, type=Marker.MESH_RESOURCE, mesh_resource="package://x/y")),
    ):
        user.send(bad, marker(2, far))
        user.wait(obstacles="2", obstacle_rejected=reason)
        user.send(deletion(2))  # of another obstacle: the rejected one is still not avoided
        user.wait(obstacles="1", obstacle_rejected=reason)
        user.send(marker(1, far))
        user.wait(obstacles="1", obstacle_rejected="none")


def test_obstacles_that_are_too_many_leave_those_before_alone(
    bench: Bench, user: MarkerUser
) -> None:
    many = [Point(x=5.0 + k, y=0.0, z=0.0) for k in range(600)]
    first, second = (marker(k, np.zeros(3), type=Marker.SPHERE_LIST, points=many) for k in (1, 2))
    user.send(first)
    user.wait(obstacles="1", obstacle_rejected="none")
    user.send(second)
    user.wait(obstacles="1", obstacle_rejected="1200 shapes")
    user.send(deletion(1))
    user.wait(obstacles="0")


SCENE = """world:
  collision_objects:
    - id: ball
      pose: {{position: {{x: {:.6f}, y: {:.6f}, z: {:.6f}}}}}
      primitives: [{{type: 2, dimensions: [{}]}}]
"""


def test_a_scene_is_sent_by_a_command_and_removed(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = bench.send(GOAL)
    centre = middle(answer.trajectory)
    bench.execution(answer)
    bench.execution(bench.send(START))
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.format(*centre, RADIUS))
    assert main(["send_obstacles", str(scene), "--json"]) == 0
    sent = json.loads(capsys.readouterr().out)
    assert (sent["sent"], sent["obstacles_of_the_node"], sent["rejected"]) == (["ball"], 1, "")
    around = bench.send(GOAL)
    assert least_clearance(around.trajectory, centre) > 0.99 * MARGIN
    bench.execution(around)
    assert main(["send_obstacles", "--clear"]) == 0
    bench.client.wait_for_diagnostics(lambda values: values["obstacles"] == "0", HANG)
    assert main(["send_obstacles"]) == 2
    assert "give a FILE, or --clear" in capsys.readouterr().err


def test_goals_warn_of_an_obstacle_that_is_not_avoided(bench: Bench, user: MarkerUser) -> None:
    user.send(marker(1, np.zeros(3), type=Marker.ARROW))
    user.wait(obstacle_rejected="type 0 is not supported")
    report = bench.send(GOAL).report
    assert report.level == DiagnosticStatus.WARN
    assert "an obstacle is not avoided: marker 'test/1': type 0" in report.message


@pytest.mark.slow
def test_obstacle_in_an_unknown_frame_rejects_goals_until_the_frame_is_known(
    bench: Bench, user: MarkerUser
) -> None:
    in_map = marker(1, hand([GOAL])[0] + [0.0, 0.0, 1.0], header=Header(frame_id="/map"))
    user.send(in_map)
    user.wait(obstacles="0", obstacle_rejected="'test/1' is stated in the frame 'map'")
    refused = bench.send(GOAL)
    assert refused.trajectory is None
    assert "the frame 'map', which is not a link of the robot" in refused.report.message
    assert "set the parameter 'fixed_frames'" in refused.report.message
    bench.set(unplaced_obstacles="warn")
    warned = bench.send(GOAL)
    assert warned.report.level == DiagnosticStatus.WARN
    assert "an obstacle is not avoided: obstacle 'test/1'" in warned.report.message
    assert bench.execution(warned)["outcome"] == "arrived"
    bench.arrive(START)
    bench.set(unplaced_obstacles="refuse", fixed_frames=["map: 0 0 -1"])
    user.wait(obstacles="1", obstacle_rejected="none")
    assert "'lower_arm' and 'test/1'" in bench.send(GOAL).report.message
    bench.set(fixed_frames=["map: 0 0 3"])
    # The obstacle follows its frame within a moment.
    bench.wait(lambda: bench.send(GOAL).trajectory is not None)
    bench.set(fixed_frames=[""])
    user.wait(obstacles="0", obstacle_rejected="'map'")


@pytest.mark.slow
def test_latched_markers_are_heard_late_and_best_effort_ones_live(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 92)
    far = np.array([2.0, 0.0, 0.0])
    with NodeClient() as client:
        late, live = MarkerUser(client), MarkerUser(client, BEST_EFFORT)
        late.send(marker(1, far), marker(2, far))
        late.send(deletion(2))
        with running_node(tmp_path / "log.txt"):
            late.wait(obstacles="1")
            live.meet()
            live.send(marker(3, far))
            live.wait(obstacles="2")


@pytest.mark.slow
def test_missing_mesh_of_the_robot_is_logged_once_however_often_obstacles_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 93)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    shape = '<collision><geometry><mesh filename="/no/such/hand.stl"/></geometry></collision>'
    urdf, log = URDF.replace("</inertial>", f"</inertial>{shape}"), tmp_path / "log.txt"
    with NodeClient() as client:
        user = MarkerUser(client)
        with running_node(log, "-p", f"primitives:=['{tmp_path / 'arm.npz'}']"):
            client.wait_for_node()
            client.publish_description(urdf)
            client.wait_for_model()
            user.meet()
            for _ in range(4):  # diagnostics come once a second, by the node's own clock
                n = len(client.diagnostics)
                user.send(marker(1, np.array([2.0, 0.0, 0.0])))
                client.wait(lambda n=n: len(client.diagnostics) > n + 1, HANG, "has no diagnostics")
            user.wait(obstacles="1")
    errors = [line for line in log.read_text().splitlines() if "[ERROR]" in line]
    assert len(errors) == 1, errors
    assert "/no/such/hand.stl" in errors[0]


# Markers


def written(*markers: Marker) -> bytes:
    return bytes(serialize_message(MarkerArray(markers=list(markers))))


def obstacle_of(one: Marker) -> Obstacle:
    return to_obstacle(*read_markers(written(one)))


def test_a_world_as_markers_is_as_near_the_robot_as_before() -> None:
    turned, corners = [0.5, 0.5, 0.5, 0.5], [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]
    shapes = (
        Box([0.1, 0.2, 0.3], [0.5, 0.1, 0.2], turned),
        Sphere(0.07, [0.3, -0.4, 0.1]),
        Cylinder(0.05, 0.3, [-0.2, 0.4, 0.3], turned),
        Capsule(0.05, 0.3, [0.4, 0.4, -0.3], turned),
        Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], [0.1, 0.1, 0.6], turned),
    )
    world = World([Obstacle(type(shape).__name__, shape) for shape in shapes])
    content = bytes(serialize_message(to_obstacle_markers(world)))
    markers = World([to_obstacle(one) for one in read_markers(content)])
    rng, robot = np.random.default_rng(0), arm_robot()
    q = rng.uniform(-0.4, 0.4, (20, robot.n_joints)) + START

    def clearances(of: World, name: str) -> np.ndarray:
        some = World([one for one in of if one.name.split("/")[0] == name])
        model = CollisionModel(robot, world=some, self_collision=False)
        return model.near(q, np.inf).distances.reshape(len(q), -1).min(axis=1)

    for name in world.names:
        np.testing.assert_allclose(
            clearances(markers, name), clearances(world, name), atol=1e-6, err_msg=name
        )


def test_lists_become_one_shape_per_point_in_the_pose_of_the_marker() -> None:
    turned = Quaternion(z=np.sqrt(0.5), w=np.sqrt(0.5))
    one = marker(1, np.array([1.0, 0.0, 0.0]), type=Marker.CUBE_LIST)
    one.pose.orientation, one.header.frame_id = turned, "lower_arm"
    one.points = [Point(x=1.0), Point(x=2.0)]
    obstacle = obstacle_of(one)
    assert (obstacle.name, obstacle.frame) == ("test/1", "lower_arm")
    positions = [shape.position for shape in obstacle.shapes]
    np.testing.assert_allclose(positions, [[1.0, 1.0, 0.0], [1.0, 2.0, 0.0]], atol=1e-12)


def test_triangles_are_scaled_before_they_are_moved() -> None:
    one = marker(1, np.array([1.0, 0.0, 0.0]), type=Marker.TRIANGLE_LIST)
    one.scale.x, one.scale.y, one.scale.z = 2.0, 3.0, 4.0
    one.points = [Point(), Point(x=1.0), Point(y=1.0)]
    (mesh,) = obstacle_of(one).shapes
    assert isinstance(mesh, Mesh)
    np.testing.assert_allclose(mesh.vertices, [[0, 0, 0], [2, 0, 0], [0, 3, 0]])
    one.points = one.points[:2]
    with pytest.raises(WorldError, match="3 points per triangle, got 2"):
        obstacle_of(one)


@pytest.mark.parametrize("scale", [(0.0, 0.0, 0.0), (1.0, 1.0, 0.0)])
def test_a_scale_of_zero_is_refused(scale: tuple[float, ...]) -> None:
    one = marker(1, np.zeros(3), type=Marker.TRIANGLE_LIST)
    one.scale.x, one.scale.y, one.scale.z = scale
    one.points = [Point(), Point(x=1.0), Point(y=1.0)]
    with pytest.raises(WorldError, match=r"marker 'test/1': scale of a mesh must not be 0, got"):
        obstacle_of(one)


@pytest.mark.parametrize("name", ["bad.stl", "bad.dae", "bad.irr"])
def test_a_mesh_of_a_bad_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"solid of nothing")
    one = marker(
        1, np.zeros(3), type=Marker.MESH_RESOURCE, mesh_resource=f"file://{tmp_path}/{name}"
    )
    with pytest.raises(WorldError, match=rf"marker 'test/1': mesh '.*{name}' can't be read: "):
        obstacle_of(one)


def test_names_of_deleted_markers_are_forgotten_in_the_end() -> None:
    obstacles, kept = Obstacles(), marker(0, np.zeros(3))
    obstacles.use(assemble_model(URDF, [arm_primitive()], Settings()))
    for k in range(3 * obstacles.most):
        added, gone = marker(k + 1, np.zeros(3)), deletion(k + 1)
        for stamp, sent in ((2 * k + 1, [kept, added]), (2 * k + 2, [gone])):
            obstacles.apply(Markers(written(*sent), stamp, False, 0.0))
    assert obstacles.world.names == ("test/0",)
    assert len(obstacles._changed) <= obstacles.most + 1
    # What was deleted last does not come back with an older latched message.
    late = written(marker(3 * obstacles.most, np.zeros(3)))
    obstacles.apply(Markers(late, 1, True, 0.0))
    assert obstacles.world.names == ("test/0",)


def test_a_marker_with_a_huge_name_is_refused() -> None:
    one, obstacles = marker(1, np.zeros(3)), Obstacles()
    one.ns = "x" * 100_000
    obstacles.use(assemble_model(URDF, [arm_primitive()], Settings()))
    obstacles.apply(Markers(written(one), 1, False, 0.0))
    text = "a marker's name has 100002 characters, at most 500 are used"
    assert obstacles.facts.missing == text
    assert len(obstacles.world) == 0


def test_an_ellipsoid_is_refused() -> None:
    one = marker(1, np.zeros(3))
    one.scale.x = 1.0
    with pytest.raises(WorldError, match=r"marker 'test/1': the diameters of a sphere must be"):
        obstacle_of(one)
