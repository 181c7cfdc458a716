# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The running node for the page and the demo, and all joint states of a robot for `teach`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.expand_topic_name import expand_topic_name
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError, PlannerError, WorldError, quote_names
from ..files import reading
from ..motion.collision import package_folders
from ..robot.world import World
from ..view.content import LiveView, NodeStatus
from .client import NoAnswerError, NodeInOwnContext, check_node_name, report_values
from .goal_messages import GOAL_TOPICS, GoalTopic
from .messages import to_trajectory
from .node import NODE_NAME
from .nodes import EVERY, NEWEST, STATES, PolledSubscription
from .obstacle_markers import Applied, MarkerMessages, MarkerSubscription
from .serialised import read_message

Keep = Callable[[Any], None]


class LiveNode(NodeInOwnContext):
    """A connection to a planner node; use it as a context manager, in one thread.

    Messages stay in the middleware until they are polled, so that joint states at 1 kHz cost next
    to nothing.

    Parameters
    ----------
    namespace : str
        Namespace of the node.
    planner : str
        Name of the node.
    trajectories : str
        Topic of the motions, if it is remapped to that of a controller.
    """

    stop_timeout = 2.0
    """Longest time to wait for the answer to a stop [s]."""

    def __init__(
        self, namespace: str = "", planner: str = NODE_NAME, trajectories: str = ""
    ) -> None:
        super().__init__("live", namespace, planner)
        self._seen, self._markers = LiveView(), MarkerMessages()
        self._states: dict[str, tuple[float, float, float]] = {}
        parent = self.node.get_namespace().rstrip("/")
        self._status_name = f"{parent}/{planner}: planner"
        motions = trajectories or f"{planner}/joint_trajectory"
        self._obstacles = MarkerSubscription(self.node, f"{planner}/obstacles")
        topics: tuple[tuple[type, str, Keep, QoSProfile | int], ...] = (
            (JointState, "joint_states", self._on_state, STATES),
            *(
                (topic.message_type, f"{planner}/{topic.name}", partial(self._on_goal, topic), 10)
                for topic in GOAL_TOPICS
            ),
            (DiagnosticStatus, f"{planner}/plan_report", partial(self._on_status, "report"), EVERY),
            (
                DiagnosticStatus,
                f"{planner}/execution_report",
                partial(self._on_status, "execution"),
                EVERY,
            ),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, EVERY),
            (JointTrajectory, motions, self._on_motion, EVERY),
        )
        self._subscriptions = [
            (PolledSubscription(self.node, kind, topic, qos), kind, keep)
            for kind, topic, keep, qos in topics
        ]
        self._goals = self.node.create_publisher(JointState, f"{planner}/goal", NEWEST)
        self._stops = self.node.create_client(Trigger, f"{planner}/stop")

    def view(self) -> LiveView:
        """What was received up to now."""
        for subscription, kind, keep in self._subscriptions:
            for content, _ in subscription.poll():
                with suppress(PlannerError), reading("a message", PlannerError):
                    keep(read_message(content, kind))
        self._update_world()
        return replace(self._seen, states=dict(self._states))

    def send_goal(self, positions: Mapping[str, float]) -> None:
        """Send a goal configuration by joint name [rad or m]."""
        message = JointState(name=list(positions), position=list(positions.values()))
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._goals.publish(message)

    def stop(self) -> str:
        """Stop the robot; returns the node's answer, or why there is none."""
        if not self._stops.service_is_ready():
            return "not stopped: the node is not there"
        try:
            answer = self.result(self._stops, Trigger.Request(), self.stop_timeout)
        except NoAnswerError as error:
            return f"not stopped: {error}"
        return str(answer.message)

    def _keep(self, **seen: Any) -> None:
        self._seen = replace(self._seen, **seen)

    def _on_state(self, message: JointState) -> None:
        velocities = message.velocity or [float("nan")] * len(message.name)
        for name, q, v in zip(message.name, message.position, velocities, strict=False):
            self._states[name] = (q, v, time.monotonic())

    def _on_goal(self, topic: GoalTopic, message: Any) -> None:
        self._keep(goal=(topic.text(message), time.monotonic()))

    def _on_status(self, name: str, message: DiagnosticStatus) -> None:
        self._keep(**{name: _status(message)})

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._status_name:
                self._keep(diagnostics=_status(status))

    def _on_motion(self, message: JointTrajectory) -> None:
        try:
            self._keep(motion=to_trajectory(message))
        except PlannerError:  # another publisher's; the node publishes none like that
            self._keep(motion=None)

    def _update_world(self) -> None:
        """Apply markers as the node does, which reports those that it rejects."""
        now, folders = time.monotonic(), package_folders(())
        for message in self._obstacles.poll():
            with suppress(WorldError):
                world = self._seen.world
                self._use(self._markers.apply(world, message, folders=folders, now=now))
        with suppress(WorldError):
            self._use(self._markers.refresh(self._seen.world, now))

    def _use(self, applied: Applied | None) -> None:
        if applied is not None:
            self._keep(world=World(applied[0]))


def _status(status: DiagnosticStatus) -> NodeStatus:
    level = int.from_bytes(status.level, "little")
    return NodeStatus(level, status.message, report_values(status), time.monotonic())


_NAME = "teach"

Record = Callable[[Sequence[tuple[int, bytes]]], None]


def full_topic_name(topic: str, namespace: str) -> str:
    """The name of a topic with its namespace.

    Raises
    ------
    GoalError
        If ROS accepts no such name.
    """
    check_node_name(namespace, _NAME)
    try:
        return expand_topic_name(topic, _NAME, f"/{namespace.strip('/')}")
    except ValueError as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise GoalError(f"no topic can be called '{topic}': {reason}") from None


class JointStateSource(NodeInOwnContext):
    """Joint states on a topic; a context manager.

    Parameters
    ----------
    topic : str
        Full name of the topic.

    Attributes
    ----------
    pause : float
        Least time between two looks at what was recorded [s].
    period : float
        Time between two polls [s].
    """

    pause, period = 0.3, 0.02

    def __init__(self, topic: str) -> None:
        super().__init__(_NAME, "", _NAME)
        self._topic, self._is_ending = topic, threading.Event()
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            self._is_ending.set()
            self._thread.join()
        super().__exit__()

    def feed(self, record: Record) -> bool:
        """Start the recording at the first call; raises what has ended it."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, args=[record], daemon=True)
            self._thread.start()
        if self._error is not None:
            raise self._error
        return True

    def silence(self) -> str:
        """Why nothing has come: nobody publishes on the topic, or a publisher is silent."""
        if self.node.count_publishers(self._topic):
            return f"nothing has been received on '{self._topic}' yet"
        found = [
            name
            for name, types in self.node.get_topic_names_and_types()
            if "sensor_msgs/msg/JointState" in types and self.node.count_publishers(name)
        ]
        return (
            f"nobody publishes on '{self._topic}' yet; topics with joint states: "
            f"{quote_names(sorted(found))}"
        )

    def _run(self, record: Record) -> None:
        try:
            states = self._subscribe()
            is_ending = False
            while states is not None and not is_ending:
                is_ending = self._is_ending.wait(self.period)
                record(
                    [
                        (facts["received_timestamp"] or time.time_ns(), bytes(message))
                        for message, facts in states.poll()
                    ]
                )
        except Exception as error:  # it is raised by the next call of `feed`
            self._error = error

    def _subscribe(self) -> PolledSubscription | None:
        """Subscribe once there is a publisher, to whose reliability that of the topic is fitted."""
        while not self.node.count_publishers(self._topic):
            if self._is_ending.wait(self.period):
                return None
        # As reliable as the publishers; ten seconds of states at 1 kHz may wait.
        every = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_AVAILABLE)
        return PolledSubscription(self.node, JointState, self._topic, every)
