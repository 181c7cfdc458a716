# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A node that survives exceptions in its callbacks."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from functools import wraps
from typing import Any

from rclpy.node import Node

from ..exceptions import PlannerError, printable
from .messages import to_text

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
        self, msg_type: Any, topic: str, callback: Any, *arguments: Any, **options: Any
    ) -> Any:
        """Guarded version of the method of `Node`."""
        guarded = self.guarded(callback)
        return super().create_subscription(msg_type, topic, guarded, *arguments, **options)

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
