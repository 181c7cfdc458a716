# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The thread that watches the robot and stops it, whatever the other threads do."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from std_srvs.srv import Trigger

from ..execution.threads import BusyError
from .nodes import GuardedNode
from .subscriptions import PolledService


class SafetyThread:
    """Watches the robot at 20 Hz and answers ``~/stop`` at 100 Hz.

    What it calls reads no files, builds no models, plans nothing and waits at most 5 ms for a lock.

    Parameters
    ----------
    node : GuardedNode
        The node.
    watch : callable
        Checks how the robot follows its motion; raises a `BusyError` to be called again soon.
    stop : callable
        Callback of the service that stops the robot.
    """

    period = 0.01
    """Time between two requests that are answered [s]."""

    watch_period = 0.05
    """Time between two checks [s]."""

    def __init__(
        self,
        node: GuardedNode,
        watch: Callable[[], None],
        stop: Callable[[Trigger.Request, Trigger.Response], Trigger.Response],
    ) -> None:
        self._watch = watch
        # Polled, because an executor gives the lock of the interpreter away several times a cycle.
        service = PolledService(node, Trigger, "~/stop", stop)
        self._answer, self._check = node.guarded(service.answer), node.guarded(self._watch_in_turn)
        self._watched = self._cycled = time.monotonic()
        self._longest_gap = 0.0
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name="safety", daemon=True)
        self._thread.start()

    def longest_gap(self) -> float:
        """The longest time between two cycles since the last call, also of the present one [s]."""
        longest, self._longest_gap = self._longest_gap, 0.0
        return max(longest, time.monotonic() - self._cycled)

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._is_ending = True
        self._thread.join()

    def _run(self) -> None:
        while not self._is_ending:
            # Not an event: waiting for one takes the lock of the interpreter several times.
            time.sleep(self.period)
            now = time.monotonic()
            self._longest_gap = max(self._longest_gap, now - self._cycled)
            self._cycled = now
            self._answer()
            self._check()

    def _watch_in_turn(self) -> None:
        if self._cycled - self._watched < self.watch_period:
            return
        try:
            self._watch()
        except BusyError:  # another thread publishes a motion just now
            return
        self._watched = self._cycled
