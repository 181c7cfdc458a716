# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What may go wrong around the node while it runs: it says so, and goes on."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import ListParameters
from rclpy.parameter import Parameter
from support.arm import JOINTS, arm_demonstrations, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENTLY,
    START,
    URDF,
    NodeClient,
    call,
    described_client,
    goal_message,
    planner_of,
    ros_node,
    running_node,
    start_node,
)
from support.patience import HANG

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.ros.client import Answer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Has the folders `primitives`, which the node plans with, and `kept`, in which it saves."""
    folder = tmp_path_factory.mktemp("faults")
    (folder / "primitives").mkdir()
    (folder / "kept").mkdir()
    save_primitive(arm_primitive(), folder / "primitives" / "arm.npz")
    return folder


@pytest.fixture(scope="module")
def node(folder: Path) -> Iterator[subprocess.Popen[str]]:
    arguments = ["-p", f"primitives:=['{folder / 'primitives'}']", *PATIENTLY]
    arguments += ["-p", f"save_folder:='{folder / 'kept'}'"]
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 75)
        with running_node(folder / "log.txt", *arguments) as process:
            yield process


@pytest.fixture(scope="module")
def client(node: subprocess.Popen[str]) -> Iterator[NodeClient]:
    with described_client() as client:
        client.publish_state(JOINTS, START)
        yield client


# A goal that repeats is answered without a motion.
NEW_GOALS = (goal_message([*GOAL[:3], GOAL[3] - 0.01 * k]) for k in count())


def primitive_used(client: NodeClient) -> str:
    client.publish_state(JOINTS, START)
    answer = client.send(next(NEW_GOALS))
    assert answer.report.level != DiagnosticStatus.ERROR, answer.report.message
    return answer.values["primitive"]


def of_other_joints(names: tuple[str, ...]) -> MovementPrimitive:
    """The primitive of a robot whose joints are called otherwise."""
    renamed = [
        type(d)(
            names,
            d.times,
            d.positions,
            d.velocities,
            d.accelerations,
            recording=d.recording,
            start_time=d.start_time,
            end_time=d.end_time,
        )
        for d in arm_demonstrations()
    ]
    return build_primitive(renamed, "other_robot")


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


def test_motion_that_does_not_fit_on_the_disk_leaves_no_part_of_a_file(
    client: NodeClient, node: subprocess.Popen[str], folder: Path
) -> None:
    primitive_used(client)
    with full_disk(node):
        answer = client.call("save_motion")
    assert not answer.success
    assert "can't be written: File too large" in answer.message
    assert not list((folder / "kept").iterdir())
    answer = client.call("save_motion")
    assert answer.success, answer.message
    (file,) = (folder / "kept").iterdir()
    assert load_primitive(file).joint_names == tuple(JOINTS)


@pytest.mark.slow
def test_primitives_may_vanish_and_come_back_while_the_node_runs(
    client: NodeClient, folder: Path
) -> None:
    file = folder / "primitives" / "arm.npz"
    content = file.read_bytes()
    file.unlink()
    try:
        assert primitive_used(client) == "arm_arm_4"
        answer = client.call("reload_primitives")
        assert not answer.success
        assert "holds no primitive file" in answer.message
        assert client.wait_for_diagnostics()["text"] in answer.message
        assert primitive_used(client) == "arm_arm_4"
        # Another one under the same name takes its place.
        save_primitive(arm_primitive("joint"), file)
        assert client.call("reload_primitives").success
        assert primitive_used(client) == "arm_joint_4"
    finally:
        file.write_bytes(content)
    assert client.call("reload_primitives").success
    assert client.wait_for_diagnostics()["text"] == "ready for goals"


def test_primitive_of_another_robot_is_refused_and_leaves_no_trace(
    client: NodeClient, folder: Path
) -> None:
    mine, other = folder / "primitives" / "arm.npz", folder / "other.npz"
    content = mine.read_bytes()
    save_primitive(of_other_joints(("a", "b", "c", "d")), other)
    mine.write_bytes(other.read_bytes())
    try:
        answer = client.call("reload_primitives")
    finally:
        mine.write_bytes(content)
    assert not answer.success
    assert "'a'" in answer.message
    assert "'arm_arm_4' kept" in answer.message
    assert primitive_used(client) == "arm_arm_4"
    with ros_node("lister") as lister:
        request = ListParameters.Request(prefixes=["limits"])
        names = call(lister, ListParameters, "/mp_pca_planner/list_parameters", request).result
    assert {name.split(".")[1] for name in names.names} == set(JOINTS)
    assert client.call("reload_primitives").success


def answer_once(client: NodeClient, is_wanted: Callable[[Answer], bool]) -> Answer:
    """The first wanted answer to a goal: topics are not in step with each other."""
    deadline = time.monotonic() + HANG
    while True:
        client.publish_state(JOINTS, START)
        answer = client.send(next(NEW_GOALS))
        if is_wanted(answer):
            return answer
        assert time.monotonic() < deadline, answer.report.message


def test_robot_may_be_exchanged_for_another_while_the_node_runs(client: NodeClient) -> None:
    for other, words in (
        (URDF.replace('name="elbow"', 'name="knee"'), "'elbow'"),
        (URDF[: len(URDF) // 2], "not XML"),
        ("", "robot_description"),
    ):
        client.publish_description(other)
        answer = answer_once(client, lambda answer, words=words: words in answer.report.message)
        assert answer.report.level == DiagnosticStatus.ERROR
        stopped, hold = client.stop()  # with what was known of the robot
        assert stopped.success and len(hold.points) == 1
    client.publish_description(URDF)
    cost = float(answer_once(client, lambda answer: answer.trajectory).values["effort_cost"])
    # All links weigh more: the same goal takes more effort.
    client.publish_description(URDF.replace('<mass value="', '<mass value="1'))
    answer_once(client, lambda answer: float(answer.values.get("effort_cost", 0.0)) > 2.0 * cost)


def test_names_in_primitives_and_goals_are_no_paths(client: NodeClient, folder: Path) -> None:
    client.publish_description(URDF)
    client.wait_for_model()
    evil = folder / "primitives" / "evil.npz"
    name = f"../..{folder}/../evil"
    save_primitive(build_primitive(arm_demonstrations(), name), evil)
    files = set(folder.parent.rglob("*"))
    try:
        assert client.call("reload_primitives").success
        client.publish_state(JOINTS, START)
        goal = next(NEW_GOALS)
        goal.header.frame_id = name
        assert client.send(goal).values["primitive"] == name
        answer = client.call("save_motion")
        assert answer.success, answer.message
        (new,) = set(folder.parent.rglob("*")) - files
        assert new.parent == folder / "kept"
        goal.header.frame_id = str(evil)
        assert "no primitive is called" in client.send(goal).report.message
    finally:
        evil.unlink()
    assert client.call("reload_primitives").success


LONG = "x" * 5000


@pytest.mark.parametrize(
    ("name", "value"),
    [("primitives", [LONG]), ("limits_file", LONG), ("save_folder", LONG), ("save_folder", "\x1b")],
)
def test_texts_that_no_file_can_be_called_are_refused_in_one_line(
    client: NodeClient, folder: Path, name: str, value: object
) -> None:
    primitive_used(client)
    (result,) = client.set_parameters(Parameter(name, value=value).to_parameter_msg())
    answer = client.call("save_motion") if result.successful else result
    said = answer.message if result.successful else answer.reason
    kept = Parameter("save_folder", value=str(folder / "kept")).to_parameter_msg()
    assert client.set_parameters(kept)[0].successful
    assert 0 < len(said) < 1100
    assert said.isprintable()
    assert "internal error" not in said
    primitive_used(client)


LISTENER = """
import sys
from mp_pca_planner.ros.client import GoalClient
with GoalClient("controller") as client:
    client.wait_for_node()
    print("matched", flush=True)
    while True:
        client.spin_once()
"""


@pytest.mark.slow
def test_controller_that_vanishes_does_not_hold_the_node_up(client: NodeClient) -> None:
    listener = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
    assert listener.stdout is not None
    with listener:
        try:
            assert listener.stdout.readline() == "matched\n"
        finally:
            listener.kill()
    # More than the reliable publishers keep for those who don't answer.
    client.publish_state(JOINTS, START)
    for _ in range(150):
        assert client.send(goal_message([9.0] * 4)).report.level == DiagnosticStatus.ERROR
        answer, trajectory = client.stop()
        assert trajectory is not None, answer.message


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
