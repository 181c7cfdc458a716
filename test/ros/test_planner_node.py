# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node in a process of its own, talked to over real topics and services."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from support.arm import JOINTS, arm_demonstrations, arm_primitive, arm_robot
from support.domains import set_domain
from support.forged import forge
from support.nodes import (
    GOAL,
    PATIENCE,
    PATIENTLY,
    START,
    URDF,
    NodeClient,
    column,
    described_client,
    goal_message,
    ros_node,
    running_node,
    start_node,
    times,
)
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from mp_pca_planner.cli.main import main
from mp_pca_planner.execution.parameters import DECLARATIONS, limit_declarations
from mp_pca_planner.motion.collision import Collision, CollisionModel
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.ros.client import Answer

# Motions from rest start so long after the stamp of their message [ns].
WAIT = 20_000_000
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture(scope="module")
def primitives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the primitives arm_arm_4 and arm_joint_4."""
    folder = tmp_path_factory.mktemp("primitives")
    for coupling in ("arm", "joint"):
        save_primitive(arm_primitive(coupling), folder / f"{coupling}.npz")
    return folder


@pytest.fixture(scope="module")
def node(
    primitives: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[subprocess.Popen[str]]:
    """The node that most tests share."""
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 0)
        log = tmp_path_factory.mktemp("log") / "node.txt"
        arguments = ("-p", f"primitives:=['{primitives}']", *PATIENTLY)
        with running_node(log, *arguments) as process:
            yield process


@pytest.fixture(scope="module")
def shared_client(node: subprocess.Popen[str]) -> Iterator[NodeClient]:
    with described_client() as client:
        yield client


@pytest.fixture
def client(shared_client: NodeClient, primitives: Path) -> NodeClient:
    """A client of the shared node, which knows of no motion; the robot rests at the start."""
    rest_at(shared_client, primitives, START)
    return shared_client


def rest_at(client: NodeClient, primitives: Path, positions: Sequence[float] = START) -> NodeClient:
    """Put a robot at rest in the place of the one that follows the last motion, or does not."""
    forget_robot(client, primitives)
    client.publish_state(JOINTS, positions)
    return client


def forget_robot(client: NodeClient, primitives: Path) -> None:
    """Have the node forget its robot, as it does with the joints of its primitives."""
    for paths in ([""], [str(primitives)]):
        message = Parameter("primitives", value=paths).to_parameter_msg()
        (result,) = client.set_parameters(message)
        assert result.successful, result.reason


@contextmanager
def parameters(client: NodeClient, **values: object) -> Iterator[None]:
    """Parameters that hold for a while; dots in names are written as two underscores."""

    def to_messages(wanted: dict[str, object]) -> list[object]:
        return [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in wanted.items()
        ]

    defaults = {d.name: d.default for d in (*DECLARATIONS, *limit_declarations(JOINTS))}
    defaults |= PATIENCE
    before = {name: defaults[name.replace("__", ".")] for name in values}
    for result in client.set_parameters(*to_messages(values)):
        assert result.successful, result.reason
    try:
        yield
    finally:
        for result in client.set_parameters(*to_messages(before)):
            assert result.successful, result.reason


def in_frame(message: Any, frame_id: str) -> Any:
    message.header.frame_id = frame_id
    return message


def assert_refused(answer: Answer, *words: str) -> None:
    assert answer.report.level == ERROR
    for word in words:
        assert word in answer.report.message


# A motion


def test_goal_gives_a_motion_from_the_present_state_to_exactly_the_goal(
    client: NodeClient,
) -> None:
    before = time.time_ns()
    answer = client.send(goal_message())
    after = time.time_ns()
    assert answer.report.level == OK, answer.report.message
    trajectory = answer.trajectory
    assert trajectory is not None
    first, last = trajectory.points[0], trajectory.points[-1]
    assert tuple(trajectory.joint_names) == JOINTS
    assert list(first.positions) == START
    assert list(last.positions) == GOAL
    assert [*last.velocities, *first.velocities] == [0.0] * 8
    # It waits at its start until any controller has it, so that the time of its beginning is known.
    stamp = trajectory.header.stamp
    assert before <= stamp.sec * 10**9 + stamp.nanosec <= after
    assert times(trajectory)[1] == WAIT
    assert list(trajectory.points[1].positions) == START
    assert trajectory.header.frame_id == ""
    assert times(trajectory)[0] == 0
    assert np.diff(times(trajectory)).min() > 0
    for field in ("positions", "velocities", "accelerations"):
        assert np.isfinite(column(trajectory, field)).all()
    assert not any(point.effort for point in trajectory.points)


def test_report_holds_the_scalars_of_the_plan_and_the_stamp_of_the_goal(client: NodeClient) -> None:
    goal = goal_message()
    goal.header.stamp.sec, goal.header.stamp.nanosec = 12, 34
    values = client.send(goal).values
    assert values["goal_stamp"] == "12.000000034"
    assert values["status"] == "solved"
    assert values["primitive"] in {"arm_arm_4", "arm_joint_4"}
    assert float(values["goal_error"]) == 0.0
    assert 0.0 < float(values["solve_time_s"]) < 10.0


def test_joints_that_a_goal_does_not_name_keep_their_position(client: NodeClient) -> None:
    answer = client.send(goal_message([GOAL[3]], (JOINTS[3],)))
    assert answer.trajectory is not None
    assert list(answer.trajectory.points[-1].positions) == [*START[:3], GOAL[3]]


def test_goal_to_a_robot_that_moves_on_no_motion_of_the_node_is_refused(
    client: NodeClient,
) -> None:
    client.publish_state(JOINTS, START, [0.3, -0.2, 0.1, 0.2])
    assert_refused(client.send(goal_message()), "moves", "at rest")


def test_order_of_joints_and_unusable_extra_joints_in_the_state_do_not_matter(
    client: NodeClient,
) -> None:
    client.publish_state(["gripper", *reversed(JOINTS)], [float("nan"), *reversed(START)])
    answer = client.send(goal_message(GOAL[::-1], JOINTS[::-1]))
    assert answer.trajectory is not None
    assert list(answer.trajectory.points[0].positions) == START
    assert list(answer.trajectory.points[-1].positions) == GOAL


@pytest.mark.parametrize(
    "qos",
    [
        pytest.param(qos_profile_sensor_data, id="best effort"),
        pytest.param(
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL), id="latched"
        ),
    ],
)
def test_states_are_heard_whatever_quality_of_service_they_come_with(
    client: NodeClient, primitives: Path, qos: QoSProfile
) -> None:
    state = JointState(name=JOINTS, position=[0.9 * x for x in START])
    first: list[float] = []
    deadline = time.monotonic() + HANG
    with ros_node("broadcaster") as broadcaster:
        publisher = broadcaster.create_publisher(JointState, "joint_states", qos)
        while first != list(state.position) and time.monotonic() < deadline:
            forget_robot(client, primitives)
            publisher.publish(state)
            trajectory = client.send(goal_message()).trajectory
            first = list(trajectory.points[0].positions) if trajectory else []
    assert first == list(state.position)


@pytest.mark.parametrize("name", ["arm_arm_4", "arm_joint_4"])
def test_frame_id_chooses_the_primitive(client: NodeClient, name: str) -> None:
    assert client.send(in_frame(goal_message(), name)).values["primitive"] == name


def test_request_unlike_the_demonstrations_is_served_with_a_warning(
    client: NodeClient, primitives: Path
) -> None:
    rest_at(client, primitives, GOAL)
    answer = client.send(goal_message(START))
    assert answer.report.level == WARN, answer.report.message
    assert "unlike the demonstrations" in answer.report.message
    assert answer.trajectory is not None


# Parameters


def test_parameters_set_at_run_time_hold_for_the_next_goal(client: NodeClient) -> None:
    with parameters(client, duration=2.5, sample_period=0.1, publish_effort=True):
        trajectory = client.send(goal_message()).trajectory
    assert trajectory is not None
    assert times(trajectory) == [0, *(WAIT + k * 10**8 for k in range(26))]
    assert column(trajectory, "effort").shape == (27, 4)


def test_velocity_limit_set_at_run_time_is_kept_and_can_be_taken_back(
    client: NodeClient, primitives: Path
) -> None:
    def peak() -> float:
        trajectory = client.send(goal_message()).trajectory
        assert trajectory is not None
        return float(np.abs(column(trajectory, "velocities")[:, 3]).max())

    before = peak()
    # With its joints, the node forgets their limits.
    rest_at(client, primitives)
    with parameters(client, limits__elbow__max_velocity=before / 2):
        assert peak() <= before / 2 * (1 + 1e-6)
    rest_at(client, primitives)
    assert peak() == pytest.approx(before)


def test_motions_in_which_the_robot_hits_itself_go_around_or_are_refused(
    client: NodeClient, primitives: Path
) -> None:
    model = CollisionModel(arm_robot())

    def collisions(start: np.ndarray, goal: np.ndarray) -> tuple[Collision, ...]:
        rest_at(client, primitives, start.tolist())
        answer = client.send(goal_message(goal.tolist()))
        message = answer.trajectory
        assert message is not None
        states = (column(message, f) for f in ("positions", "velocities", "accelerations"))
        seconds = 1e-9 * np.array(times(message), dtype=float)
        return model.collisions(Trajectory(message.joint_names, seconds, *states))

    with parameters(client, naturalness=0.0):
        shown = arm_primitive().boundary_states[:, [0, 3]]
        with parameters(client, collision=False):
            through_chest = next(ends for ends in shown if collisions(*ends))
        assert not collisions(*through_chest)
        assert "kept apart" in client.reports[-1].message
        into_chest = rest_at(client, primitives).send(goal_message([0.0, 0.0, 1.5, -2.0]))
        assert_refused(into_chest, "the goal is in collision", "'chest' and 'lower_arm' collide")
        via = JointTrajectoryPoint(positions=GOAL)
        end = JointTrajectoryPoint(positions=[0.0, 0.0, 1.5, -2.0])
        sequence = JointTrajectory(joint_names=JOINTS, points=[via, end])
        assert_refused(client.send(sequence), "in collision", "'chest' and 'lower_arm'")


def test_goal_velocity_is_served_only_if_the_controller_accepts_it(client: NodeClient) -> None:
    goal = goal_message(velocity=[0.1, 0.0, 0.0, 0.0])
    assert_refused(client.send(goal), "shoulder1", "velocity")
    with parameters(client, allow_nonzero_end_velocity=True):
        trajectory = client.send(goal).trajectory
    assert trajectory is not None
    assert list(trajectory.points[-1].velocities) == [0.1, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("duration", -1.0, ["duration", "600"]),
        ("duration", float("nan"), ["duration"]),
        ("duration", 2, ["DOUBLE"]),
        ("sample_period", 0.0, ["sample_period"]),
        ("start_from", "", ["measured", "commanded"]),
        ("primitives", ["/nowhere.npz"], ["/nowhere.npz", "No such file"]),
        ("limits_file", "/nowhere.yaml", ["/nowhere.yaml"]),
        ("robot_description", "<robot", ["not XML"]),
        ("limits.elbo.max_velocity", 1.0, ["elbo", "did you mean 'elbow'"]),
        ("limits.elbow.velocity", 1.0, ["limits.elbow.velocity", "max_velocity"]),
        ("limits.elbow.max_effort", -1.0, ["limits.elbow.max_effort"]),
        ("duratio", 1.0, ["duratio", "did you mean 'duration'"]),
    ],
)
def test_wrong_parameters_are_refused_with_a_reason(
    client: NodeClient, name: str, value: object, words: list[str]
) -> None:
    (result,) = client.set_parameters(Parameter(name, value=value).to_parameter_msg())
    assert not result.successful
    for word in words:
        assert word in result.reason
    assert client.send(goal_message()).report.level == OK


# Other goals, stops and what is kept


def test_pose_goal_that_cannot_be_read_is_refused_with_a_reason(client: NodeClient) -> None:
    pose = PoseStamped()
    pose.header.frame_id = "world"
    assert_refused(client.send(pose), "'world'", "upper_arm", "empty frame_id", "fixed_frames")
    pose.header.frame_id = ""
    pose.pose.orientation.w = 0.5
    assert_refused(client.send(pose), "length 1")
    pose.pose.orientation.w, pose.pose.position.x = 1.0, float("nan")
    assert_refused(client.send(pose), "nan")


def test_pose_goal_is_reached_in_whichever_frame_it_is_stated(
    client: NodeClient, primitives: Path
) -> None:
    robot = arm_robot()
    ends = robot.frame_positions(np.array([START, GOAL]), ["wrist", "upper_arm"])
    wanted = ends[1, 0]
    points = robot.attach_points(["wrist"] * 4, np.vstack([np.zeros(3), np.eye(3)]))
    (corners,), _ = points.positions_and_jacobians(np.array([GOAL]))
    pose = PoseStamped()
    p, o = pose.pose.position, pose.pose.orientation
    p.x, p.y, p.z = wanted.tolist()
    turn = Rotation.from_matrix((corners[1:] - corners[0]).T)
    o.x, o.y, o.z, o.w = turn.as_quat().tolist()
    # A camera above the base that is turned by 90° about z.
    half = 0.5**0.5
    (result,) = client.set_parameters(
        Parameter("fixed_frames", value=[f"camera: 0.5 0 1 0 0 {half} {half}"]).to_parameter_msg()
    )
    assert result.successful, result.reason
    for frame in ("", "chest", "camera"):
        pose.header.frame_id = frame
        if frame == "camera":
            x, y, z = wanted - [0.5, 0.0, 1.0]
            p.x, p.y, p.z = y, -x, z
            seen = Rotation.from_euler("z", -90, degrees=True) * turn
            o.x, o.y, o.z, o.w = seen.as_quat().tolist()
        answer = rest_at(client, primitives).send(pose)
        assert answer.trajectory is not None, answer.report.message
        end = np.array([answer.trajectory.points[-1].positions])
        np.testing.assert_allclose(robot.frame_positions(end, ["wrist"])[0, 0], wanted, atol=1e-5)


def test_sequence_that_cannot_be_read_is_refused_with_a_reason(client: NodeClient) -> None:
    point = JointTrajectoryPoint(positions=GOAL, velocities=[0.1] * 4)
    assert_refused(client.send(JointTrajectory(joint_names=JOINTS)), "at least one target")
    assert_refused(client.send(JointTrajectory(joint_names=JOINTS, points=[point])), "velocities")
    point.velocities = point.positions[:2]
    assert_refused(client.send(JointTrajectory(joint_names=JOINTS[:3], points=[point])), "point 1")


def sequence_message(*points: list[float], times: tuple[int, ...] = ()) -> JointTrajectory:
    """A sequence of configurations; times in seconds, 0 for any."""
    message = JointTrajectory(joint_names=JOINTS)
    message.points = [JointTrajectoryPoint(positions=point) for point in points]
    for point, seconds in zip(message.points, times, strict=False):
        point.time_from_start.sec = seconds
    return message


VIA = arm_primitive().boundary_states[1][3].tolist()


def has_path_between(ends: np.ndarray, preview: MarkerArray) -> bool:
    path = next((marker for marker in preview.markers if marker.ns == "path"), None)
    if path is None:  # an erased one
        return False
    shown = [[point.x, point.y, point.z] for point in (path.points[0], path.points[-1])]
    return np.allclose(shown, ends, rtol=0.0, atol=1e-9)


def test_sequence_is_one_motion_through_the_vias_that_stops_at_the_last(client: NodeClient) -> None:
    answer = client.send(sequence_message(VIA, GOAL, START, times=(2, 0, 5)))
    trajectory = answer.trajectory
    assert trajectory is not None, answer.report.message
    assert answer.values["mode"] == "optimal"
    assert answer.values["n_segments"] == "3"
    for error in ("start_error", "via_error", "goal_error"):
        assert float(answer.values[error]) <= 1e-12
    stamps, q, v = (
        times(trajectory),
        column(trajectory, "positions"),
        column(trajectory, "velocities"),
    )
    at_via = stamps.index(WAIT + 2 * 10**9)
    assert q[at_via].tolist() == VIA
    assert stamps[-1] == WAIT + 5 * 10**9
    assert q[0].tolist() == q[-1].tolist() == START
    assert (q == GOAL).all(axis=1).any()
    # It rests at the ends alone.
    speeds = np.abs(v).max(axis=1)
    assert speeds[0] == speeds[1] == speeds[-1] == 0.0
    assert speeds[2:-1].min() > 0.0
    ends = arm_robot().frame_positions(np.array([START, START]), ["wrist"])[:, 0]
    client.wait_for_preview(lambda preview: has_path_between(ends, preview))


def test_sequence_stops_where_velocities_of_zero_ask_for_it(client: NodeClient) -> None:
    message = sequence_message(VIA, GOAL, START, times=(2, 4, 6))
    message.points[1].velocities = [0.0] * 4
    trajectory = client.send(message).trajectory
    assert trajectory is not None
    speeds = np.abs(column(trajectory, "velocities")).max(axis=1)
    at = [times(trajectory).index(WAIT + seconds * 10**9) for seconds in (2, 4, 6)]
    assert [bool(speeds[k] == 0.0) for k in at] == [False, True, True]
    message.points[1].velocities = [0.0]
    assert_refused(client.send(message), "point 2", "1 velocities")


def test_sequence_whose_time_for_planning_is_short_is_served_with_a_warning(
    client: NodeClient,
) -> None:
    with parameters(client, max_solve_time=1e-3):
        answer = client.send(sequence_message(VIA, GOAL, VIA, START))
    assert answer.trajectory is not None
    assert answer.report.level == WARN
    assert "ran out" in answer.report.message


def test_sequence_is_not_kept_as_a_primitive_and_says_why(
    client: NodeClient, tmp_path: Path
) -> None:
    assert client.send(sequence_message(VIA, GOAL)).trajectory is not None
    with parameters(client, save_folder=str(tmp_path)):
        answer = client.call("save_motion")
    assert not answer.success
    assert "it is a sequence" in answer.message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (sequence_message(), ["at least one target"]),
        (sequence_message(GOAL, VIA, times=(2, 1)), ["increase", "1.0 after 2"]),
        (sequence_message(GOAL, times=(-1,)), ["positive"]),
        (sequence_message(GOAL, times=(10**6,)), ["600 s"]),
        (sequence_message([*GOAL[:3], float("nan")]), ["point 1", "elbow", "nan"]),
        (sequence_message(VIA, [*GOAL[:3], 9.0]), ["target 2", "elbow", "outside its limits"]),
        (in_frame(sequence_message(GOAL), "reach"), ["reach", "arm_arm_4"]),
        (
            JointTrajectory(joint_names=["elbo"], points=[JointTrajectoryPoint(positions=[0.0])]),
            ["elbo", "did you mean 'elbow'"],
        ),
    ],
)
def test_sequence_that_cannot_be_served_is_refused_with_a_reason(
    client: NodeClient, message: JointTrajectory, words: list[str]
) -> None:
    assert_refused(client.send(message), *words)


def test_stop_of_a_robot_at_rest_is_one_point_where_it_is(client: NodeClient) -> None:
    answer, trajectory = client.stop()
    assert "at rest" in answer.message
    assert trajectory is not None
    (point,) = trajectory.points
    assert list(point.positions) == START
    assert list(point.velocities) == list(point.accelerations) == [0.0] * 4
    assert client.send(goal_message()).trajectory is not None


def test_stops_that_are_asked_for_at_once_are_all_answered(
    client: NodeClient, primitives: Path
) -> None:
    rest_at(client, primitives)
    stop = client.node.create_client(Trigger, f"{client.planner}/stop")
    futures = [stop.call_async(Trigger.Request()) for _ in range(10)]
    client.wait(lambda: all(future.done() for future in futures), HANG, "left a request unanswered")
    assert all(future.result().success for future in futures)
    client.node.destroy_client(stop)


def test_motion_is_kept_as_a_primitive_in_the_configured_folder_only(
    client: NodeClient, tmp_path: Path
) -> None:
    assert client.send(in_frame(goal_message(), "arm_arm_4")).report.level == OK
    assert "save_folder" in client.call("save_motion").message
    with parameters(client, save_folder=str(tmp_path / "nowhere")):
        assert "can't be written" in client.call("save_motion").message
    with parameters(client, save_folder=str(tmp_path)):
        for number in (1, 2):
            answer = client.call("save_motion")
            assert answer.success, answer.message
            kept = load_primitive(tmp_path / f"arm_arm_4_{number}.npz")
            assert kept.name == f"arm_arm_4_{number}"
    assert kept.metadata["refined_from"]["name"] == "arm_arm_4"


def test_preview_shows_the_path_and_the_arm_on_it_and_late_comers_see_it(
    client: NodeClient,
) -> None:
    answer = client.send(goal_message())
    assert answer.trajectory is not None
    ends = arm_robot().frame_positions(np.array([START, GOAL]), ["wrist"])[:, 0]
    preview = client.wait_for_preview(lambda preview: has_path_between(ends, preview))
    assert any(marker.ns == "last_pose" for marker in preview.markers)


def test_command_sends_a_goal_in_degrees_and_prints_the_report(
    client: NodeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    with parameters(client, state_timeout=0.0):
        elbow = math.degrees(GOAL[3])
        n_trajectories = len(client.trajectories)
        assert main(["send_goal", f"elbow={elbow}", "--degrees", "--wait", "0", "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert float(report["goal_error"]) == 0.0
        assert main(["send_goal", "elbo=0.1"]) == 2
        assert "did you mean 'elbow'" in capsys.readouterr().out
        client.wait_for_diagnostics()
    assert len(client.trajectories) == n_trajectories + 1
    end = client.trajectories[-1].points[-1].positions
    np.testing.assert_allclose(end, [*START[:3], GOAL[3]], atol=1e-12)


@pytest.mark.parametrize("form", ["[{}]", "{}"])
@pytest.mark.slow
def test_command_sends_a_list_in_the_joint_order_of_the_robot_description(
    client: NodeClient, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    with parameters(client, state_timeout=0.0):
        n_trajectories = len(client.trajectories)
        goal = form.format(", ".join(map(str, GOAL)))
        assert main(["send_goal", goal, "--wait", "0", "--json"]) == 0
        assert float(json.loads(capsys.readouterr().out)["goal_error"]) == 0.0
        assert main(["send_goal", "[0.1, 0.2]", "--wait", "0"]) == 2
        assert "has 2 values, but there are 4 joints: " in capsys.readouterr().err
        client.wait_for_diagnostics()
    assert len(client.trajectories) == n_trajectories + 1
    end = client.trajectories[-1].points[-1].positions
    np.testing.assert_allclose(end, GOAL, atol=1e-12)


def test_command_sends_a_sequence(client: NodeClient, capsys: pytest.CaptureFixture[str]) -> None:
    with parameters(client, state_timeout=0.0):
        assert (
            main(["send_goal", "elbow=-0.3@2", "--via", "elbow=-0.6@1", "--wait", "0", "--json"])
            == 0
        )
        report = json.loads(capsys.readouterr().out)
        assert report["n_segments"] == "2"
        client.wait_for_diagnostics()
    trajectory = client.trajectories[-1]
    assert trajectory.points[times(trajectory).index(WAIT + 10**9)].positions[3] == -0.6
    assert trajectory.points[times(trajectory).index(WAIT + 2 * 10**9)].positions[3] == -0.3


def test_bag_of_the_topics_of_the_node_holds_what_was_sent(
    client: NodeClient, tmp_path: Path
) -> None:
    # rosbags (0.11) expects padding behind an empty list of numbers, which ROS 2 leaves out:
    # points must have efforts for it to read them.
    with parameters(client, publish_effort=True):
        answer = client.send(goal_message())
    assert answer.trajectory is not None
    sent = {"/trajectory": answer.trajectory, "/report": answer.report}
    kinds = {
        "/trajectory": "trajectory_msgs/msg/JointTrajectory",
        "/report": "diagnostic_msgs/msg/DiagnosticStatus",
    }
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=9) as writer:
        for stamp, (topic, message) in enumerate(sent.items()):
            connection = writer.add_connection(topic, kinds[topic], typestore=store)
            writer.write(connection, stamp, serialize_message(message))
    with AnyReader([tmp_path / "bag"], default_typestore=store) as reader:
        found = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    read = found["/trajectory"]
    assert read.joint_names == list(JOINTS)
    for field in ("positions", "velocities", "accelerations", "effort"):
        values = [getattr(point, field) for point in read.points]
        assert np.array_equal(values, column(answer.trajectory, field))
    stamps = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in read.points]
    assert stamps == times(answer.trajectory)
    values = {pair.key: pair.value for pair in found["/report"].values}
    assert values == answer.values


# Primitive files


def test_reload_takes_new_files_and_keeps_the_old_ones_if_one_is_damaged(
    client: NodeClient, primitives: Path
) -> None:
    damaged = primitives / "more.npz"
    try:
        save_primitive(arm_primitive("joint", 2), damaged)
        forge(damaged, lambda a, m: m.update(joint_names=5))
        assert "expected a list" in client.call("reload_primitives").message
        damaged.unlink()
        os.mkfifo(damaged)
        assert "not a regular file" in client.call("reload_primitives").message
        damaged.unlink()
        damaged.write_bytes(b"PK")
        answer = client.call("reload_primitives")
        assert not answer.success
        assert str(damaged) in answer.message
        assert "'arm_arm_4', 'arm_joint_4' kept" in answer.message
        assert client.send(goal_message()).report.level == OK
    finally:
        damaged.unlink()
    answer = client.call("reload_primitives")
    assert answer.success
    assert answer.message == "loaded: 'arm_arm_4', 'arm_joint_4'"


# Refusals


def test_state_that_is_too_old_is_refused(client: NodeClient) -> None:
    with parameters(client, state_timeout=1e-9):
        assert_refused(client.send(goal_message()), "joint_states", "old", "state_timeout")


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (JointState(name=JOINTS, position=[*START[:3], float("nan")]), ["elbow", "nan"]),
        (JointState(name=JOINTS, position=START[:3]), ["4 joints", "3 positions"]),
        (JointState(name=JOINTS, position=START, velocity=[0.0]), ["4 joints", "1 velocities"]),
        (JointState(name=[*JOINTS, "elbow"], position=[*START, 0.0]), ["elbow", "each once"]),
        (JointState(name=JOINTS, position=[*START[:3], 1.0]), ["elbow", "outside its limits"]),
    ],
)
def test_unusable_state_is_refused(
    client: NodeClient, primitives: Path, state: JointState, words: list[str]
) -> None:
    forget_robot(client, primitives)
    client.publish_state_message(state)
    assert_refused(client.send(goal_message()), *words)


def test_states_of_other_joints_are_ignored_and_counted(client: NodeClient) -> None:
    before = int(client.wait_for_diagnostics()["joint_states_incomplete"])
    client.publish_state(JOINTS, START)
    client.publish_state(["gripper"], [0.0])
    assert client.send(goal_message()).report.level == OK
    assert int(client.wait_for_diagnostics()["joint_states_incomplete"]) == before + 1


def test_plan_that_breaks_limits_is_reported_and_not_published(client: NodeClient) -> None:
    n_trajectories = len(client.trajectories)
    with parameters(client, duration=0.05):
        answer = client.send(goal_message(), timeout=HANG)
    assert_refused(answer, "limit", "joint", "finds the shortest one")
    assert answer.values["status"] == "infeasible"
    assert float(answer.values["limit_violation"]) > 0.0
    # Looking for a motion of that duration, and for the shortest one, took its time.
    client.publish_state(JOINTS, START)
    assert client.send(goal_message()).report.level == OK
    assert len(client.trajectories) == n_trajectories + 1


# Start and end


def only(names: tuple[str, ...], demonstration: Demonstration) -> Demonstration:
    """A demonstration of its first joints alone."""
    series = (demonstration.positions, demonstration.velocities, demonstration.accelerations)
    return Demonstration(
        names,
        demonstration.times,
        *(values[:, : len(names)] for values in series),
        recording=demonstration.recording,
        start_time=demonstration.start_time,
        end_time=demonstration.end_time,
    )


@pytest.fixture
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stay away from the shared node."""
    set_domain(monkeypatch, 50)


@pytest.mark.usefixtures("own_domain")
def test_node_waits_for_what_is_missing_and_says_for_what(tmp_path: Path) -> None:
    file = tmp_path / "arm.npz"
    arguments = ("-p", f"primitives:=['{file}']")
    with running_node(tmp_path / "log.txt", *arguments), NodeClient() as client:
        client.wait_for_node()
        assert "arm.npz" in client.wait_for_diagnostics()["text"]
        duration = Parameter("duration", value=1.5).to_parameter_msg()
        assert client.set_parameters(duration)[0].successful
        assert_refused(client.send(goal_message()), "arm.npz", "No such file")
        assert not client.call("reload_primitives").success
        save_primitive(arm_primitive(), file)
        assert client.call("reload_primitives").success
        assert_refused(client.send(goal_message()), "robot_description")
        urdf = Parameter("robot_description", value=URDF).to_parameter_msg()
        assert client.set_parameters(urdf)[0].successful
        assert_refused(client.send(goal_message()), "joint_states", *JOINTS)
        client.publish_state(JOINTS, START)
        assert client.send(goal_message()).report.level == OK
        diagnostics = client.wait_for_diagnostics(lambda values: "stopped" in values["text"])
        assert diagnostics["goals_served"] == "1"
        assert diagnostics["goals_refused"] == "3"
        timeout = Parameter("state_timeout", value=0.0).to_parameter_msg()
        assert client.set_parameters(timeout)[0].successful
        client.wait_for_diagnostics(lambda values: values["text"] == "ready for goals")


@pytest.mark.slow
@pytest.mark.usefixtures("own_domain")
def test_primitives_of_other_joints_bring_their_own_limits(tmp_path: Path) -> None:
    urdf = tmp_path / "planner.yaml"
    urdf.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"robot_description": URDF}}}))
    shoulder = build_primitive([only(JOINTS[:2], d) for d in arm_demonstrations()], "shoulder")
    files = [str(tmp_path / name) for name in ("arm.npz", "shoulder.npz")]
    for file, primitive in zip(files, (arm_primitive(), shoulder), strict=True):
        save_primitive(primitive, file)
    arguments = ("--params-file", str(urdf), "-p", f"primitives:=['{files[0]}']", *PATIENTLY)
    with running_node(tmp_path / "log.txt", *arguments), NodeClient() as client:
        client.wait_for_node()
        client.wait_for_model()
        wanted = {"primitives": [files[1]], "limits.shoulder2.max_velocity": 0.5}
        messages = [Parameter(name, value=v).to_parameter_msg() for name, v in wanted.items()]
        for result in client.set_parameters(*messages):
            assert result.successful, result.reason
        elbow = Parameter("limits.elbow.max_velocity", value=1.0).to_parameter_msg()
        assert "valid names: 'shoulder1', 'shoulder2'" in client.set_parameters(elbow)[0].reason
        client.publish_state(JOINTS, START)
        trajectory = client.send(goal_message(GOAL[:2], JOINTS[:2])).trajectory
    assert trajectory is not None
    assert tuple(trajectory.joint_names) == JOINTS[:2]
    assert np.abs(column(trajectory, "velocities")[:, 1]).max() <= 0.5 * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("own_domain")
def test_unusable_description_on_the_topic_is_reported_and_can_be_mended(
    tmp_path: Path, primitives: Path
) -> None:
    arguments = ("-p", f"primitives:=['{primitives}']", "-p", "limits.shoulder1.max_velocity:=0.9")
    arguments += PATIENTLY
    with running_node(tmp_path / "log.txt", *arguments), NodeClient() as client:
        client.wait_for_node()
        client.publish_description("<robot name='other'><link name='a'/></robot>")
        client.wait_for_diagnostics(lambda values: "no revolute" in values["text"])
        assert_refused(client.send(goal_message()), "no revolute")
        # Unusable in two places, which parameters mend one after the other.
        client.publish_description(re.sub('velocity="2[05]"', 'velocity="0"', URDF))
        client.wait_for_diagnostics(lambda values: "max_velocity" in values["text"])
        for joint in ("elbow", "shoulder3"):
            assert_refused(client.send(goal_message()), "max_velocity")
            limit = Parameter(f"limits.{joint}.max_velocity", value=0.7).to_parameter_msg()
            assert client.set_parameters(limit)[0].successful
        client.publish_state(JOINTS, START)
        trajectory = client.send(goal_message()).trajectory
    assert trajectory is not None
    peaks = np.abs(column(trajectory, "velocities")).max(axis=0)
    assert (peaks[[0, 2, 3]] <= np.array([0.9, 0.7, 0.7]) * (1 + 1e-6)).all()


@pytest.mark.usefixtures("own_domain")
@pytest.mark.slow
def test_wrong_arguments_end_the_node_with_one_line_and_status_2(primitives: Path) -> None:
    cases = {
        "duration:=-1.0": "'duration' is -1.0",
        "duration:=1": "with a decimal point",
        "start_from:=nowhere": "'measured', 'commanded'",
        "robot_description:=robot.urdf": "not XML",
        "limits.elbo.max_jerk:=1.0": "did you mean 'elbow'",
        "oops": "oops",
    }
    command = [sys.executable, "-m", "mp_pca_planner", "planner_node", "--ros-args"]
    command += ["-p", f"primitives:=['{primitives}']"]
    processes = {
        case: subprocess.Popen([*command, "-p", case], stderr=subprocess.PIPE, text=True)
        for case in cases
    }
    for case, process in processes.items():
        _, stderr = process.communicate(timeout=HANG)
        lines = [line for line in stderr.splitlines() if "[rcl]" not in line]
        assert process.returncode == 2, stderr
        assert len(lines) == 1, stderr
        assert cases[case] in lines[0]


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_node_ends_cleanly_however_often_it_is_told_to(tmp_path: Path, number: int) -> None:
    log = tmp_path / "log.txt"
    with log.open("w") as output:
        process = start_node(output=output)
    try:
        with NodeClient() as client:
            client.wait_for_node()
        deadline = time.monotonic() + HANG
        while process.poll() is None and time.monotonic() < deadline:
            process.send_signal(number)
            time.sleep(0.005)
        assert process.returncode == 0, log.read_text()
    finally:
        process.kill()
    assert "Traceback" not in log.read_text()


def catches(process: subprocess.Popen[str], number: int) -> bool:
    """Whether the process has a handler for a signal."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_node_that_is_told_to_end_while_it_starts_ends_cleanly(tmp_path: Path, number: int) -> None:
    log = tmp_path / "log.txt"
    with log.open("w") as output:
        process = start_node(output=output)
    try:
        # Python itself catches SIGINT, but not SIGTERM.
        while not catches(process, signal.SIGTERM):
            assert process.poll() is None
        process.send_signal(number)
        assert process.wait(timeout=HANG) == 0, log.read_text()
    finally:
        process.kill()
    assert "Traceback" not in log.read_text()


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--help"], 0, "--ros-args"),
        ([], 2, "mp_pca_planner[ros]"),
        (["somewhere"], 2, "somewhere"),
    ],
)
def test_without_ros_there_is_help_and_a_hint(
    arguments: list[str], status: int, words: str
) -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from mp_pca_planner.ros.planner_node import main\n"
        f"sys.exit(main({arguments}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG, check=False
    )
    assert done.returncode == status
    assert words in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
