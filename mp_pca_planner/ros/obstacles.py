# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topic of obstacles, and the frames that they, and poses, are stated in.

Their content is for the workers.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from visualization_msgs.msg import MarkerArray

from ..arrays import FloatArray
from ..execution.parameters import fixed_frames
from ..execution.server import NodeModel
from .markers import Markers
from .nodes import LOG_PERIOD, PolledSubscription

_MOST_BYTES = 1_000_000  # at a time: to take 13 MB keeps the node busy for 45 ms
_DEPTH = 100  # bursts of messages wait
_DISCOVERY_PERIOD = 0.1  # [s]
# Time after which a subscription that is not lasting has received what it can [s]: publishers
# discover it within 3 s.
_FETCHING = 5.0


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
        # Subscriptions, whether they get what was latched, and when they end.
        self._open: list[tuple[PolledSubscription, bool, float]] = []
        self._known: set[bytes] = set()
        self._discovered = 0.0

    def poll(self) -> list[Markers]:
        """Return the messages that have arrived; a message may be returned twice."""
        now = time.monotonic()
        if now - self._discovered >= _DISCOVERY_PERIOD:
            self._discovered = now
            self._follow_publishers(now)
        messages = [
            Markers(bytes(content), facts["source_timestamp"], is_latched)
            for subscription, is_latched, _ in self._open
            for content, facts in subscription.poll(_MOST_BYTES)
        ]
        for one in [one for one in self._open if one[2] < now]:
            self._open.remove(one)
            one[0].destroy()
        return messages

    def _follow_publishers(self, now: float) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._name)
        offers = {bytes(one.endpoint_gid): one.qos_profile for one in publishers}
        reliable = {
            key for key, qos in offers.items() if qos.reliability == ReliabilityPolicy.RELIABLE
        }
        if offers and (len(reliable) == len(offers)) != self._is_reliable:
            self._is_reliable = len(reliable) == len(offers)
            # The one before still receives for a while.
            self._open = [(one, kind, min(end, now + _FETCHING)) for one, kind, end in self._open]
            self._subscribe(self._is_reliable, False, math.inf)
        latched = {
            key for key in reliable if offers[key].durability == DurabilityPolicy.TRANSIENT_LOCAL
        }
        if latched - self._known:
            self._subscribe(True, True, now + _FETCHING)
            if n_others := len(offers) - len(latched):
                self._node.get_logger().info(
                    f"'{self._name}' has publishers that latch their messages and {n_others} that "
                    "do not: what these log now on incompatible QoS concerns a second "
                    "subscription, and their messages are received",
                    throttle_duration_sec=LOG_PERIOD,
                )
        self._known = latched

    def _subscribe(self, is_reliable: bool, is_latched: bool, end: float) -> None:
        qos = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy[("BEST_EFFORT", "RELIABLE")[is_reliable]],
            durability=DurabilityPolicy[("VOLATILE", "TRANSIENT_LOCAL")[is_latched]],
        )
        subscription = PolledSubscription(self._node, MarkerArray, self._topic, qos)
        self._open.append((subscription, is_latched, end))


class ForeignFrames:
    """Looks up frames in the parameter ``fixed_frames``, then in tf2.

    tf2_ros is part of ROS 2, but there is no package of it for pip. Without it, only fixed frames
    are known. Transforms are listened to from the first look on.

    Parameters
    ----------
    node : Node
        The node.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._buffer: Any = None
        self._is_installed = find_spec("tf2_ros") is not None

    def pose(self, frame: str, model: NodeModel) -> FloatArray | None:
        """The newest pose of a frame in the base frame, shape (7,); None if it is unknown.

        Parameters
        ----------
        frame : str
            The frame.
        model : NodeModel
            Has the parameters and the robot.
        """
        if (fixed := fixed_frames(model.settings.fixed_frames).get(frame)) is not None:
            return np.array(fixed)
        if not self._is_installed:
            return None
        tf2_ros = import_module("tf2_ros")
        if self._buffer is None:
            self._buffer = tf2_ros.Buffer(node=self._node)
            self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        base = model.robot.frame_names[0]
        with suppress(tf2_ros.TransformException):
            found = self._buffer.lookup_transform(base, frame, Time()).transform
            p, o = found.translation, found.rotation
            return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        return None
