# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node in a process of its own, talked to over real topics and services."""

from __future__ import annotations

import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import ListParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from support.arm import JOINTS, URDF, arm_demonstrations, arm_primitive, arm_robot
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENCE,
    START,
    Answer,
    NodeClient,
    call,
    column,
    described_client,
    goal_message,
    other_process,
    planner_of,
    publish_states,
    ros_node,
    running_node,
    set_request,
    start_node,
    times,
    words,
)
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from mp_pca_planner.cli.main import main
from mp_pca_planner.execution.parameters import DECLARATIONS
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import load_primitive, save_primitive

# Motions from rest start so long after the stamp of their message [ns].
WAIT = 20_000_000
COLUMNS = ("positions", "velocities", "accelerations")
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
        arguments = words(primitives=[str(primitives)], **PATIENCE)
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
        client.set(primitives=paths)


@contextmanager
def parameters(client: NodeClient, **values: object) -> Iterator[None]:
    """Parameters that hold for a while."""
    defaults = {d.name: d.default for d in DECLARATIONS} | PATIENCE
    client.set(**values)
    try:
        yield
    finally:
        client.set(**{name: defaults[name] for name in values})


def assert_refused(answer: Answer, *words: str) -> None:
    assert answer.report.level == ERROR
    for word in words:
        assert word in answer.report.message


def test_goal_gives_a_motion_from_the_present_state_to_exactly_the_goal(
    client: NodeClient, primitives: Path
) -> None:
    goal = goal_message()
    goal.header.frame_id = "arm_joint_4"
    goal.header.stamp.sec, goal.header.stamp.nanosec = 12, 34
    before = time.time_ns()
    answer = client.send(goal)
    after = time.time_ns()
    assert answer.report.level == OK, answer.report.message
    trajectory = answer.trajectory
    assert trajectory is not None
    assert answer.latency is not None and 0.0 < answer.latency < HANG
    q, v = column(trajectory, "positions"), column(trajectory, "velocities")
    assert tuple(trajectory.joint_names) == JOINTS
    assert q[0].tolist() == q[1].tolist() == START and q[-1].tolist() == GOAL
    assert not v[0].any() and not v[-1].any()
    # It waits at its start until any controller has it, so that the time of its beginning is known.
    stamp = trajectory.header.stamp
    assert before <= stamp.sec * 10**9 + stamp.nanosec <= after
    assert times(trajectory)[:2] == [0, WAIT]
    assert np.diff(times(trajectory)).min() > 0
    values = answer.values
    assert (values["goal_stamp"], values["status"]) == ("12.000000034", "solved")
    assert (values["primitive"], values["goal_error"]) == ("arm_joint_4", "0.0")
    # The way back was never shown.
    answer = rest_at(client, primitives, GOAL).send(goal_message(START))
    assert answer.report.level == WARN, answer.report.message
    assert "unlike your demonstrations" in answer.report.message
    assert answer.trajectory is not None


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
    state = JointState(name=["gripper", *JOINTS], position=[math.nan, *(0.9 * x for x in START)])
    first: list[float] = []
    deadline = time.monotonic() + HANG
    with ros_node("broadcaster") as broadcaster:
        publisher = broadcaster.create_publisher(JointState, "joint_states", qos)
        while first != list(state.position[1:]) and time.monotonic() < deadline:
            forget_robot(client, primitives)
            publisher.publish(state)
            trajectory = client.send(goal_message()).trajectory
            first = list(trajectory.points[0].positions) if trajectory else []
    assert first == list(state.position[1:])


def test_parameters_set_at_run_time_hold_for_the_next_goal(client: NodeClient) -> None:
    with parameters(client, duration=2.5, sample_period=0.1, publish_effort=True):
        trajectory = client.send(goal_message()).trajectory
    assert trajectory is not None
    assert times(trajectory) == [0, *(WAIT + k * 10**8 for k in range(26))]
    assert column(trajectory, "effort").shape == (27, 4)


def test_wrong_parameters_are_refused_with_a_reason(client: NodeClient) -> None:
    for name, value, text in (
        ("duration", float("nan"), "duration"),
        ("duration", 2, "DOUBLE"),
        ("primitives", ["/nowhere.npz"], "'/nowhere.npz' is rejected"),
        ("robot_description", "<robot", "not XML"),
        ("limits.elbo.max_velocity", 1.0, "did you mean 'elbow'"),
        ("duratio", 1.0, "did you mean 'duration'"),
    ):
        (reason,) = client.try_to_set({name: value})
        assert text in reason
    assert client.send(goal_message()).report.level == OK


VIA = arm_primitive().boundary_states[1][3].tolist()


def has_path_between(ends: np.ndarray, preview: MarkerArray) -> bool:
    path = next((marker for marker in preview.markers if marker.ns == "path"), None)
    if path is None:  # an erased one
        return False
    shown = [[point.x, point.y, point.z] for point in (path.points[0], path.points[-1])]
    return np.allclose(shown, ends, rtol=0.0, atol=1e-9)


def test_sequence_is_one_motion_through_the_vias_that_stops_where_it_is_asked_to(
    client: NodeClient,
) -> None:
    message = JointTrajectory(joint_names=JOINTS)
    for seconds, positions in ((2, VIA), (4, GOAL), (6, START)):
        message.points.append(JointTrajectoryPoint(positions=positions))
        message.points[-1].time_from_start.sec = seconds
    message.points[1].velocities = [0.0] * 4
    answer = client.send(message)
    trajectory = answer.trajectory
    assert trajectory is not None, answer.report.message
    assert (answer.values["mode"], answer.values["n_segments"]) == ("optimal", "3")
    q, stamps = column(trajectory, "positions"), times(trajectory)
    at = [0, *(stamps.index(WAIT + seconds * 10**9) for seconds in (2, 4, 6))]
    assert q[at].tolist() == [START, VIA, GOAL, START]
    speeds = np.abs(column(trajectory, "velocities")).max(axis=1)
    assert np.flatnonzero(speeds == 0.0).tolist() == [0, 1, *at[2:]]
    ends = arm_robot().frame_positions(np.array([START, START]), ["wrist"])[:, 0]
    client.wait_for_preview(lambda preview: has_path_between(ends, preview))
    message.points[1].velocities = [0.0]
    assert_refused(client.send(message), "point 2", "1 velocities")


def test_stops_of_a_robot_at_rest_are_one_point_where_it_is(client: NodeClient) -> None:
    n = len(client.trajectories)
    stop = client.node.create_client(Trigger, f"{client.planner}/stop")
    futures = [stop.call_async(Trigger.Request()) for _ in range(10)]
    client.wait(lambda: all(future.done() for future in futures), HANG, "left a request unanswered")
    assert all(future.result().success for future in futures)
    assert any("at rest" in future.result().message for future in futures)
    client.node.destroy_client(stop)
    client.next_trajectory(n, HANG)
    (point,) = client.trajectories[n].points
    assert list(point.positions) == START
    assert list(point.velocities) == list(point.accelerations) == [0.0] * 4
    answer_once(client, lambda answer: answer.trajectory is not None)


@contextmanager
def full_disk(process: subprocess.Popen[str], size: int = 1000) -> Iterator[None]:
    """No file of the planner grows beyond the size [bytes]: the system refuses to write it."""
    planner = planner_of(process)
    before = resource.prlimit(planner, resource.RLIMIT_FSIZE)
    resource.prlimit(planner, resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.prlimit(planner, resource.RLIMIT_FSIZE, before)


def test_motion_is_kept_as_a_primitive_in_the_configured_folder_only(
    client: NodeClient,
    node: subprocess.Popen[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    goal = goal_message()
    goal.header.frame_id = "arm_arm_4"
    assert client.send(goal).report.level == OK
    assert "save_folder" in client.call("save_motion").message
    with parameters(client, save_folder=str(tmp_path / "nowhere")):
        assert "can't be written" in client.call("save_motion").message
    with parameters(client, save_folder=str(tmp_path)):
        with full_disk(node):
            assert "can't be written: File too large" in client.call("save_motion").message
        assert not list(tmp_path.iterdir())
        for number in (1, 2):
            assert main(["call", "save_motion"]) == 0
            assert f"arm_arm_4_{number}.npz'" in capsys.readouterr().out
            kept = load_primitive(tmp_path / f"arm_arm_4_{number}.npz")
            assert kept.name == f"arm_arm_4_{number}"
    assert kept.metadata["refined_from"]["name"] == "arm_arm_4"


def test_names_of_primitives_are_no_paths(
    client: NodeClient, primitives: Path, tmp_path: Path
) -> None:
    evil, name = primitives / "evil.npz", f"../..{tmp_path}/../evil"
    save_primitive(build_primitive(arm_demonstrations(), name), evil)
    files = set(tmp_path.parent.rglob("*"))
    try:
        assert client.call("reload_primitives").success
        client.publish_state(JOINTS, START)
        goal = goal_message()
        goal.header.frame_id = name
        with parameters(client, save_folder=str(tmp_path)):
            assert client.send(goal).values["primitive"] == name
            answer = client.call("save_motion")
        assert answer.success, answer.message
        (new,) = set(tmp_path.parent.rglob("*")) - files
        assert new.parent == tmp_path
    finally:
        evil.unlink()
    assert client.call("reload_primitives").success


def test_commands_send_goals_poses_sequences_and_stops_and_print_their_reports(
    client: NodeClient, capsys: pytest.CaptureFixture[str]
) -> None:
    def send(*words: str) -> tuple[dict[str, Any], JointTrajectory]:
        n = len(client.trajectories)
        assert main(["send_goal", *words, "--wait", "0", "--json"]) == 0
        trajectory = client.next_trajectory(n, HANG)
        assert trajectory is not None
        return json.loads(capsys.readouterr().out), trajectory

    with other_process(publish_states, 50.0, START):
        report, trajectory = send(f"elbow={math.degrees(GOAL[3])}", "--degrees")
        assert report["goal_error"] == 0.0
        end = trajectory.points[-1].positions
        np.testing.assert_allclose(end, [*START[:3], GOAL[3]], atol=1e-12)
        assert main(["send_goal", "elbo=0.1"]) == 2
        assert "did you mean 'elbow'" in capsys.readouterr().out
        # A list is in the order of the robot description.
        assert main(["send_goal", "[0.1, 0.2]", "--wait", "0"]) == 2
        assert "has 2 values, expected 4: " in capsys.readouterr().err
        report, trajectory = send("elbow=-0.3@2", "--via", "elbow=-0.6@1")
        assert report["n_segments"] == 2
        at = [times(trajectory).index(WAIT + seconds * 10**9) for seconds in (1, 2)]
        assert column(trajectory, "positions")[at, 3].tolist() == [-0.6, -0.3]
        robot = arm_robot()
        (wanted,) = robot.attached_poses(np.array([GOAL]), ["wrist"], np.zeros((1, 6)))[0]
        pose = " ".join(map(str, wanted))
        _, trajectory = send("--goal-pose", pose)
        ends = robot.frame_positions(column(trajectory, "positions")[-1:], ["wrist"])
        np.testing.assert_allclose(ends[0, 0], wanted[:3], atol=1e-5)
        n = len(client.trajectories)
        assert main(["stop", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["success"] is True
        assert client.next_trajectory(n, HANG) is not None


def test_command_without_a_node_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_domain(monkeypatch, 34)
    assert main(["stop", "--timeout", "0.5"]) == 1
    assert "'mp_pca_planner' is not there within 0.5 s" in capsys.readouterr().err


def test_reload_takes_new_files_and_keeps_the_old_ones_if_one_is_damaged_or_of_another_robot(
    client: NodeClient, primitives: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = primitives / "more.npz"
    renamed = [replace(d, joint_names=tuple("abcd")) for d in arm_demonstrations()]
    try:
        for is_damaged in (False, True):
            save_primitive(build_primitive(renamed, "other_robot"), more, overwrite=True)
            if is_damaged:
                more.write_bytes(b"PK")
            assert main(["call", "reload"]) == 1
            captured = capsys.readouterr()
            said = captured.out + captured.err
            assert said.count("\n") == 1 and (str(more) if is_damaged else "'a'") in said
            assert "'arm_arm_4', 'arm_joint_4' kept" in said
            # A reload takes longer than a state of a robot in motion is good for.
            assert answer_once(client, lambda answer: answer.report.level == OK).trajectory
    finally:
        more.unlink()
    with ros_node("lister") as lister:
        request = ListParameters.Request(prefixes=["limits"])
        names = call(lister, ListParameters, "/mp_pca_planner/list_parameters", request).result
    assert {name.split(".")[1] for name in names.names} == set(JOINTS)
    assert main(["call", "reload"]) == 0
    assert capsys.readouterr().out == "loaded: 'arm_arm_4', 'arm_joint_4'\n"


def answer_once(client: NodeClient, is_wanted: Callable[[Answer], bool]) -> Answer:
    """The first wanted answer to a goal: topics are not in step with each other."""
    deadline = time.monotonic() + HANG
    while True:
        client.publish_state(JOINTS, START)
        # A goal that repeats is answered without a motion. Thousands may be refused meanwhile.
        elbow = GOAL[3] - 0.01 * (len(client.reports) % 20)
        answer = client.send(goal_message([*GOAL[:3], elbow]))
        if is_wanted(answer):
            return answer
        assert time.monotonic() < deadline, answer.report.message


def test_robot_may_be_exchanged_for_another_while_the_node_runs(client: NodeClient) -> None:
    for other, text in (
        ("<robot name='other'><link name='a'/></robot>", "no revolute"),
        (URDF.replace('name="elbow"', 'name="knee"'), "'elbow'"),
        (URDF[: len(URDF) // 2], "not XML"),
        ("", "robot_description"),
    ):
        client.publish_description(other)
        answer_once(client, lambda answer, text=text: text in answer.report.message)
        stopped, hold = client.stop()  # with what was known of the robot
        assert stopped.success and len(hold.points) == 1
    client.publish_description(URDF)
    cost = float(answer_once(client, lambda answer: answer.trajectory).values["effort_cost"])
    # All links weigh more: the same goal takes more effort.
    client.publish_description(URDF.replace('<mass value="', '<mass value="1'))
    answer_once(client, lambda answer: float(answer.values.get("effort_cost", 0.0)) > 2.0 * cost)
    client.publish_description(URDF)
    client.wait_for_model()


def test_each_goal_of_a_burst_gets_its_report_and_the_newest_good_one_is_not_overtaken(
    client: NodeClient,
) -> None:
    deadline = time.monotonic() + HANG
    # The goals of a burst ask for the same: where one of them has its motion, others need none.
    served, met = {"solved", "under_way"}, set[str]()
    with ros_node("operators") as operators:
        goals = operators.create_publisher(JointState, "mp_pca_planner/goal", 20)
        while not goals.get_subscription_count():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for _ in range(10):
            client.reports.clear()
            for k in range(10):
                bad = float("nan") if k % 2 else 100.0
                goal = goal_message(GOAL if k % 3 else [bad, *GOAL[1:]])
                goal.header.stamp.nanosec = k
                goals.publish(goal)
            while len(client.reports) < 10:
                assert time.monotonic() < deadline
                client.spin_once(0.1)
            found = [Answer(report).values for report in client.reports]
            status = {values["goal_stamp"][-1]: values["status"] for values in found}
            assert len(status) == 10
            assert {status[number] for number in "0369"} == {"refused"}
            # After the first motion, a state that a busy client published long ago is too old.
            assert {status[number] for number in "124578"} <= {"overtaken", "refused", *served}
            assert status["8"] != "overtaken"
            met |= {*status.values()}
        assert met & served


# Workers


def serve(client: NodeClient) -> None:
    """Have a goal served, as soon as goals are."""
    for _ in range(100):
        client.publish_state(JOINTS, START)
        answer = client.send(goal_message(), HANG)
        if answer.trajectory is not None:
            client.call("stop", HANG)
            return
        assert "send the goal again" in answer.report.message, answer.report.message
        client.wait_for_diagnostics(timeout=HANG)
    raise AssertionError(answer.report.message)


def test_goal_whose_planner_dies_is_refused_with_the_reason_and_the_next_one_served(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner, n = planner_of(node), len(client.reports)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    answer = client.call("stop", HANG)  # the planner hangs, and the node answers
    assert answer.success
    client.publish_goal(goal_message(GOAL))
    os.kill(planner, signal.SIGSEGV)
    os.kill(planner, signal.SIGCONT)
    client.wait(lambda: len(client.reports) >= n + 2, HANG, "did not report")
    overtaken, refused = client.reports[n : n + 2]
    assert "preempted" in overtaken.message
    assert refused.level == ERROR
    assert "the planner has ended" in refused.message or "started again" in refused.message
    serve(client)


def test_parameter_whose_planner_dies_is_refused(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner = planner_of(node)
    os.kill(planner, signal.SIGSTOP)
    service = client._services["set_parameters"]
    changed = service.call_async(set_request({"naturalness": 0.3}))
    assert client.call("stop", HANG).success
    os.kill(planner, signal.SIGKILL)
    client.wait(changed.done, HANG, "did not answer")
    (result,) = changed.result().results
    assert not result.successful and "the planner has ended (signal SIGKILL)" in result.reason
    serve(client)


def test_robot_description_whose_planner_dies_is_used_by_the_next_planner(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner, n = planner_of(node), int(client.wait_for_diagnostics()["worker_restarts"])
    os.kill(planner, signal.SIGSTOP)
    client.publish_description(URDF.replace("</robot>", "\n</robot>"))
    time.sleep(0.2)  # the node reads it
    assert client.call("stop", HANG).success
    os.kill(planner, signal.SIGKILL)
    client.wait_for_diagnostics(lambda values: int(values["worker_restarts"]) > n, HANG)
    answer_once(client, lambda answer: answer.trajectory is not None)
    client.publish_description(URDF)


# Start and end


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
        client.set(duration=1.5)
        assert_refused(client.send(goal_message()), "arm.npz", "No such file")
        assert not client.call("reload_primitives").success
        save_primitive(arm_primitive(), file)
        assert client.call("reload_primitives").success
        assert_refused(client.send(goal_message()), "robot_description")
        client.set(robot_description=URDF)
        assert_refused(client.send(goal_message()), "joint_states", *JOINTS)
        client.publish_state(JOINTS, START)
        assert client.send(goal_message()).report.level == OK
        diagnostics = client.wait_for_diagnostics(lambda values: "stopped" in values["text"])
        assert diagnostics["goals_served"] == "1"
        assert diagnostics["goals_refused"] == "3"
        client.set(state_timeout=0.0)
        client.wait_for_diagnostics(lambda values: values["text"] == "ready for goals")


@pytest.mark.slow
@pytest.mark.usefixtures("own_domain")
def test_other_primitives_bring_their_limits_which_mend_a_description_one_by_one(
    tmp_path: Path,
) -> None:
    demonstrations = [
        replace(d, **{name: getattr(d, name)[:, :2] for name in COLUMNS}, joint_names=JOINTS[:2])
        for d in arm_demonstrations()
    ]
    files = [str(tmp_path / name) for name in ("arm.npz", "shoulder.npz")]
    save_primitive(arm_primitive(), files[0])
    save_primitive(build_primitive(demonstrations, "shoulder"), files[1])
    limits = {"limits.shoulder1.max_velocity": 0.9}
    arguments = words(primitives=[files[0]], **PATIENCE, **limits)
    with running_node(tmp_path / "log.txt", *arguments), described_client() as client:
        client.set(**{"primitives": [files[1]], "limits.shoulder2.max_velocity": 0.5})
        (reason,) = client.try_to_set({"limits.elbow.max_velocity": 1.0})
        assert "valid names: 'shoulder1', 'shoulder2'" in reason
        client.publish_state(JOINTS, START)
        short = client.send(goal_message(GOAL[:2], JOINTS[:2])).trajectory
        client.set(primitives=[files[0]])
        client.publish_description(re.sub('velocity="2[05]"', 'velocity="0"', URDF))
        client.wait_for_diagnostics(lambda values: "max_velocity" in values["text"])
        for joint in ("elbow", "shoulder3"):
            assert_refused(client.send(goal_message()), "max_velocity")
            client.set(**{f"limits.{joint}.max_velocity": 0.7})
        client.publish_state(JOINTS, START)
        trajectory = client.send(goal_message()).trajectory
    assert short is not None and trajectory is not None
    assert tuple(short.joint_names) == JOINTS[:2]
    assert np.abs(column(short, "velocities")[:, 1]).max() <= 0.5 * (1 + 1e-6)
    peaks = np.abs(column(trajectory, "velocities")).max(axis=0)
    assert (peaks <= np.array([0.9, 0.5, 0.7, 0.7]) * (1 + 1e-6)).all()


@pytest.mark.usefixtures("own_domain")
@pytest.mark.slow
def test_wrong_arguments_end_the_node_with_one_line_and_status_2() -> None:
    for argument, text in (
        ("duration:=-1.0", "'duration' is -1.0"),
        ("limits.elbow.max_velocity:=1", "'limits.elbow.max_velocity' is 1"),
        ("oops", "oops"),
    ):
        command = [sys.executable, "-m", "mp_pca_planner", "planner_node"]
        command += ["--ros-args", "-p", argument]
        done = subprocess.run(command, capture_output=True, text=True, timeout=HANG, check=False)
        (line,) = [line for line in done.stderr.splitlines() if "[rcl]" not in line]
        assert done.returncode == 2 and text in line


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("is_early", [True, False])
def test_node_ends_cleanly_however_early_and_often_it_is_told_to(
    tmp_path: Path, number: int, is_early: bool
) -> None:
    log = tmp_path / "log.txt"
    with log.open("w") as output:
        process = start_node(output=output)
    try:
        if is_early:  # as soon as it has a handler; Python itself catches SIGINT, but not SIGTERM
            status = Path(f"/proc/{process.pid}/status")
            while not int(re.search(r"SigCgt:\s*(\w+)", status.read_text())[1], 16) >> 14 & 1:
                assert process.poll() is None
        else:
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


def test_node_that_security_keeps_out_ends_with_the_reason_and_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Whether or not this ROS knows security, it can't do with an enclave without keys.
    (tmp_path / "enclaves" / "mp_pca_planner").mkdir(parents=True)
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    with (tmp_path / "log.txt").open("w+") as log:
        process = start_node("--enclave", "/mp_pca_planner", output=log)
        assert process.wait(timeout=HANG) == 2
        log.seek(0)
        said = log.read()
    assert "ROS refuses the node: error creating node: " in said
    assert "Traceback" not in said


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
