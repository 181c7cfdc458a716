# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Poses of frames from tf2, where it is installed."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from ..arrays import FloatArray


class FrameTransforms:
    """Looks up frames in tf2; it listens to transforms from the first look on.

    tf2_ros is part of ROS 2, but there is no package of it for pip. Without it, no pose is known.

    Parameters
    ----------
    node : Node
        The node.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._buffer: Any = None
        self._is_installed = find_spec("tf2_ros") is not None

    def pose(self, frame: str, base: str) -> FloatArray | None:
        """The newest pose of a frame in another one, shape (7,); None if it is unknown."""
        if not self._is_installed:
            return None
        tf2_ros = import_module("tf2_ros")
        if self._buffer is None:
            self._buffer = tf2_ros.Buffer(node=self._node)
            self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        with suppress(tf2_ros.TransformException):
            found = self._buffer.lookup_transform(base, frame, Time()).transform
            p, o = found.translation, found.rotation
            return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        return None
