# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that are started otherwise: managed, in a namespace, by a simulator's clock, and so on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import yaml
from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python
from rosgraph_msgs.msg import Clock
from support.arm import GRIPPER_URDF, JOINTS, URDF, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENCE,
    START,
    NodeClient,
    arm_node,
    call,
    column,
    described_client,
    goal_message,
    ros_node,
    running_node,
    times,
)
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    set_domain(monkeypatch, 41)


def test_managed_node_plans_when_it_is_active_only() -> None:
    with (
        arm_node(n_primitives=0, options=["--managed"], **PATIENCE) as (_, folder),
        ros_node("manager") as manager,
        NodeClient() as client,
    ):
        client.wait_for_node()
        client.publish_description(URDF)

        def change(name: str) -> bool:
            number = getattr(Transition, f"TRANSITION_{name}")
            request = ChangeState.Request(transition=Transition(id=number))
            return call(manager, ChangeState, "mp_pca_planner/change_state", request).success

        def state() -> str:
            there = "mp_pca_planner/get_state"
            return call(manager, GetState, there, GetState.Request()).current_state.label

        def refusal() -> str:
            answer = client.send(goal_message())
            assert answer.trajectory is None
            assert answer.values["status"] == "refused"
            return answer.report.message

        def serves() -> bool:
            client.publish_state(JOINTS, START)
            client.wait_for_diagnostics(lambda values: values["joint_states_age_s"] != "none")
            return client.send(goal_message()).trajectory is not None

        assert not change("ACTIVATE"), "it is not configured"
        assert not change("CONFIGURE"), "there is no primitive file"
        assert state() == "unconfigured"
        save_primitive(arm_primitive(), folder / "primitives" / "arm.npz")
        assert change("CONFIGURE")
        assert "the node is not active" in refusal()
        assert not client.stop()[0].success
        assert change("ACTIVATE")
        assert serves()
        n = len(client.trajectories)
        assert change("DEACTIVATE")
        assert client.next_trajectory(n, HANG) is not None  # the motion is stopped
        assert "the node is not active" in refusal()
        assert client.stop()[0].success
        assert change("CLEANUP")
        assert state() == "unconfigured"
        assert client.wait_for_diagnostics()["library"] == "none"
        assert change("CONFIGURE") and change("ACTIVATE")
        assert serves()


def test_node_in_a_namespace_feeds_the_controller_that_it_is_remapped_to() -> None:
    remapped = ("-r", "__ns:=/left", "-r", "__node:=planner")
    remapped += ("-r", "~/joint_trajectory:=controller/joint_trajectory")
    executed: list[JointTrajectory] = []
    with (
        arm_node(*remapped, **PATIENCE),
        NodeClient(namespace="left", planner="planner") as client,
    ):
        topic = "/left/controller/joint_trajectory"
        client.node.create_subscription(JointTrajectory, topic, executed.append, 10)
        client.publish_description(URDF)
        client.wait_for_node(with_trajectory=False)
        client.wait_for_model()
        client.publish_state(JOINTS, START)
        goal = ",".join(f"{name}={value!r}" for name, value in zip(JOINTS, GOAL, strict=True))
        there = ("--namespace", "left", "--node", "planner")
        assert main(["send_goal", goal, "--wait", "0", *there]) == 0
        client.wait(lambda: bool(executed), HANG, "moved no controller")
        # A client waits for no motion where others get it.
        answer, trajectory = client.stop()
    assert answer.success, answer.message
    assert trajectory is None and not client.trajectories
    assert list(executed[0].points[-1].positions) == GOAL


def test_finger_with_a_mass_is_locked_where_it_is_measured_or_goals_are_refused() -> None:
    with arm_node(**PATIENCE), NodeClient() as client:
        client.wait_for_node()
        client.publish_description(GRIPPER_URDF)
        client.wait_for_model()
        client.publish_state(JOINTS, START)
        client.wait_for_diagnostics(lambda values: "'finger' are not known" in values["text"])
        answer = client.send(goal_message(GOAL))
        assert answer.trajectory is None
        assert "joints 'finger' are not known" in answer.report.message
        for position, names in ((0.01, ("finger", *JOINTS)), (0.02, ("finger",))):
            # The second time from another publisher: the states of the arm come without it.
            client.publish_state(names, [position, *START][: len(names)])
            client.publish_state(JOINTS, START)
            answer = client.send(goal_message(GOAL))
            assert answer.trajectory is not None, answer.report.message
            assert client.wait_for_diagnostics()["locked_joints"] == f"finger={position}"
            client.call("stop", HANG)  # the robot rests, and may be sent there again


def test_motions_start_where_the_robot_is_by_the_simulators_clock() -> None:
    """The clock stands still, runs, and jumps."""
    duration = 4.0
    given = {"use_sim_time": True, "start_from": "commanded", "following_tolerance": 10.0}
    with (
        arm_node(**given, duration=duration, **PATIENCE),
        ros_node("simulator") as simulator,
        described_client() as client,
    ):
        publisher = simulator.create_publisher(Clock, "/clock", 10)

        def set_time(seconds: float) -> None:
            """Set the clock, and wait until the node has seen it: it stamps its diagnostics."""
            time = Time(sec=int(seconds), nanosec=round(seconds % 1.0 * 1e9))
            publisher.publish(Clock(clock=time))
            client.wait_for_diagnostics(lambda _: client.diagnostics[-1].header.stamp == time)

        def send(goal: list[float], measured: list[float]) -> JointTrajectory:
            """Send a goal for a robot that is measured there, where its motion has to start."""
            client.publish_state(JOINTS, measured)
            trajectory = client.send(goal_message(goal)).trajectory
            assert trajectory is not None
            np.testing.assert_allclose(trajectory.points[0].positions, measured, atol=1e-4)
            return trajectory

        # Before the first message of the clock it is 0, and stands still.
        send(GOAL, START)
        set_time(10.0)  # a jump over the motion's end
        running = send(START, GOAL)
        # However long it took to send the next goal: by its clock the robot is half way.
        set_time(10.0 + duration / 2.0)
        stamps, q = 1e-9 * np.array(times(running)), column(running, "positions")
        send(GOAL, [float(np.interp(duration / 2.0, stamps, joint)) for joint in q.T])
        # Before the running motion began, it can't be where the robot is.
        set_time(5.0)
        send(START, GOAL)


def test_parameters_written_to_a_file_make_the_next_node_the_same(tmp_path: Path) -> None:
    """The file is what ``ros2 param dump`` writes."""
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    file, there = tmp_path / "parameters.yaml", "/mp_pca_planner"
    values: dict[str, Any] = {
        "primitives": [str(tmp_path / "arm.npz")],
        "robot_description": URDF,
        "limits.elbow.max_velocity": 0.7,
        "duration": 2.5,
        "publish_effort": True,
        "start_from": "commanded",
    }
    for name in ("first", "second"):
        content = {there: {"ros__parameters": values}}
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        with (
            running_node(tmp_path / f"{name}.txt", "--params-file", str(file)),
            ros_node("caller") as caller,
        ):
            listing = ListParameters.Request()
            names = call(caller, ListParameters, f"{there}/list_parameters", listing).result.names
            request = GetParameters.Request(names=names)
            found = call(caller, GetParameters, f"{there}/get_parameters", request).values
        dumped = dict(zip(names, map(parameter_value_to_python, found), strict=True))
        assert dumped.items() >= values.items()
        values = dumped
