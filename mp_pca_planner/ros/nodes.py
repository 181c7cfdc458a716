# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that survive exceptions, their start and end, and what is outside of their executor.

The executor waits for all entities of a node at once and handles them one after the other. A
thousand states a second would keep it busy, and a goal would wait behind a service.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from typing import Any

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import (
    ConditionReachedException,
    ExternalShutdownException,
    SingleThreadedExecutor,
)
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from ..exceptions import PlannerError, printable
from ..files import reading
from .messages import to_text
from .serialised import read_message

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

_LARGE = 100_000  # of a message [bytes]; smaller ones are taken in some tenths of a millisecond
_COPY_TIME = 2e-9  # of a byte [s]


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
            give_way(content)
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
    PlannerError
        If the arguments are rejected.
    """
    try:
        # rclpy's own handlers would shut the context down under a running callback.
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise PlannerError(f"the arguments after --ros-args are rejected: {reason}") from error


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


def give_way(content: bytes) -> None:
    """Sleep after a large message was taken, so that waiting threads go on before the next one.

    The call that takes it copies it, and keeps the lock of the interpreter meanwhile.
    """
    if len(content) > _LARGE:
        time.sleep(len(content) * _COPY_TIME)


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
    gives_way : bool
        Whether the thread that polls sleeps after a large message; the safety thread must not.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        qos: QoSProfile | int,
        *,
        gives_way: bool = False,
    ) -> None:
        self._node, self._gives_way = node, gives_way
        self._subscription = node.create_subscription(
            message_type, topic, lambda _: None, qos, callback_group=ThreadGroup(), raw=True
        )

    def poll(self) -> list[tuple[bytes, dict[str, int]]]:
        """Return the serialised messages that have arrived, the newest last, and their facts."""
        subscription: Any = self._subscription
        polled = []
        with subscription.handle:
            for _ in range(subscription.qos_profile.depth):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                polled.append(taken)
                if self._gives_way:
                    give_way(taken[0])
        return polled

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
