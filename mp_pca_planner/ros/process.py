# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a process that runs a node until it is signalled to stop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..execution.parameters import ParameterError


def start_ros(arguments: Sequence[str]) -> None:
    """Initialise ROS, with signals left to the caller.

    Raises
    ------
    ParameterError
        If the arguments are rejected.
    """
    try:
        # rclpy's own handlers would shut the context down under a running callback.
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise ParameterError(f"the arguments after --ros-args are rejected: {reason}") from error


def spin_until(stop: threading.Event, node: Node, pause: Callable[[], float]) -> None:
    """Run a node until the event is set, then end it and ROS.

    Parameters
    ----------
    stop : Event
        Ends the node.
    node : Node
        The node.
    pause : callable
        Returns the longest time to wait for the next message [s]; called before each wait.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stop.is_set():
            executor.spin_once(timeout_sec=pause())
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
