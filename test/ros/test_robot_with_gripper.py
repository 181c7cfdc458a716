# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A robot whose primitive moves the arm alone: goals of the whole robot, and the commands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from support.arm import JOINTS, arm_primitive, arm_robot
from support.domains import set_domain
from support.nodes import GOAL, PATIENTLY, START, URDF, NodeClient, goal_message, running_node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import load_primitive, save_primitive

FINGER = """
  <joint name="finger" type="prismatic">
    <parent link="wrist"/><child link="finger_link"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" velocity="0.1" effort="10"/>
  </joint>
  <link name="finger_link"/>
</robot>"""
GRIPPER_URDF = URDF.replace("</robot>", FINGER)
WHOLE_ROBOT = ("finger", *JOINTS)
NODE_NAMES = ("--node", "mp_pca_planner")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gripper")


@pytest.fixture(scope="module")
def shared_client(folder: Path) -> Iterator[NodeClient]:
    save_primitive(arm_primitive(), folder / "arm.npz")
    arguments = ["-p", f"primitives:=['{folder / 'arm.npz'}']", "-p", f"save_folder:={folder}"]
    arguments += ["-p", "end_effector_frame:=wrist", *PATIENTLY]
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 33)
        with running_node(folder / "log.txt", *arguments), NodeClient() as client:
            client.wait_for_node()
            client.publish_description(GRIPPER_URDF)
            client.wait_for_model()
            yield client


@pytest.fixture
def client(shared_client: NodeClient, folder: Path) -> NodeClient:
    """A client of the node, which knows of no motion; the robot rests at the start."""
    for paths in ([""], [str(folder / "arm.npz")]):
        message = Parameter("primitives", value=paths).to_parameter_msg()
        (result,) = shared_client.set_parameters(message)
        assert result.successful, result.reason
    shared_client.publish_state(WHOLE_ROBOT, [0.02, *START])
    return shared_client


def assert_finger_is_left(report: DiagnosticStatus) -> None:
    assert report.level == DiagnosticStatus.WARN
    assert "'finger' of the goal are not moved" in report.message


def test_goal_of_the_whole_robot_moves_the_arm_with_a_warning(client: NodeClient) -> None:
    answer = client.send(goal_message([0.0, *GOAL], WHOLE_ROBOT))
    assert_finger_is_left(answer.report)
    assert answer.trajectory is not None
    assert list(answer.trajectory.joint_names) == list(JOINTS)
    np.testing.assert_allclose(answer.trajectory.points[-1].positions, GOAL)


def test_sequence_of_the_whole_robot_moves_the_arm_with_a_warning(client: NodeClient) -> None:
    message = JointTrajectory(joint_names=list(WHOLE_ROBOT))
    for q in (GOAL, START):
        message.points.append(JointTrajectoryPoint(positions=[0.04, *q]))
    answer = client.send(message)
    assert_finger_is_left(answer.report)
    assert answer.trajectory is not None
    np.testing.assert_allclose(answer.trajectory.points[-1].positions, START)


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        (("finger",), [0.0], "the primitives do not move 'finger' of the goal"),
        (("finger", "elbo"), [0.0, -1.0], "did you mean 'elbow'"),
        (("finger", "elbow"), [float("nan"), -1.0], "finite"),
    ],
)
def test_goal_without_a_joint_of_the_primitive_is_refused(
    client: NodeClient, names: tuple[str, ...], positions: list[float], words: str
) -> None:
    answer = client.send(goal_message(positions, names))
    assert answer.report.level == DiagnosticStatus.ERROR
    assert words in answer.report.message


@pytest.mark.slow
def test_finger_with_a_mass_is_locked_where_it_is_measured_or_goals_are_refused(
    shared_client: NodeClient, folder: Path
) -> None:
    client = shared_client
    massive = (
        '<link name="finger_link"><inertial><mass value="0.3"/><inertia ixx="1e-4" iyy="1e-4" '
        'izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    # Another name, whose position no message has had.
    client.publish_description(
        GRIPPER_URDF.replace('<link name="finger_link"/>', massive).replace('"finger"', '"thumb"')
    )
    client.publish_state(JOINTS, START)
    client.wait_for_diagnostics(lambda values: "'thumb' are not known" in values["text"])
    answer = client.send(goal_message(GOAL))
    assert answer.trajectory is None
    assert "joints 'thumb' are not known" in answer.report.message
    for position in (0.01, 0.03):
        client.publish_state(("thumb", *JOINTS), [position, *START])
        answer = client.send(goal_message(GOAL))
        assert answer.trajectory is not None, answer.report.message
        assert client.wait_for_diagnostics()["locked_joints"] == f"thumb={position}"
    # From another publisher, while the states of the arm come without it.
    client.publish_state(("thumb",), [0.02])
    client.publish_state(JOINTS, START)
    answer = client.send(goal_message(GOAL))
    assert answer.trajectory is not None, answer.report.message
    assert client.wait_for_diagnostics()["locked_joints"] == "thumb=0.02"
    client.publish_description(GRIPPER_URDF)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """The status and the output of a command."""
    status = main([*arguments, *NODE_NAMES])
    output = capsys.readouterr()
    return status, output.out + output.err


def test_command_sends_a_pose(client: NodeClient, capsys: pytest.CaptureFixture[str]) -> None:
    robot = arm_robot()
    points = robot.attach_points(["wrist"] * 4, np.vstack([np.zeros(3), np.eye(3)]))
    (corners,), _ = points.positions_and_jacobians(np.array([GOAL]))
    turn = (corners[1:] - corners[0]).T
    w = np.sqrt(1.0 + np.trace(turn)) / 2.0
    x, y, z = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    quaternion = np.array([x, y, z, 4.0 * w * w]) / (4.0 * w)
    pose = " ".join(map(str, [*corners[0], *quaternion]))
    n = len(client.trajectories)
    status, output = run(capsys, "send_goal", "--pose", pose, "--wait", "0")
    assert status == 0, output
    client.wait(lambda: len(client.trajectories) > n, 10.0, "published no trajectory")
    end = np.array([client.trajectories[-1].points[-1].positions])
    np.testing.assert_allclose(robot.frame_positions(end, ["wrist"])[0, 0], corners[0], atol=1e-5)
    status, output = run(capsys, "send_goal", "--pose", pose, "--frame", "hand", "--wait", "0")
    assert status == 2
    assert "'hand'" in output


def test_command_stops_the_robot(client: NodeClient, capsys: pytest.CaptureFixture[str]) -> None:
    n = len(client.trajectories)
    status, output = run(capsys, "stop", "--json")
    assert status == 0
    assert json.loads(output)["success"] is True
    client.wait(lambda: len(client.trajectories) > n, 10.0, "published no stop")


def test_commands_save_the_motion_and_reload_the_primitives(
    client: NodeClient, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    client.send(goal_message())
    status, output = run(capsys, "call", "save_motion")
    assert status == 0
    name = load_primitive(folder / f"{arm_primitive().name}_1.npz").name
    assert f"{name}.npz" in output
    status, output = run(capsys, "call", "reload")
    assert (status, output) == (0, f"loaded: '{arm_primitive().name}'\n")
    good = (folder / "arm.npz").read_bytes()
    (folder / "arm.npz").write_bytes(b"damaged")
    status, output = run(capsys, "call", "reload")
    (folder / "arm.npz").write_bytes(good)
    assert status == 1
    assert output.count("\n") == 1
    assert "kept" in output


@pytest.mark.parametrize("command", ["stop", "call save_motion", "call reload"])
def test_command_without_a_node_says_so(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_domain(monkeypatch, 34)
    assert main([*command.split(), "--timeout", "0.5"]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert "'mp_pca_planner' is not there within 0.5 s" in output.err
