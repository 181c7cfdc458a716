# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Common parts of benchmarks and tests of the node: it, a client, joint states, CPU and memory."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path
from subprocess import Popen
from typing import IO, Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import GoalClient
from mp_pca_planner.ros.nodes import LATCHED

URDF = config_file("human_arm.urdf")
# Fresh processes: ROS does not survive a fork.
PROCESSES = multiprocessing.get_context("spawn")


class RobotClient(GoalClient):
    """A client that plays the robot, too; its joint states may have another topic."""

    def __init__(self, *arguments: str, joint_states: str = "joint_states", **names: str) -> None:
        super().__init__(*arguments, **names)
        node = self.node
        self._publishers |= {
            "joint_states": node.create_publisher(JointState, joint_states, 1),
            "robot_description": node.create_publisher(String, "robot_description", LATCHED),
        }

    def publish(self, topic: str, message: Any) -> None:
        """Publish on a goal topic, ``joint_states`` or ``robot_description``."""
        self._publishers[topic].publish(message)

    def wait_for_model(self) -> None:
        """Wait until the node has primitives and a robot model."""
        self.wait_for_diagnostics(lambda values: values["model"] != "none")


def start_node(
    *ros_arguments: str, options: Sequence[str] = (), output: IO[str] | None = None
) -> Popen[str]:
    """Start the node in a process of its own.

    Parameters
    ----------
    ros_arguments :
        The arguments after ``--ros-args``.
    options :
        The arguments before.
    output :
        File for its output; that of this process by default.
    """
    command = [sys.executable, "-m", "mp_pca_planner", "planner_node", *options]
    command += ["--ros-args", *ros_arguments]
    return subprocess.Popen(command, stdout=output, stderr=output, text=True)


@contextmanager
def primitive_file() -> Iterator[Path]:
    """A primitive of the human-like arm."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "raise_arm.npz"
        demonstrations = generate_motions(20, seed=1)
        save_primitive(build_primitive(demonstrations, "raise_arm"), file)
        yield file


@contextmanager
def running_node(*ros_arguments: str) -> Iterator[Popen[str]]:
    """Context manager of a node, which is stopped at the end."""
    with primitive_file() as file:
        node = start_node("-p", f"primitives:=['{file}']", *ros_arguments)
        try:
            yield node
        finally:
            node.terminate()
            node.wait(timeout=20.0)


@contextmanager
def joint_states(rate: float, positions: list[float]) -> Iterator[None]:
    """Context manager of a process that publishes a joint state at a fixed rate."""
    is_ready = PROCESSES.Event()
    arguments = (rate, positions, is_ready)
    process = PROCESSES.Process(target=_publish_states, args=arguments, daemon=True)
    process.start()
    try:
        is_ready.wait(60.0)
        yield
    finally:
        process.kill()
        process.join()


def _publish_states(rate: float, positions: list[float], is_ready: Event) -> None:
    state = JointState(name=JOINT_NAMES, position=positions, velocity=[0.0] * len(positions))
    # Serialised once, because the driver of a real robot needs less CPU time than Python.
    message = bytes(serialize_message(state))
    with silent_node("joint_state_broadcaster") as node:
        publisher = node.create_publisher(JointState, "joint_states", 1)
        while not publisher.get_subscription_count():
            time.sleep(0.01)
        is_ready.set()
        due = time.monotonic()
        while True:
            publisher.publish(message)
            due = max(due + 1.0 / rate, time.monotonic() - 0.1)
            time.sleep(max(due - time.monotonic(), 0.0))


@contextmanager
def silent_node(name: str) -> Iterator[Node]:
    """A node with the given parameters only."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(
        name, context=context, enable_rosout=False, start_parameter_services=False
    )
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def processes_of(node: Popen[str]) -> list[int]:
    """The process of a node, and its workers."""
    children = Path(f"/proc/{node.pid}/task/{node.pid}/children").read_text(encoding="ascii")
    return [node.pid, *map(int, children.split())]


def processor_time(node: Popen[str]) -> float:
    """CPU time of the node and its workers [s]."""
    ticks = 0
    for process in processes_of(node):
        text = Path(f"/proc/{process}/stat").read_text(encoding="ascii")
        ticks += sum(map(int, text.rpartition(")")[2].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def resident_megabytes(node: Popen[str]) -> list[float]:
    """Resident memory of the node and of its workers [MB]."""
    pages = [int(Path(f"/proc/{x}/statm").read_text().split()[1]) for x in processes_of(node)]
    return [n * os.sysconf("SC_PAGE_SIZE") / 1e6 for n in pages]


def print_latencies(latencies: np.ndarray, solve_times: np.ndarray) -> None:
    """Medians and 99th percentiles of the latency from goal to trajectory and of its parts [s]."""
    for name, values in (
        ("goal to trajectory", latencies),
        ("solve time", solve_times),
        ("difference", latencies - solve_times),
    ):
        median, high = 1e3 * np.nanpercentile(values, (50, 99))
        print(f"{name:18} median {median:6.2f} ms   99th percentile {high:6.2f} ms")
