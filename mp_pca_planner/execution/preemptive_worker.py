# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that serves goals and is preempted by newer ones."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

IsCancelled = Callable[[], bool]


class CancelledError(Exception):
    """Work was aborted because its result is no longer needed."""


class PreemptiveWorker(Generic[T]):
    """Serves one goal at a time; a newer one replaces the waiting one and cancels the served one.

    Goals may arrive faster than they can be served. Therefore, the goal after a cancelled one is
    not cancelled in turn: at least every second goal that is begun is finished.

    Parameters
    ----------
    serve :
        Serves a goal. Once its second argument returns True, it may return at any time or raise
        `CancelledError`.
    drop :
        Called with each goal that was cancelled or replaced.
    rest :
        Called when a goal was served and no other came for `pause`: for work that can wait.
    """

    pause = 0.02
    """Idle time after which other work is done [s]."""

    def __init__(
        self,
        serve: Callable[[T, IsCancelled], None],
        drop: Callable[[T], None],
        rest: Callable[[], None],
    ) -> None:
        self._serve = serve
        self._drop = drop
        self._rest = rest
        self._changed = threading.Condition()
        self._waiting: T | None = None
        self._is_serving = self._is_cancelled = self._is_closed = False
        self._may_cancel = True
        # A daemon: a goal that never ends must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    def submit(self, goal: T | None, *, always_cancel: bool = False) -> None:
        """Serve a goal as soon as possible, or none; it replaces the waiting one."""
        with self._changed:
            dropped, self._waiting = self._waiting, goal
            if self._is_serving and (always_cancel or self._may_cancel):
                self._is_cancelled = True
            self._changed.notify_all()
        if dropped is not None:
            self._drop(dropped)

    def submit_if_idle(self, goal: T) -> bool:
        """Serve a goal unless another one is served or waits; return whether it is."""
        with self._changed:
            if not self.is_idle:
                return False
            self._waiting = goal
            self._changed.notify_all()
        return True

    @property
    def is_idle(self) -> bool:
        """Whether no goal is served or waits."""
        return self._waiting is None and not self._is_serving

    def cancel(self) -> None:
        """Cancel the waiting and the served goal."""
        self.submit(None, always_cancel=True)

    def close(self, timeout: float = 5.0) -> None:
        """Cancel all goals and end the thread, within the timeout [s] if the served goal ends."""
        self._is_closed = True
        self.cancel()
        self._thread.join(timeout)

    def _run(self) -> None:
        may_rest = False
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._is_closed or self._waiting is not None,
                    self.pause if may_rest else None,
                )
                if self._is_closed:
                    return
                goal, self._waiting = self._waiting, None
                self._is_serving, self._is_cancelled = goal is not None, False
            may_rest = goal is not None
            if goal is None:
                self._rest()
                continue
            try:
                self._serve(goal, lambda: self._is_cancelled)
                self._may_cancel = True
            except CancelledError:
                self._may_cancel = False
                self._drop(goal)
            finally:
                self._is_serving = False
