# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the running node share."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from arm import JOINTS, arm_primitive
from patience import HANG, NODE_EVER
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.resources import config_file
from mp_pca_planner.ros.client import GoalClient, start_node, this_machine_only

MOTION = arm_primitive().boundary_states[0]
START, GOAL = MOTION[0].tolist(), MOTION[3].tolist()
URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")

# Tests publish a state once, and the machine may be busy: how long states are good for, and plans
# may take [s].
PATIENCE = {"state_timeout": NODE_EVER, "max_solve_time": NODE_EVER}
PATIENTLY = tuple(word for name, time in PATIENCE.items() for word in ("-p", f"{name}:={time}"))


@contextmanager
def running_node(
    log: Path, *ros_arguments: str, options: Sequence[str] = ()
) -> Iterator[subprocess.Popen[str]]:
    """A node that has to end cleanly."""
    with log.open("w") as output:
        process = start_node(*ros_arguments, options=options, output=output)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            status = process.wait(timeout=HANG)
        finally:
            process.kill()
    assert status == 0, log.read_text()
    assert "Traceback" not in log.read_text()


@contextmanager
def described_client() -> Iterator[GoalClient]:
    """A client of a node that has a model: its only robot description is that of the topic."""
    with GoalClient() as client:
        client.wait_for_node()
        client.publish_description(URDF)
        client.wait_for_model()
        yield client


def set_domain(patch: pytest.MonkeyPatch, offset: int) -> None:
    """Meet only nodes of this test run: those of the same offset."""
    for name, value in this_machine_only(1 + (os.getpid() + offset) % 101).items():
        patch.setenv(name, value)


@contextmanager
def ros_node(name: str) -> Iterator[Node]:
    """A node of the test's own."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def call(node: Node, kind: Any, name: str, request: Any) -> Any:
    """What a service answers."""
    client = node.create_client(kind, name)
    assert client.wait_for_service(HANG)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    # DDS may find the service before the service finds the client; then the answer is lost.
    for _ in range(3):
        future = client.call_async(request)
        executor.spin_until_future_complete(future, 10.0)
        if future.done():
            return future.result()
    raise AssertionError(f"{name} did not answer")


def goal_message(
    positions: list[float] = GOAL, names: tuple[str, ...] = JOINTS, **fields: object
) -> JointState:
    return JointState(name=list(names), position=list(positions), **fields)


def times(trajectory: JointTrajectory) -> list[int]:
    """Times from start [ns]."""
    stamps = [point.time_from_start for point in trajectory.points]
    return [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]


def column(trajectory: JointTrajectory, field: str) -> np.ndarray:
    return np.array([getattr(point, field) for point in trajectory.points])
