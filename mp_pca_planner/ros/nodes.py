# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes: one that survives exceptions, one of a client, and their start and end."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..exceptions import PlannerError, printable
from ..execution.parameters import ParameterError
from ..files import reading
from .messages import to_text
from .serialised import read_message

LOG_PERIOD = 1.0
"""Least time between log messages of the same place [s]."""


class GuardedNode(Node):
    """A node that logs exceptions of its callbacks and answers every service request.

    This holds for the services and subscriptions that rclpy creates, too.

    Attributes
    ----------
    n_internal_errors : int
        Exceptions that no input should cause.
    """

    n_internal_errors = 0

    def seconds(self) -> float:
        """The time by the clock of the node [s]."""
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def explain(self, error: BaseException) -> str:
        """Describe an error in one sentence; log the traceback of an internal one."""
        if isinstance(error, PlannerError):
            return to_text(error)
        if isinstance(error, OSError) and error.strerror:
            # The name is shortened, because its length may be the error.
            file = f": '{error.filename!s:.80}'" if error.filename else ""
            return to_text(f"the operating system reports: {error.strerror}{file}")
        if isinstance(error, MemoryError):
            return "the system is out of memory"
        self.n_internal_errors += 1
        lines = traceback.format_exception(error)
        found = "\n".join(printable(line) for line in "".join(lines).splitlines())
        self.get_logger().error(found, throttle_duration_sec=LOG_PERIOD)
        return to_text(f"internal error, please report it: {error!r}")

    def guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a callback that logs exceptions instead of raising them."""

        @wraps(callback)
        def call(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except Exception as error:
                text = self._explain_failure(callback, error)
                self.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)

        return call

    def _explain_failure(self, callback: Any, error: Exception) -> str:
        # Callbacks of rclpy may raise on received values, such as a negative time on /clock.
        if getattr(callback, "__module__", "").startswith("rclpy."):
            return to_text(f"rclpy rejects the received message: {error}")
        return self.explain(error)

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Any,
        *arguments: Any,
        raw: bool = False,
        **options: Any,
    ) -> Any:
        """Guarded version of the method of `Node`, which checks messages before it reads them."""

        @wraps(callback)
        def receive(content: bytes) -> None:
            with reading(f"a message on '{topic}'", PlannerError):
                message = content if raw else read_message(content, msg_type)
            callback(message)

        guarded = self.guarded(receive)
        return super().create_subscription(
            msg_type, topic, guarded, *arguments, raw=True, **options
        )

    def create_timer(
        self, timer_period_sec: float, callback: Any, *arguments: Any, **options: Any
    ) -> Any:
        """Guarded version of the method of `Node`."""
        return super().create_timer(timer_period_sec, self.guarded(callback), *arguments, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Guarded version of the method of `Node`; the response reports an error."""
        return super().create_service(srv_type, srv_name, self.answering(callback), **options)

    def answering(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback of a service that answers whatever happens.

        After an exception, the response says why if it has a message, and its other fields keep
        their defaults: ``success`` is false.
        """

        @wraps(callback)
        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                text = self._explain_failure(callback, error)
                if hasattr(response, "message"):
                    response.message = text
                else:
                    self.get_logger().warning(text, throttle_duration_sec=LOG_PERIOD)
                return response

        return answer


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
