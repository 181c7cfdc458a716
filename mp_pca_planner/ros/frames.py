# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Frames that are not links of the robot, in which obstacles and pose goals may be stated."""

from __future__ import annotations

import threading
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from ..arrays import FloatArray
from ..execution.parameters import fixed_frames
from ..execution.serving.assembly import Model


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
        self._lock = threading.Lock()
        self._is_installed = find_spec("tf2_ros") is not None

    def pose(self, frame: str, model: Model, wait: float = 0.0) -> FloatArray | None:
        """The newest pose of a frame in the base frame, shape (7,); None if it is unknown.

        Parameters
        ----------
        frame : str
            The frame.
        model : Model
            Has the parameters and the robot.
        wait : float
            Longest time to wait for its transform [s].
        """
        if (fixed := fixed_frames(model.settings.fixed_frames).get(frame)) is not None:
            return np.array(fixed)
        if not self._is_installed:
            return None
        tf2_ros = import_module("tf2_ros")
        with self._lock:
            if self._buffer is None:
                self._buffer = tf2_ros.Buffer(node=self._node)
                self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        base, longest = model.robot.frame_names[0], Duration(seconds=wait)
        with suppress(tf2_ros.TransformException):
            found = self._buffer.lookup_transform(base, frame, Time(), longest).transform
            p, o = found.translation, found.rotation
            return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        return None
