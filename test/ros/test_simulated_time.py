# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node by a simulator's clock, which may stand still, run, and jump."""

from __future__ import annotations

from collections.abc import Iterator
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
    NodeClient,
    column,
    described_client,
    goal_message,
    ros_node,
    running_node,
    times,
)
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow

DURATION = 4.0


class Simulation:
    """A simulator whose clock the test sets; the robot is where it says."""

    def __init__(self, client: NodeClient, clock: object) -> None:
        self._client = client
        self._clock = clock

    def set_time(self, seconds: float) -> None:
        """Set the clock, and wait until the node has seen it: it stamps its diagnostics."""
        time = Time(sec=int(seconds), nanosec=round(seconds % 1.0 * 1e9))
        self._clock.publish(Clock(clock=time))
        self._client.wait_for_diagnostics(
            lambda _: self._client.diagnostics[-1].header.stamp == time
        )

    def send(self, positions: list[float], measured: list[float]) -> JointTrajectory:
        """Send a goal for a robot that is measured there, at rest."""
        self._client.publish_state(JOINTS, measured)
        answer = self._client.send(goal_message(positions))
        assert answer.trajectory is not None, answer.report.message
        return answer.trajectory


@pytest.fixture
def simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Simulation]:
    set_domain(monkeypatch, 50)
    file = tmp_path / "arm.npz"
    save_primitive(arm_primitive(), file)
    values = {
        "use_sim_time": True,
        "primitives": [str(file)],
        "start_from": "commanded",
        "following_tolerance": 10.0,
        "duration": DURATION,
        **PATIENCE,
    }
    arguments = [word for k, v in values.items() for word in ("-p", f"{k}:={v}")]
    with (
        running_node(tmp_path / "log.txt", *arguments),
        ros_node("simulator") as simulator,
        described_client() as client,
    ):
        yield Simulation(client, simulator.create_publisher(Clock, "/clock", 10))


def state_at(trajectory: JointTrajectory, seconds: float) -> np.ndarray:
    """Position there; points are near to each other."""
    stamps = np.array(times(trajectory)) * 1e-9
    return np.array([np.interp(seconds, stamps, q) for q in column(trajectory, "positions").T])


def first(trajectory: JointTrajectory) -> np.ndarray:
    return column(trajectory, "positions")[0]


def test_motions_start_where_the_robot_is_by_the_simulators_clock(simulation: Simulation) -> None:
    # Before the first message of the clock it is 0, and stands still.
    waiting = simulation.send(GOAL, START)
    np.testing.assert_allclose(first(waiting), START)
    simulation.set_time(10.0)  # a jump over the motion's end
    running = simulation.send(START, GOAL)
    np.testing.assert_allclose(first(running), GOAL)
    # However long it took to send the next goal: by its clock the robot is half way.
    simulation.set_time(10.0 + DURATION / 2.0)
    half_way = state_at(running, DURATION / 2.0)
    back = simulation.send(GOAL, half_way.tolist())
    np.testing.assert_allclose(first(back), half_way, atol=1e-4)
    # Before the running motion began, it can't be where the robot is.
    simulation.set_time(5.0)
    again = simulation.send(START, GOAL)
    np.testing.assert_allclose(first(again), GOAL)
