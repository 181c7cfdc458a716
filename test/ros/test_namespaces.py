# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A node in a namespace, with other names of topics."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.executors import SingleThreadedExecutor
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENCE,
    START,
    URDF,
    NodeClient,
    ros_node,
    running_node,
    words,
)
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow


def test_node_in_a_namespace_feeds_the_controller_that_it_is_remapped_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 25)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    arguments = (*words(primitives=[str(tmp_path)], **PATIENCE), "-r", "__ns:=/left")
    arguments += ("-r", "__node:=planner", "-r", "~/joint_trajectory:=controller/joint_trajectory")
    executed: list[JointTrajectory] = []
    with (
        running_node(tmp_path / "log.txt", *arguments),
        NodeClient(namespace="left", planner="planner") as client,
        ros_node("controller_manager") as controllers,
    ):
        controllers.create_subscription(
            JointTrajectory, "/left/controller/joint_trajectory", executed.append, 10
        )
        executor = SingleThreadedExecutor(context=controllers.context)
        executor.add_node(controllers)
        client.publish_description(URDF)
        client.wait_for_node(with_trajectory=False)
        client.wait_for_model()
        client.publish_state(JOINTS, START)
        goal = ",".join(f"{name}={value!r}" for name, value in zip(JOINTS, GOAL, strict=True))
        there = ("--namespace", "left", "--node", "planner")
        assert main(["send_goal", goal, "--wait", "0", *there]) == 0
        deadline = time.monotonic() + HANG
        while not executed and time.monotonic() < deadline:
            executor.spin_once(0.1)
        # A client waits for no motion where others get it.
        answer, trajectory = client.stop()
    assert answer.success, answer.message
    assert trajectory is None and not client.trajectories
    assert list(executed[0].points[-1].positions) == GOAL
