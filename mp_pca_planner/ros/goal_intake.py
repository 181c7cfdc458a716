# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that takes goals as soon as they come.

An executor of rclpy waits for everything of a node at once, which takes it half a millisecond, and
a goal would wait behind whatever else it is busy with. A thread for goals alone is quicker, and it
hears of the next goal while one is planned.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context

# As rclpy.wait_for_message does.
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

# Longest time that the end of the thread waits [ns].
_LONGEST_WAIT = 10**8


class FetchedByHand(CallbackGroup):
    """Of subscriptions whose messages wait in the middleware until they are fetched.

    For the executor to hand out a message takes it longer than to plan with some: a thousand
    states a second would keep it busy, to no use.
    """

    def can_execute(self, entity: object) -> bool:
        """Never: see the class."""
        return False

    def beginning_execution(self, entity: object) -> bool:
        """Never: see the class."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Nothing ever begins."""


def waiting_messages(subscription: Subscription) -> Iterator[tuple[Any, dict[str, int]]]:
    """Fetch what has come to a subscription: messages, the newest last, and facts about each.

    Its handle must be held meanwhile.
    """
    for _ in range(subscription.qos_profile.depth):
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        yield taken


@dataclass(frozen=True, eq=False)
class Inlet:
    """A subscription that is fetched by hand, and what becomes of its messages.

    Attributes
    ----------
    subscription : Subscription
        In a group :class:`FetchedByHand`.
    receive : callable
        Called with all messages that have come, the newest last; it must not raise.
    """

    subscription: Subscription
    receive: Callable[[list[Any]], None]

    def fetch(self) -> None:
        """Hand over what has come."""
        messages = [message for message, _ in waiting_messages(self.subscription)]
        if messages:
            self.receive(messages)


class GoalIntake:
    """Waits for goals until it is closed.

    Parameters
    ----------
    context : Context
        Of the node.
    inlets : sequence of Inlet
        Where goals come from.
    """

    def __init__(self, context: Context, inlets: list[Inlet]) -> None:
        self._context, self._inlets = context, inlets
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="goal intake", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread: before the subscriptions are destroyed."""
        self._is_closed = True
        self._thread.join()

    def _run(self) -> None:
        with ExitStack() as stack:
            handles = [inlet.subscription.handle for inlet in self._inlets]
            for handle in (self._context.handle, *handles):
                stack.enter_context(handle)
            wait_set = rclpy_implementation.WaitSet(
                len(handles), 0, 0, 0, 0, 0, self._context.handle
            )
            while not self._is_closed and self._context.ok():
                wait_set.clear_entities()
                for handle in handles:
                    wait_set.add_subscription(handle)
                wait_set.wait(_LONGEST_WAIT)
                ready = wait_set.get_ready_entities("subscription")
                for inlet in self._inlets:
                    if inlet.subscription.handle.pointer in ready:
                        inlet.fetch()
