# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node, a simulated robot and clients in tests, campaigns and benchmarks."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing.synchronize import Event
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.arm import JOINTS, URDF, arm_primitive
from support.patience import HANG, NODE_EVER
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.execution.outcomes import GoalOutcome
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.client import DEPTH, GoalClient, is_served, report_values
from mp_pca_planner.ros.nodes import LATCHED

MOTION = arm_primitive().boundary_states[0]
START, GOAL = MOTION[0].tolist(), MOTION[3].tolist()
# Fresh processes: ROS does not survive a fork.
PROCESSES = multiprocessing.get_context("spawn")

# Tests publish a state once, and the machine may be busy: how long states are good for, and plans
# may take [s].
PATIENCE = {"state_timeout": NODE_EVER, "max_solve_time": NODE_EVER}


def set_request(values: Mapping[str, object]) -> SetParameters.Request:
    """The request that sets parameters."""
    given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    return SetParameters.Request(parameters=given)


def words(**parameters: object) -> tuple[str, ...]:
    """Arguments of a node that set parameters."""
    return tuple(word for k, v in parameters.items() for word in ("-p", f"{k}:={v}"))


@dataclass(frozen=True, eq=False)
class Answer:
    """The report on a goal, and its motion and the time until that was received [s], if any."""

    report: DiagnosticStatus
    trajectory: JointTrajectory | None = None
    latency: float | None = None

    @property
    def values(self) -> dict[str, str]:
        return report_values(self.report)


class NodeClient(GoalClient):
    """A client that plays the robot and the operator, too.

    Attributes
    ----------
    trajectories, previews : list of JointTrajectory, MarkerArray
        All that were received, the newest last.
    """

    def __init__(self, *arguments: str, joint_states: str = "joint_states", **names: str) -> None:
        super().__init__(*arguments, **names)
        node = self.node
        self.trajectories: list[JointTrajectory] = []
        self._received = 0.0
        topic = f"{self.planner}/joint_trajectory"
        node.create_subscription(JointTrajectory, topic, self._on_trajectory, DEPTH, raw=True)
        self._publishers |= {
            "joint_states": node.create_publisher(JointState, joint_states, 1),
            "robot_description": node.create_publisher(String, "robot_description", LATCHED),
        }
        self.previews: list[MarkerArray] = []
        parameters = f"{self.planner}/set_parameters"
        self._services["set_parameters"] = node.create_client(SetParameters, parameters)
        preview = f"{self.planner}/preview"
        node.create_subscription(MarkerArray, preview, self.previews.append, LATCHED)

    def _on_trajectory(self, message: bytes, facts: dict[str, int]) -> None:
        self._received = 1e-9 * (facts["received_timestamp"] or time.time_ns())
        self.trajectories.append(deserialize_message(message, JointTrajectory))

    def wait_for_node(self, timeout: float = 30.0, *, with_trajectory: bool = True) -> None:
        """Wait until the node is there, with the topic of motions unless that is remapped."""
        super().wait_for_node(timeout)
        self.wait(lambda: not with_trajectory or self._has_motions(), timeout, "is not there")

    def _has_motions(self) -> bool:
        return self.node.count_publishers(f"{self.planner}/joint_trajectory") > 0

    def send(self, goal: Any, timeout: float = 10.0, *, with_trajectory: bool = True) -> Answer:
        """The answer to a goal, with its motion unless the topic of motions is remapped."""
        n_before, sent = len(self.trajectories), time.time()
        report = super().send(goal, timeout)
        is_under_way = report_values(report).get("status") == GoalOutcome.UNDER_WAY
        if not with_trajectory or is_under_way or not is_served(report):
            return Answer(report)
        trajectory = self.next_trajectory(n_before, timeout)
        return Answer(report, trajectory, trajectory and self._received - sent)

    def next_trajectory(self, n_before: int, timeout: float) -> JointTrajectory | None:
        """A motion after the first `n_before`; None if their topic is remapped."""
        if not self._has_motions():
            return None
        self.wait(lambda: len(self.trajectories) > n_before, timeout, "published no trajectory")
        return self.trajectories[-1]

    def publish(self, topic: str, message: Any) -> None:
        """Publish on a goal topic, ``joint_states`` or ``robot_description``."""
        self._publishers[topic].publish(message)

    def publish_state(self, names: Sequence[str], positions: Sequence[float]) -> None:
        self.publish("joint_states", JointState(name=list(names), position=list(positions)))

    def publish_description(self, urdf: str) -> None:
        self.publish("robot_description", String(data=urdf))

    def wait_for_model(self) -> None:
        """Wait until the node has primitives and a robot model."""
        self.wait_for_diagnostics(lambda values: values["model"] != "none")

    def try_to_set(self, values: Mapping[str, object]) -> list[str]:
        """Set parameters one by one; why they are refused, '' if they are not."""
        request = set_request(values)
        results = self.result(self._services["set_parameters"], request, HANG).results
        return ["" if one.successful else one.reason or "for no reason" for one in results]

    def set(self, **values: object) -> None:
        """Set parameters, which have to be accepted."""
        refused = self.try_to_set(values)
        assert not any(refused), refused

    def publish_markers(self, *markers: Marker) -> None:
        """Publish markers of obstacles, which are latched."""
        if "obstacles" not in self._publishers:
            publisher = self.node.create_publisher(
                MarkerArray, f"{self.planner}/obstacles", LATCHED
            )
            self._publishers["obstacles"] = publisher
        self.publish("obstacles", MarkerArray(markers=list(markers)))

    def stop(self, timeout: float = 10.0) -> tuple[Trigger.Response, JointTrajectory | None]:
        """What is answered to a stop, and what is published."""
        n = len(self.trajectories)
        answer = self.call("stop")
        return answer, self.next_trajectory(n, timeout) if answer.success else None

    def wait_for_preview(self, is_expected: Callable[[MarkerArray], bool]) -> None:
        """Wait until the newest preview is as expected: it comes a little after its motion."""
        self.wait(
            lambda: bool(self.previews) and is_expected(self.previews[-1]),
            HANG,
            "published no such preview",
        )


def start_node(
    *ros_arguments: str, options: Sequence[str] = (), output: IO[str] | None = None
) -> Popen[str]:
    """Start the node in a process of its own, with arguments before and after ``--ros-args``."""
    command = [sys.executable, "-m", "mp_pca_planner", "planner_node", *options]
    command += ["--ros-args", *ros_arguments]
    return Popen(command, stdout=output, stderr=output, text=True)


@contextmanager
def running_node(
    log: Path, *ros_arguments: str, options: Sequence[str] = (), may_trace: bool = False
) -> Iterator[Popen[str]]:
    """A node that has to end cleanly, and unless it may, without a traceback in its log."""
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
    assert may_trace or "Traceback" not in log.read_text()


@contextmanager
def arm_node(
    *ros_arguments: str,
    n_primitives: int = 1,
    options: Sequence[str] = (),
    may_trace: bool = False,
    **parameters: object,
) -> Iterator[tuple[Popen[str], Path]]:
    """A node with primitives arm_0, … of the arm in primitives/, and the folder of its log.txt.

    In values of parameters, ``{folder}`` stands for the folder.
    """
    with TemporaryDirectory() as name:
        folder, library = Path(name), Path(name, "primitives")
        library.mkdir()
        for k in range(n_primitives):
            save_primitive(replace(arm_primitive(), name=f"arm_{k}"), library / f"arm_{k}.npz")
        given = [
            w.replace("{folder}", name) for w in words(primitives=[str(library)], **parameters)
        ]
        log, arguments = folder / "log.txt", (*given, *ros_arguments)
        with running_node(log, *arguments, options=options, may_trace=may_trace) as node:
            yield node, folder


@contextmanager
def simulated_robot(log: Path, start: Sequence[float], *options: str) -> Iterator[None]:
    """A simulated robot in a process of its own, which has to end cleanly."""
    command = [sys.executable, "-m", "mp_pca_planner", "simulate"]
    command += ["--robot", str(config_file("human_arm.urdf"))]
    command += ["--start", ",".join(map(str, start)), *options]
    with log.open("w") as output, Popen(command, stdout=output, stderr=output) as robot:
        try:
            yield
        finally:
            robot.send_signal(signal.SIGINT)
            status = robot.wait(HANG)
    assert status == 0, log.read_text()


def children_of(node: Popen[str]) -> list[int]:
    return [*map(int, Path(f"/proc/{node.pid}/task/{node.pid}/children").read_text().split())]


def planner_of(node: Popen[str]) -> int:
    """The process in which a node plans, once it is up."""
    names = {child: Path(f"/proc/{child}/comm").read_text() for child in children_of(node)}
    return next(child for child, name in names.items() if name == "planner\n")


def processor_time(node: Popen[str]) -> float:
    """CPU time of the node and its workers [s]."""
    ticks = 0
    for process in (node.pid, *children_of(node)):
        text = Path(f"/proc/{process}/stat").read_text(encoding="ascii")
        ticks += sum(map(int, text.rpartition(")")[2].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def resident_megabytes(node: Popen[str]) -> list[float]:
    """Resident memory of the node and of its workers [MB]."""
    processes = (node.pid, *children_of(node))
    pages = [int(Path(f"/proc/{process}/statm").read_text().split()[1]) for process in processes]
    return [n * os.sysconf("SC_PAGE_SIZE") / 1e6 for n in pages]


@contextmanager
def other_process(work: Callable[..., None], *arguments: Any) -> Iterator[None]:
    """A process that works until the end, from when it sets the event of its last argument."""
    is_ready = PROCESSES.Event()
    process = PROCESSES.Process(target=work, args=(*arguments, is_ready), daemon=True)
    process.start()
    try:
        is_ready.wait(60.0)
        yield
    finally:
        process.kill()
        process.join()


def publish_states(rate: float, positions: list[float], is_ready: Event) -> None:
    """Publish a joint state at a fixed rate, for ever."""
    state = JointState(name=JOINTS, position=positions, velocity=[0.0] * len(positions))
    # Serialised once, because the driver of a real robot needs less CPU time than Python.
    message = bytes(serialize_message(state))
    with ros_node("joint_state_broadcaster") as node:
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
def described_client(*arguments: str) -> Iterator[NodeClient]:
    """A client of a node that has a model: its only robot description is that of the topic."""
    with NodeClient(*arguments) as client:
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
    raise AssertionError(f"{name} did not answer to {request!s:.200}")


def goal_message(
    positions: Sequence[float] = GOAL, names: Sequence[str] = JOINTS, **fields: object
) -> JointState:
    return JointState(name=list(names), position=list(positions), **fields)


def times(trajectory: JointTrajectory) -> list[int]:
    """Times from start [ns]."""
    stamps = [point.time_from_start for point in trajectory.points]
    return [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]


def column(trajectory: JointTrajectory, field: str) -> np.ndarray:
    return np.array([getattr(point, field) for point in trajectory.points])
