# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A client of the node in another process: for the demo, the tests and the benchmarks."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import IO, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter, SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from ..exceptions import PlannerError
from ..resources import config_file
from .messages import OVERTAKEN, UNDER_WAY, to_stamp_text
from .node import NODE_NAME

# A client that is busy for a while must not lose what was published meanwhile.
_DEPTH = 10_000


class NoAnswerError(PlannerError):
    """The node did not answer in time."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What the node answered to a goal.

    Attributes
    ----------
    report : DiagnosticStatus
        Its report.
    trajectory : JointTrajectory or None
        The motion; None if the goal is refused or its motion is under way already.
    latency : float or None
        Time from sending the goal until the middleware of the client has the motion [s].
    """

    report: DiagnosticStatus
    trajectory: JointTrajectory | None
    latency: float | None

    @property
    def values(self) -> dict[str, str]:
        """The values of the report by name."""
        return report_values(self.report)


def this_machine_only(domain: int | None = None) -> dict[str, str]:
    """Environment variables that keep nodes away from everybody else's robots.

    Nodes find each other quickly, too, unless a file of DDS profiles is set already.

    Parameters
    ----------
    domain :
        The DDS domain, 0 to 101; by default the one that is set, or one of this process's own.
    """
    profiles = "FASTRTPS_DEFAULT_PROFILES_FILE"
    if domain is None:
        domain = int(os.environ.get("ROS_DOMAIN_ID", 1 + os.getpid() % 101))
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(domain),
        profiles: os.environ.get(profiles) or str(config_file("quick_discovery.xml")),
    }


def start_node(
    *ros_arguments: str, options: Sequence[str] = (), output: IO[str] | None = None
) -> subprocess.Popen[str]:
    """Start the node in a process of its own.

    Parameters
    ----------
    ros_arguments :
        What follows ``--ros-args``.
    options :
        What comes before.
    output :
        Where its output goes; that of this process by default.
    """
    command = [sys.executable, "-m", __package__.partition(".")[0], "planner_node", *options]
    command += ["--ros-args", *ros_arguments]
    return subprocess.Popen(command, stdout=output, stderr=output, text=True)


def is_served(report: DiagnosticStatus) -> bool:
    """Whether a report is of a motion that was published, for this goal or for one it repeats."""
    return (
        report.level != DiagnosticStatus.ERROR and report_values(report).get("status") != OVERTAKEN
    )


def report_values(report: DiagnosticStatus) -> dict[str, str]:
    """The values of a report by name."""
    return {pair.key: pair.value for pair in report.values}


def _time_received(facts: dict[str, int]) -> float:
    # Not every middleware tells when.
    return 1e-9 * (facts["received_timestamp"] or time.time_ns())


class GoalClient:
    """Sends goals to the node and collects what it publishes; use it as a context manager.

    Parameters
    ----------
    name : str
        Name of the client's own node.
    namespace : str
        Namespace of both nodes.
    planner : str
        Name of the planner's node.

    Attributes
    ----------
    trajectories : list of JointTrajectory
        All that were received, the newest last.
    reports : list of DiagnosticStatus
        All that were received, the newest last.
    executions : list of DiagnosticStatus
        All reports of executions that were received, the newest last.
    diagnostics : list of DiagnosticArray
        All that were received, the newest last.
    """

    def __init__(
        self, name: str = "goal_client", namespace: str = "", planner: str = NODE_NAME
    ) -> None:
        self.trajectories: list[JointTrajectory] = []
        self.reports: list[DiagnosticStatus] = []
        self.executions: list[DiagnosticStatus] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.previews: list[MarkerArray] = []
        self._trajectory_received = self._diagnostics_received = 0.0
        self._planner = planner
        # A context of its own leaves that of the process, and its signal handlers, alone.
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(name, context=self._context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._connect()

    def _connect(self) -> None:
        node, there = self._node, self._planner
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._goals = {
            kind: node.create_publisher(kind, f"{there}/{topic}", 1)
            for kind, topic in (
                (JointState, "goal"),
                (PoseStamped, "goal_pose"),
                (JointTrajectory, "goal_sequence"),
            )
        }
        self._costs = node.create_publisher(Float64, f"{there}/trial_cost", 1)
        self._states = node.create_publisher(JointState, "joint_states", 1)
        self._descriptions = node.create_publisher(String, "robot_description", latched)
        self._set_parameters = node.create_client(SetParameters, f"{there}/set_parameters")
        self._services = {
            name: node.create_client(Trigger, f"{there}/{name}")
            for name in ("reload_primitives", "stop", "save_motion")
        }
        for message_type, topic, callback, qos in (
            (DiagnosticStatus, f"{there}/plan_report", self.reports.append, _DEPTH),
            (DiagnosticStatus, f"{there}/execution_report", self.executions.append, _DEPTH),
            (MarkerArray, f"{there}/preview", self.previews.append, latched),
        ):
            node.create_subscription(message_type, topic, callback, qos)
        # rclpy's types know of no callbacks that are told when the middleware got a message.
        on_trajectory: Any = self._on_trajectory
        on_diagnostics: Any = self._on_diagnostics
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, _DEPTH)
        node.create_subscription(
            JointTrajectory, f"{there}/joint_trajectory", on_trajectory, _DEPTH, raw=True
        )

    def __enter__(self) -> GoalClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def wait_for_node(self, timeout: float = 30.0, *, with_trajectory: bool = True) -> None:
        """Wait until every topic and service is matched.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].
        with_trajectory : bool
            Whether to wait for the topic of motions, too, which may be remapped to a controller's.

        Raises
        ------
        NoAnswerError
            If that takes longer than `timeout`.
        """
        topics = ("joint_trajectory", "plan_report") if with_trajectory else ("plan_report",)
        publishers = (*self._goals.values(), self._costs, self._states, self._descriptions)
        clients = (self._set_parameters, *self._services.values())
        self._wait(
            lambda: (
                all(p.get_subscription_count() for p in publishers)
                and all(self._node.count_publishers(f"{self._planner}/{topic}") for topic in topics)
                and all(client.service_is_ready() for client in clients)
            ),
            timeout,
            "is not there",
        )

    def publish_state(
        self, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> None:
        """Publish the present state."""
        self.publish_state_message(
            JointState(name=list(names), position=list(positions), velocity=list(velocities))
        )

    def publish_state_message(self, message: JointState) -> None:
        """Publish a present state that need not be well-formed."""
        self._states.publish(message)

    def publish_description(self, urdf: str) -> None:
        """Publish the robot description for present and future subscribers."""
        self._descriptions.publish(String(data=urdf))

    def publish_trial_cost(self, cost: float) -> None:
        """Tell what the last motion cost."""
        self._costs.publish(Float64(data=cost))

    def publish_goal(self, goal: JointState | PoseStamped | JointTrajectory) -> None:
        """Send a goal and wait for nothing."""
        self._goals[type(goal)].publish(goal)

    def send(
        self,
        goal: JointState | PoseStamped | JointTrajectory,
        timeout: float = 10.0,
        *,
        with_trajectory: bool = True,
    ) -> Answer:
        """Send a goal and wait for its report, and for its motion if there is one.

        Parameters
        ----------
        goal :
            The goal; its report is known by its stamp.
        timeout : float
            Longest time to wait [s].
        with_trajectory : bool
            Whether to wait for the motion; none is waited for where its topic is remapped.

        Raises
        ------
        NoAnswerError
            If that takes longer than `timeout`.
        """
        n_reports, n_trajectories = len(self.reports), len(self.trajectories)
        stamp = to_stamp_text(goal.header.stamp)
        sent = time.time()
        self.publish_goal(goal)

        def own_report() -> DiagnosticStatus | None:
            new = self.reports[n_reports:]
            return next((r for r in new if report_values(r).get("goal_stamp") == stamp), None)

        self._wait(lambda: own_report() is not None, timeout, "did not report")
        report = own_report()
        is_under_way = report_values(report).get("status") == UNDER_WAY
        if not with_trajectory or is_under_way or not is_served(report):
            return Answer(report, None, None)
        trajectory = self._next_trajectory(n_trajectories, timeout)
        return Answer(report, trajectory, trajectory and self._trajectory_received - sent)

    def set_parameters(self, *parameters: Parameter) -> list[SetParametersResult]:
        """Set parameters one by one."""
        request = SetParameters.Request(parameters=list(parameters))
        return list(self._call(self._set_parameters, request).results)

    def reload_primitives(self) -> Trigger.Response:
        """Have the primitive files read again."""
        return self._call(self._services["reload_primitives"], Trigger.Request())

    def stop(self, timeout: float = 10.0) -> tuple[Trigger.Response, JointTrajectory | None]:
        """Have the robot come to rest; returns the answer and what was published.

        No motion is waited for where its topic is remapped.

        Raises
        ------
        NoAnswerError
            If that takes longer than the timeout [s].
        """
        n = len(self.trajectories)
        answer = self._call(self._services["stop"], Trigger.Request())
        return answer, self._next_trajectory(n, timeout) if answer.success else None

    def save_motion(self, timeout: float = 10.0) -> Trigger.Response:
        """Have the last motion kept as a primitive."""
        return self._call(self._services["save_motion"], Trigger.Request(), timeout)

    def wait_for_preview(
        self, wanted: Callable[[MarkerArray], bool] = bool, timeout: float = 10.0
    ) -> MarkerArray:
        """Wait until the newest preview is as wanted; it comes a little after its motion.

        Parameters
        ----------
        wanted :
            Judges it; any will do by default.
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        preview : MarkerArray
            What `wanted` accepted.

        Raises
        ------
        NoAnswerError
            If none comes.
        """
        self._wait(
            lambda: bool(self.previews) and wanted(self.previews[-1]),
            timeout,
            "published no such preview",
        )
        return self.previews[-1]

    def wait_for_diagnostics(
        self, wanted: Callable[[dict[str, str]], bool] = bool, timeout: float = 30.0
    ) -> dict[str, str]:
        """Wait for the next diagnostics that are as wanted.

        Parameters
        ----------
        wanted :
            Judges the values by name and, under 'text', the sentence; any will do by default.
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        values : dict
            What `wanted` accepted.

        Raises
        ------
        NoAnswerError
            If none came.
        """
        # Others may wait unread since long ago.
        called = time.time()

        def values() -> dict[str, str]:
            status = self.diagnostics[-1].status[0]
            return {"text": status.message} | {pair.key: pair.value for pair in status.values}

        self._wait(
            lambda: self._diagnostics_received > called and wanted(values()),
            timeout,
            "published no such diagnostics",
        )
        return values()

    def spin_once(self, timeout: float = 0.05) -> None:
        """Take one message that has arrived, or wait for one [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def wait_for_model(self) -> None:
        """Wait until the node has primitives and a robot model."""
        self.wait_for_diagnostics(lambda values: values["model"] != "none")

    def _next_trajectory(self, n_before: int, timeout: float) -> JointTrajectory | None:
        """What follows so many motions; None where their topic is remapped."""
        if not self._node.count_publishers(f"{self._planner}/joint_trajectory"):
            return None
        self._wait(lambda: len(self.trajectories) > n_before, timeout, "published no trajectory")
        return self.trajectories[-1]

    def _on_trajectory(self, message: bytes, facts: dict[str, int]) -> None:
        self._trajectory_received = _time_received(facts)
        self.trajectories.append(deserialize_message(message, JointTrajectory))

    def _on_diagnostics(self, message: DiagnosticArray, facts: dict[str, int]) -> None:
        self._diagnostics_received = _time_received(facts)
        self.diagnostics.append(message)

    def _call(self, client: Any, request: Any, timeout: float = 10.0) -> Any:
        future = client.call_async(request)
        self._wait(future.done, timeout, f"did not answer on '{client.srv_name}'")
        return future.result()

    def _wait(self, is_done: Callable[[], bool], timeout: float, complaint: str) -> None:
        deadline = time.monotonic() + timeout
        while not is_done():
            if time.monotonic() > deadline:
                raise NoAnswerError(f"the node '{NODE_NAME}' {complaint} within {timeout:g} s")
            self.spin_once()
