# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that serves one goal at a time, and that newer goals preempt."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from concurrent.futures import CancelledError
from typing import Any, Generic, TypeVar

T = TypeVar("T")

IsCancelled = Callable[[], bool]


class PreemptiveWorker(Generic[T]):
    """Serves one goal at a time; a newer one replaces the waiting one and cancels the served one.

    Goals may arrive faster than they can be served. Therefore, the goal after a cancelled one is
    not cancelled in turn: at least every second goal that is begun is finished. The thread survives
    every exception.

    Parameters
    ----------
    serve :
        Serves a goal. Once its second argument returns True, it may return at any time or raise
        `CancelledError`.
    drop :
        Called with each goal that was cancelled or replaced.
    rest :
        Called when a goal was served and no other came for `pause`: for work that can wait.
    fail :
        Called with an exception of the other functions, and the goal; None for one of `rest`.
    """

    pause = 0.02
    """Idle time after which other work is done [s]."""

    def __init__(
        self,
        serve: Callable[[T, IsCancelled], None],
        drop: Callable[[T], None],
        rest: Callable[[], None],
        fail: Callable[[T | None, BaseException], None],
    ) -> None:
        self._serve = serve
        self._drop = drop
        self._rest = rest
        self._fail = fail
        self._changed = threading.Condition()
        self._waiting: T | None = None
        self._dropped: list[T] = []  # by `cancel`
        self._is_serving = self._is_cancelled = self._is_closed = False
        self._may_cancel = True
        # A daemon: a goal that never ends must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    def submit(self, goal: T) -> None:
        """Serve a goal as soon as possible; it replaces the waiting one."""
        with self._changed:
            dropped, self._waiting = self._waiting, goal
            self._is_cancelled = self._is_cancelled or (self._is_serving and self._may_cancel)
            self._changed.notify_all()
        if dropped is not None:
            self._attempt(dropped, self._drop)

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
        """Cancel the waiting and the served goal; the thread drops both."""
        with self._changed:
            if self._waiting is not None:
                self._dropped.append(self._waiting)
            self._waiting, self._is_cancelled = None, self._is_serving
            self._changed.notify_all()

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
                    lambda: self._is_closed or self._dropped or self._waiting is not None,
                    self.pause if may_rest else None,
                )
                goal, self._waiting = self._waiting, None
                dropped, self._dropped = self._dropped, []
                self._is_serving, self._is_cancelled = goal is not None, False
            for one in dropped:
                self._attempt(one, self._drop)
            if self._is_closed:
                return
            if goal is not None:
                self._attempt(goal, self._serve_one)
                self._is_serving = False
            elif may_rest:
                self._attempt(None, lambda _: self._rest())
            may_rest = goal is not None

    def _serve_one(self, goal: T) -> None:
        try:
            self._serve(goal, lambda: self._is_cancelled)
            self._may_cancel = True
        except CancelledError:
            self._may_cancel = False
            self._drop(goal)

    def _attempt(self, goal: Any, work: Callable[[Any], None]) -> None:
        """Do some work; whatever it raises, the thread goes on."""
        try:
            work(goal)
        except BaseException as error:  # such as SystemExit, which ends a thread silently
            try:
                self._fail(goal, error)
            except BaseException:
                traceback.print_exc()
