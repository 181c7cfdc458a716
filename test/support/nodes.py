# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the running node share."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import Parameter, SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.arm import JOINTS, arm_primitive
from support.node_setup import RobotClient, start_node
from support.patience import HANG, NODE_EVER
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from mp_pca_planner.files import config_file
from mp_pca_planner.ros.nodes import LATCHED

MOTION = arm_primitive().boundary_states[0]
START, GOAL = MOTION[0].tolist(), MOTION[3].tolist()
URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")

# Tests publish a state once, and the machine may be busy: how long states are good for, and plans
# may take [s].
PATIENCE = {"state_timeout": NODE_EVER, "max_solve_time": NODE_EVER}
PATIENTLY = tuple(word for name, time in PATIENCE.items() for word in ("-p", f"{name}:={time}"))


class NodeClient(RobotClient):
    """A client that plays the robot and the operator, too.

    Attributes
    ----------
    previews : list of MarkerArray
        All that were received, the newest last.
    """

    def __init__(self, *arguments: str, **names: str) -> None:
        super().__init__(*arguments, **names)
        self.previews: list[MarkerArray] = []
        parameters = f"{self.planner}/set_parameters"
        self._services["set_parameters"] = self.node.create_client(SetParameters, parameters)
        preview = f"{self.planner}/preview"
        self.node.create_subscription(MarkerArray, preview, self.previews.append, LATCHED)

    def publish_state(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> None:
        self.publish_state_message(
            JointState(name=list(names), position=list(positions), velocity=list(velocities))
        )

    def publish_state_message(self, message: JointState) -> None:
        self.publish("joint_states", message)

    def publish_description(self, urdf: str) -> None:
        self.publish("robot_description", String(data=urdf))

    def set_parameters(self, *parameters: Parameter) -> list[SetParametersResult]:
        """Set parameters one by one."""
        request = SetParameters.Request(parameters=list(parameters))
        return list(self.result(self._services["set_parameters"], request).results)

    def stop(self, timeout: float = 10.0) -> tuple[Trigger.Response, JointTrajectory | None]:
        """What is answered to a stop, and what is published."""
        n = len(self.trajectories)
        answer = self.call("stop")
        return answer, self.next_trajectory(n, timeout) if answer.success else None

    def wait_for_preview(
        self, is_expected: Callable[[MarkerArray], bool] = bool, timeout: float = 10.0
    ) -> MarkerArray:
        """The newest preview, once it is as expected: it comes a little after its motion."""
        self.wait(
            lambda: bool(self.previews) and is_expected(self.previews[-1]),
            timeout,
            "published no such preview",
        )
        return self.previews[-1]


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
    assert status == 0, f"status {status}\n{log.read_text()}"
    assert "Traceback" not in log.read_text()


def planner_of(node: subprocess.Popen[str]) -> int:
    """The process in which a node plans: its first child that was spawned."""
    children = Path(f"/proc/{node.pid}/task/{node.pid}/children").read_text().split()
    commands = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return next(child for child, command in commands.items() if b"spawn_main" in command)


@contextmanager
def described_client() -> Iterator[NodeClient]:
    """A client of a node that has a model: its only robot description is that of the topic."""
    with NodeClient() as client:
        client.wait_for_node()
        client.publish_description(URDF)
        client.wait_for_model()
        yield client


@contextmanager
def ros_node(name: str, kind: Any = Node) -> Iterator[Any]:
    """A node of the test's own, of a kind of `Node`."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = kind(name, context=context)
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
