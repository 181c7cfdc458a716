# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is outside of the node's executor: polled entities, and those with their own thread.

The executor waits for all entities of a node at once and handles them one after the other. A
thousand states a second would keep it busy, and a goal would wait behind a service.
"""

from __future__ import annotations

import threading
import time
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
from visualization_msgs.msg import MarkerArray

from ..exceptions import PlannerError
from ..files import reading
from .nodes import LOG_PERIOD
from .serialised import read_message

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
        Whether messages stay serialised; otherwise those that are malformed are ignored.
    """

    def __init__(
        self, node: Node, message_type: Any, topic: str, qos: QoSProfile | int, *, raw: bool = False
    ) -> None:
        self._node, self._raw = node, raw
        self._subscription = node.create_subscription(
            message_type, topic, lambda _: None, qos, callback_group=ThreadGroup(), raw=True
        )

    def poll(self) -> list[tuple[Any, dict[str, int]]]:
        """Return the messages that have arrived, the newest last, and facts about each."""
        subscription: Any = self._subscription
        polled = []
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                polled.append(taken)
        if self._raw:
            return polled
        messages = []
        for content, facts in polled:
            with suppress(PlannerError), reading("a message", PlannerError):
                messages.append((read_message(content, subscription.msg_type), facts))
        return messages

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


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


_DEPTH = 100  # bursts of messages wait
_DISCOVERY_PERIOD = 0.1  # [s]
# Time after which a subscription that is not lasting has received what it can [s]: publishers
# discover it within 3 s.
_FETCHING = 5.0


MarkerMessage = tuple[bytes, int, bool]
"""A serialised message of markers, when it was sent [ns], and whether it may be older than others
because it was latched."""


class MarkerSubscription:
    """Receives the markers of all publishers of a topic, and those they have latched.

    Parameters
    ----------
    node : Node
        The node.
    topic : str
        The topic.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._name = node.resolve_topic_name(topic)
        self._is_reliable: bool | None = None
        self._lasting: PolledSubscription | None = None
        # Subscriptions that end, and when.
        self._ending: list[tuple[float, PolledSubscription, bool]] = []
        self._known: set[bytes] = set()
        self._discovered = 0.0

    def poll(self) -> list[MarkerMessage]:
        """Return the messages that have arrived; a message may be returned twice."""
        now = time.monotonic()
        if now - self._discovered >= _DISCOVERY_PERIOD:
            self._discovered = now
            self._follow_publishers(now)
        messages = [(one, False) for one in (self._lasting.poll() if self._lasting else ())]
        for _, subscription, is_latched in self._ending:
            messages += [(one, is_latched) for one in subscription.poll()]
        for end in [one for one in self._ending if one[0] < now]:
            self._ending.remove(end)
            end[1].destroy()
        return [
            (bytes(content), facts["source_timestamp"], is_late)
            for (content, facts), is_late in messages
        ]

    def _follow_publishers(self, now: float) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._name)
        offers = {bytes(one.endpoint_gid): one.qos_profile for one in publishers}
        reliable = {
            key for key, qos in offers.items() if qos.reliability == ReliabilityPolicy.RELIABLE
        }
        if offers and (len(reliable) == len(offers)) != self._is_reliable:
            self._is_reliable = len(reliable) == len(offers)
            if self._lasting is not None:
                self._ending.append((now + _FETCHING, self._lasting, False))
            self._lasting = self._subscribe(is_reliable=self._is_reliable)
        latched = {
            key for key in reliable if offers[key].durability == DurabilityPolicy.TRANSIENT_LOCAL
        }
        if latched - self._known:
            self._fetch_latched(now, n_others=len(offers) - len(latched))
        self._known = latched

    def _fetch_latched(self, now: float, n_others: int) -> None:
        latched = self._subscribe(is_reliable=True, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._ending.append((now + _FETCHING, latched, True))
        if n_others:
            self._node.get_logger().info(
                f"'{self._name}' has publishers that latch their messages and {n_others} that do "
                "not: what these log now on incompatible QoS concerns a second subscription, and "
                "their messages are received",
                throttle_duration_sec=LOG_PERIOD,
            )

    def _subscribe(
        self, *, is_reliable: bool, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    ) -> PolledSubscription:
        best = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=_DEPTH, reliability=best, durability=durability)
        return PolledSubscription(self._node, MarkerArray, self._topic, qos, raw=True)
