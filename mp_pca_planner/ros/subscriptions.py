# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is outside of the node's executor: polled entities, and those with their own thread.

The executor waits for all entities of a node at once and handles them one after the other. A
thousand states a second would keep it busy, and a goal would wait behind a service.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import (
    ConditionReachedException,
    ExternalShutdownException,
    SingleThreadedExecutor,
)
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
EVERY = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Late subscribers receive the last message."""

GOALS = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
"""Only the newest goal is served, but each one of a burst gets its report."""

STATES = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Receives from best-effort and reliable publishers; several may send a thousand messages a second
between two polls."""


class ThreadGroup(CallbackGroup):
    """Entities whose callbacks run in one thread only; without a thread they never run."""

    thread: threading.Thread | None = None

    def can_execute(self, entity: object) -> bool:
        """Whether the calling thread is that of the group."""
        return threading.current_thread() is self.thread

    def beginning_execution(self, entity: object) -> bool:
        """Allow every callback: one thread runs them one after the other."""
        return True

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
    raw : bool
        Whether messages stay serialised.
    """

    def __init__(
        self, node: Node, message_type: Any, topic: str, qos: QoSProfile | int, *, raw: bool = False
    ) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            message_type, topic, lambda _: None, qos, callback_group=ThreadGroup(), raw=raw
        )

    def poll(self) -> list[tuple[Any, dict[str, int]]]:
        """Return the messages that have arrived, the newest last, and facts about each."""
        subscription, polled = self._subscription, []
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                polled.append(taken)
        return polled

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


class PolledService:
    """A service whose requests stay in the middleware until they are answered.

    Parameters
    ----------
    node : Node
        The node.
    service_type : type
        Type of the service.
    name : str
        Its name.
    callback : callable
        Takes a request and a response, and returns the response.
    """

    def __init__(self, node: Node, service_type: Any, name: str, callback: Any) -> None:
        self._service = node.create_service(
            service_type, name, callback, callback_group=ThreadGroup()
        )

    def answer(self) -> None:
        """Answer the request that has waited longest, if there is one."""
        service: Any = self._service
        kind = service.srv_type
        with service.handle:
            request, header = service.handle.service_take_request(kind.Request)
        if header is not None:
            service.send_response(service.callback(request, kind.Response()), header)


class GroupExecutor(SingleThreadedExecutor):
    """Runs the callbacks of one group of a node in a thread until it is shut down.

    Parameters
    ----------
    node : Node
        The node; another executor may have its other entities.
    group : ThreadGroup
        The group.
    """

    def __init__(self, node: Node, group: ThreadGroup) -> None:
        super().__init__(context=node.context)
        self._group, self._is_ending = group, threading.Event()
        group.thread = threading.Thread(target=self._run, args=[[node]], daemon=True)
        group.thread.start()

    def can_execute(self, entity: Any) -> bool:
        """Whether the entity is of the group."""
        return entity.callback_group is self._group

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """End the thread, before the node is destroyed."""
        assert self._group.thread is not None
        self._is_ending.set()
        self.wake()
        self._group.thread.join(timeout_sec)
        return super().shutdown(timeout_sec)

    def _run(self, nodes: list[Node]) -> None:
        is_ending = self._is_ending.is_set
        with suppress(ConditionReachedException, ExternalShutdownException):
            while True:
                try:
                    handler, _, _ = self.wait_for_ready_callbacks(nodes=nodes, condition=is_ending)
                    # It keeps its exceptions: an unreadable message must not end the thread.
                    handler()
                except (ConditionReachedException, ExternalShutdownException):
                    raise
                except Exception as error:  # such as an entity that another thread has destroyed
                    nodes[0].get_logger().error(f"{error!r:.200}", throttle_duration_sec=1.0)
