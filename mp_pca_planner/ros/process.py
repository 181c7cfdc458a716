# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Start and end of nodes: one of a process that runs until a signal, or one of a client."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..exceptions import PlannerError
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


class NoAnswerError(PlannerError):
    """The node did not answer in time."""


class NodeInOwnContext:
    """A node in a context of its own; use it as a context manager.

    The context of the process and its signal handlers are not changed.

    Parameters
    ----------
    name : str
        Name of the node.
    namespace : str
        Namespace of both nodes.
    planner : str
        Name of the planner's node.

    Attributes
    ----------
    context : Context
        The context.
    node : Node
        The node.
    """

    def __init__(self, name: str, namespace: str, planner: str) -> None:
        self.planner = planner
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name, context=self.context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def spin_once(self, timeout: float = 0.05) -> None:
        """Take one message that has arrived, or wait for one [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def wait(
        self, is_done: Callable[[], bool], timeout: float, complaint: str | Callable[[], str]
    ) -> None:
        """Receive messages until a condition holds.

        Raises
        ------
        NoAnswerError
            If that takes longer than the timeout [s]; the message states what the planner's node
            failed to do.
        """
        deadline = time.monotonic() + timeout
        while not is_done():
            if time.monotonic() > deadline:
                text = complaint if isinstance(complaint, str) else complaint()
                raise NoAnswerError(f"the node '{self.planner}' {text} within {timeout:g} s")
            self.spin_once()

    def result(self, client: Any, request: Any, timeout: float = 10.0) -> Any:
        """Return the response of a service, or raise a `NoAnswerError`."""
        future = client.call_async(request)
        self.wait(future.done, timeout, f"did not answer on '{client.srv_name}'")
        return future.result()
