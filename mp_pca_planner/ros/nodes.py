# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The start and the end of nodes, and subscriptions that are polled."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ..exceptions import PlannerError

NODE_NAME = "mp_pca_planner"
"""Name of the planner's node, unless it is another one."""

READY = "ready for goals"
"""Sentence in the diagnostics of a node that has all it needs."""

WAITING = "waiting for "
"""Begin of the sentence in the diagnostics of a node that waits for its robot."""

Taken = tuple[bytes, dict[str, int]]
"""A serialised message and what the middleware knows of it."""

LOG_PERIOD = 1.0
"""Least time between log messages of the same place [s]."""

EVERY = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Late subscribers receive the last message."""

GOALS = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
"""Only the newest goal is served, but each one of a burst gets its report."""

STATES = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Receives from best-effort and reliable publishers; several may send a thousand messages a second
between two polls."""


def start_ros(arguments: Sequence[str]) -> None:
    """Initialise ROS, with signals left to the caller.

    Raises
    ------
    PlannerError
        If the arguments are rejected.
    """
    try:
        # rclpy's own handlers would shut the context down under a running callback.
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise PlannerError(f"the arguments after --ros-args are rejected: {reason}") from error


def spin_until(
    is_ending: Callable[[], bool],
    node: Node,
    pause: Callable[[], float],
    failed: Callable[[Exception], None] | None = None,
) -> None:
    """Run a node until it is to end, then end it and ROS.

    Parameters
    ----------
    is_ending : callable
        Whether the node is to end. Handlers of signals must take no lock for it, as they interrupt
        each other.
    node : Node
        The node.
    pause : callable
        Returns the longest time to wait for the next message [s]; called before each wait.
    failed : callable, optional
        Called with an exception of a callback, after which the node goes on.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not is_ending():
            try:
                executor.spin_once(timeout_sec=pause())
            except Exception as error:
                if failed is None:
                    raise
                failed(error)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


class _Unexecuted(CallbackGroup):
    """Entities that no executor waits for: a thousand states a second would keep it busy."""

    def can_execute(self, entity: object) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Nothing to release."""


class PolledSubscription:
    """A subscription whose messages stay in the middleware until they are polled.

    Parameters
    ----------
    node : Node
        The node.
    message_type : type
        Type of the messages.
    topic : str
        Name of the topic.
    qos : QoSProfile or int
        Quality of service; its depth is the most messages that wait.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        qos: QoSProfile | int,
    ) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            message_type, topic, lambda _: None, qos, callback_group=_Unexecuted(), raw=True
        )

    def poll(self, most_bytes: float = math.inf) -> list[Taken]:
        """Return the serialised messages that have arrived, the newest last, and their facts.

        After so many bytes, the others wait for the next poll.
        """
        subscription: Any = self._subscription
        polled = []
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                polled.append(taken)
                most_bytes -= len(taken[0])
                if most_bytes <= 0:
                    break
        return polled

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


def thinned(polled: list[Taken]) -> list[Taken]:
    """Messages of each source 10 ms apart, and its newest one.

    To read a state takes rclpy 0.05 ms, so that at 1 kHz a goal would wait for some 2 ms. Sources
    differ in what follows the stamps: frames and names.
    """
    newest = {content[12:76]: k for k, (content, _) in enumerate(polled)}
    kept, due = list[Taken](), dict[bytes, int]()
    for k, (content, facts) in enumerate(polled):
        source, received = content[12:76], facts["received_timestamp"]
        if k == newest[source] or not 0 < received < due.get(source, 0):
            kept.append((content, facts))
            due[source] = received + 10_000_000
    return kept


def message_age(facts: dict[str, int], longest: float) -> float:
    """Time since the middleware got a message [s], at most that since the last look."""
    received = facts["received_timestamp"]
    return min(max((time.time_ns() - received) * 1e-9, 0.0), longest) if received else 0.0
