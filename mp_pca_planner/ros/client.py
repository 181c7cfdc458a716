# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A client of the node in another process: for commands, the demo, tests and benchmarks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from ..exceptions import GoalError, PlannerError
from ..execution.outcomes import GoalOutcome
from ..files import config_file
from ..recordings.joint_states import NS_PER_S
from ..robot.world import World
from .goals import GOAL_TOPICS
from .messages import to_stamp_text
from .nodes import LATCHED, NODE_NAME, READY, WAITING
from .world_markers import to_obstacle_markers

# A client that is busy for a while must not lose messages.
DEPTH = 10_000
"""Depth of the subscriptions of a client."""

_TOPIC_NAMES = {topic.message_type: topic.name for topic in GOAL_TOPICS}


def this_machine_only(domain: int | None = None) -> dict[str, str]:
    """Environment variables that isolate nodes from other machines and their robots.

    They also make discovery fast, unless a file of DDS profiles is set already.

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


def check_node_name(namespace: str, node: str) -> None:
    """Check that a node can have this name in this namespace.

    Raises
    ------
    GoalError
        If ROS accepts no such name.
    """
    name = f"/{namespace}/{node}".replace("//", "/")
    try:
        validate_full_topic_name(name)
    except NameValidationException as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise GoalError(f"no node can be called '{name}': {reason}") from None


def is_served(report: DiagnosticStatus) -> bool:
    """Whether a motion was published for the reported goal, or for one that it repeats."""
    is_overtaken = report_values(report).get("status") == GoalOutcome.OVERTAKEN
    return report.level != DiagnosticStatus.ERROR and not is_overtaken


def report_values(report: DiagnosticStatus) -> dict[str, str]:
    """The values of a report by name."""
    return {pair.key: pair.value for pair in report.values}


def _unreadiness(text: str) -> str:
    """What a node with a sentence in its diagnostics failed to do."""
    if text in ("", READY):
        return "published no such diagnostics"
    hint = "; is the driver of the robot, or 'mp-pca simulate', running?"
    hint *= text.startswith(WAITING)
    return f"is not ready ({text}{hint})"


class NoAnswerError(PlannerError, TimeoutError):
    """The node did not answer in time."""


class NodeInOwnContext:
    """A node in a context of its own; use it as a context manager.

    The context of the process and its signal handlers are not changed.

    Parameters
    ----------
    name : str
        Name of the node.
    namespace : str
        Namespace of both nodes.
    planner : str
        Name of the planner's node.

    Raises
    ------
    GoalError
        If no node can have this name in this namespace.

    Attributes
    ----------
    context : Context
        The context.
    node : Node
        The node.
    """

    def __init__(self, name: str, namespace: str, planner: str) -> None:
        check_node_name(namespace, planner)
        self.planner = planner
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name, context=self.context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def spin_once(self, timeout: float = 0.05) -> None:
        """Take one message that has arrived, or wait for one [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def wait(
        self, is_done: Callable[[], bool], timeout: float, complaint: str | Callable[[], str]
    ) -> None:
        """Receive messages until a condition holds.

        Raises
        ------
        NoAnswerError
            If that takes longer than the timeout [s]; the message states what the planner's node
            failed to do.
        """
        deadline = time.monotonic() + timeout
        while not is_done():
            if time.monotonic() > deadline:
                text = complaint if isinstance(complaint, str) else complaint()
                raise NoAnswerError(f"the node '{self.planner}' {text} within {timeout:g} s")
            self.spin_once()

    def result(self, client: Any, request: Any, timeout: float = 10.0) -> Any:
        """Return the response of a service, or raise a `NoAnswerError`."""
        future = client.call_async(request)
        self.wait(future.done, timeout, f"did not answer on '{client.srv_name}'")
        return future.result()


class GoalClient(NodeInOwnContext):
    """Sends goals to the node and collects its answers; use it as a context manager.

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
    reports, executions : list of DiagnosticStatus
        All reports of goals and of motions that were received, the newest last.
    diagnostics : list of DiagnosticArray
        All that were received, the newest last.
    """

    def __init__(
        self, name: str = "goal_client", namespace: str = "", planner: str = NODE_NAME
    ) -> None:
        super().__init__(name, namespace, planner)
        self.reports: list[DiagnosticStatus] = []
        self.executions: list[DiagnosticStatus] = []
        self.diagnostics: list[DiagnosticArray] = []
        self._diagnostics_received = 0.0
        node = self.node
        self._publishers = {
            topic.name: node.create_publisher(topic.message_type, f"{planner}/{topic.name}", 1)
            for topic in GOAL_TOPICS
        }
        self._services = {
            name: node.create_client(Trigger, f"{planner}/{name}")
            for name in ("reload_primitives", "stop", "save_motion")
        }
        # rclpy's types lack callbacks that get the facts about a message as well.
        on_diagnostics: Any = self._on_diagnostics
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, DEPTH)
        for name, received in (
            ("plan_report", self.reports),
            ("execution_report", self.executions),
        ):
            node.create_subscription(DiagnosticStatus, f"{planner}/{name}", received.append, DEPTH)

    def wait_for_node(self, timeout: float = 30.0) -> None:
        """Wait until goals, reports and services are matched.

        Raises
        ------
        NoAnswerError
            If that takes longer than `timeout` [s].
        """
        topic = f"{self.planner}/plan_report"
        self.wait(
            lambda: (
                all(p.get_subscription_count() for p in self._publishers.values())
                and self.node.count_publishers(topic) > 0
                and all(client.service_is_ready() for client in self._services.values())
            ),
            timeout,
            "is not there",
        )

    def publish_goal(self, goal: JointState | PoseStamped | JointTrajectory) -> None:
        """Send a goal without waiting for its report."""
        self._publishers[_TOPIC_NAMES[type(goal)]].publish(goal)

    def send(
        self, goal: JointState | PoseStamped | JointTrajectory, timeout: float = 10.0
    ) -> DiagnosticStatus:
        """Send a goal and wait for its report, which its stamp identifies.

        Raises
        ------
        NoAnswerError
            If that takes longer than `timeout` [s].
        """
        n_before, stamp = len(self.reports), to_stamp_text(goal.header.stamp)
        self.publish_goal(goal)
        return self._report_of(stamp, self.reports, n_before, timeout, "did not report")

    def send_obstacles(
        self, world: World, *, clear: bool = False, timeout: float = 10.0
    ) -> tuple[int, str]:
        """Give the node the obstacles of a world.

        Parameters
        ----------
        world : World
            The obstacles.
        clear : bool
            Whether all others are removed before.
        timeout : float
            Longest time to wait for the node and for its answer [s].

        Returns
        -------
        n_obstacles : int
            Number of obstacles that the node has then.
        problem : str
            Why one of them is not avoided; empty if all are.

        Raises
        ------
        NoAnswerError
            If the node does not answer.
        """
        topic = f"{self.planner}/obstacles"
        publisher = self.node.create_publisher(MarkerArray, topic, LATCHED)
        self.wait(lambda: publisher.get_subscription_count() > 0, timeout, "is not there")
        publisher.publish(to_obstacle_markers(world, clear=clear))
        # The node counts obstacles when its workers have taken them.
        publisher.wait_for_all_acked(Duration(seconds=timeout))
        values = self.wait_for_diagnostics(timeout=timeout)
        values = self.wait_for_diagnostics(timeout=timeout)
        rejected = values["obstacle_rejected"]
        return int(values["obstacles"]), "" if rejected == "none" else rejected

    def call(self, service: str, timeout: float = 10.0) -> Trigger.Response:
        """Call ``reload_primitives``, ``stop`` or ``save_motion``.

        Raises
        ------
        NoAnswerError
            If there is no answer within the timeout [s].
        """
        return self.result(self._services[service], Trigger.Request(), timeout)

    def wait_for_diagnostics(
        self, is_expected: Callable[[dict[str, str]], bool] = bool, timeout: float = 30.0
    ) -> dict[str, str]:
        """Wait for the next diagnostics that meet a condition.

        Parameters
        ----------
        is_expected :
            Judges the values by name and, under 'text', the sentence; accepts any by default.
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        values : dict
            The accepted values.

        Raises
        ------
        NoAnswerError
            If none came.
        """
        # Older diagnostics may still be unread.
        called = time.time()

        def values() -> dict[str, str]:
            status = self.diagnostics[-1].status[0]
            return {"text": status.message} | report_values(status)

        self.wait(
            lambda: self._diagnostics_received > called and is_expected(values()),
            timeout,
            lambda: _unreadiness(values()["text"] if self.diagnostics else ""),
        )
        return values()

    def move(self, primitive: str, goal: Mapping[str, float], timeout: float) -> DiagnosticStatus:
        """Send a goal configuration by joint name [rad or m], for one primitive.

        Raises
        ------
        NoAnswerError
            If the node is not ready for goals or does not answer within the timeout [s].
        """
        self.wait_for_diagnostics(lambda values: values["text"] == READY, timeout)
        message = JointState(name=list(goal), position=list(goal.values()))
        message.header.frame_id = primitive
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), NS_PER_S)
        return self.send(message, timeout)

    def execution(self, report: DiagnosticStatus, margin: float = 30.0) -> DiagnosticStatus | None:
        """The report on the execution of a motion; None if nothing was published.

        Parameters
        ----------
        report : DiagnosticStatus
            The report of its goal.
        margin : float
            Longest time from the end of the motion to its report [s].

        Raises
        ------
        NoAnswerError
            If its execution is not reported.
        """
        values = report_values(report)
        if not is_served(report) or values.get("status") == GoalOutcome.UNDER_WAY:
            return None
        timeout, complaint = float(values["duration"]) + margin, "did not report the execution"
        return self._report_of(values["goal_stamp"], self.executions, 0, timeout, complaint)

    def _report_of(
        self,
        stamp: str,
        reports: list[DiagnosticStatus],
        n_before: int,
        timeout: float,
        complaint: str,
    ) -> DiagnosticStatus:
        """Wait for a report, after the first `n_before`, on the goal with a stamp."""

        def own() -> list[DiagnosticStatus]:
            new = reports[n_before:]
            return [one for one in new if report_values(one).get("goal_stamp") == stamp]

        self.wait(lambda: bool(own()), timeout, complaint)
        return own()[0]

    def _on_diagnostics(self, message: DiagnosticArray, facts: dict[str, int]) -> None:
        # Not every middleware reports the time.
        self._diagnostics_received = 1e-9 * (facts["received_timestamp"] or time.time_ns())
        self.diagnostics.append(message)
