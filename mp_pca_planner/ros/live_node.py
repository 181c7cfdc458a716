# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""All joint states of a robot, for `teach`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rclpy.expand_topic_name import expand_topic_name
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from ..exceptions import GoalError, quote_names
from .client import NodeInOwnContext, check_node_name
from .nodes import PolledSubscription

_NAME = "teach"

Record = Callable[[list[tuple[int, bytes]]], None]


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
        Least time between two updates of the session [s].
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

    def feed(self, record: Record) -> None:
        """Start the recording at the first call; raises what has ended it."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, args=[record], daemon=True)
            self._thread.start()
        if self._error is not None:
            raise self._error

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
            f"no node publishes on '{self._topic}' yet; topics with joint states: "
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
