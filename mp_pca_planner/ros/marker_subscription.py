# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The subscription of obstacles, whose quality of service follows the publishers.

A subscription that requests more than a publisher offers makes that publisher log that it sends
nothing to it. Therefore, the lasting subscription requests no latched messages, and reliability
only while all publishers offer it. It begins when a publisher is discovered: one that sends a
single message and ends would lose that on the way to a subscription that acknowledges nothing.
Latched messages of a publisher are fetched once, by another subscription that ends after some
seconds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from .guarded_node import LOG_PERIOD
from .subscriptions import PolledSubscription

_DEPTH = 100  # bursts of messages wait
_DISCOVERY_PERIOD = 0.1  # [s]
# Time after which a subscription that is not lasting has received what it can [s]: publishers
# discover it within 3 s.
_FETCHING = 5.0


@dataclass(frozen=True)
class MarkerMessage:
    """A message of markers.

    Attributes
    ----------
    content : bytes
        The serialised message.
    stamp : int
        When it was sent [ns].
    is_late : bool
        Whether it may be older than others: it was latched.
    """

    content: bytes
    stamp: int
    is_late: bool


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
            MarkerMessage(bytes(content), facts["source_timestamp"], is_late)
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
