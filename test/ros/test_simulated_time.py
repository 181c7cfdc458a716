# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node by a simulator's clock, which may stand still, run, and jump."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENCE,
    START,
    column,
    described_client,
    goal_message,
    ros_node,
    running_node,
    times,
    words,
)
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow

DURATION = 4.0


def test_motions_start_where_the_robot_is_by_the_simulators_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 50)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    values = {
        "use_sim_time": True,
        "primitives": [str(tmp_path / "arm.npz")],
        "start_from": "commanded",
        "following_tolerance": 10.0,
        "duration": DURATION,
        **PATIENCE,
    }
    with (
        running_node(tmp_path / "log.txt", *words(**values)),
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
        set_time(10.0 + DURATION / 2.0)
        stamps, q = 1e-9 * np.array(times(running)), column(running, "positions")
        send(GOAL, [float(np.interp(DURATION / 2.0, stamps, joint)) for joint in q.T])
        # Before the running motion began, it can't be where the robot is.
        set_time(5.0)
        send(START, GOAL)
