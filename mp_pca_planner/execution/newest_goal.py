# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that serves goals, of which the newest wins."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

IsCancelled = Callable[[], bool]


PAUSE = 0.02
"""Time without goals after which there is time for other work [s]."""


class CancelledError(Exception):
    """Work was given up because nobody wants its result any more."""


class NewestGoalThread(Generic[T]):
    """Serves one goal at a time; a newer one takes the place of the waiting and the served one.

    A goal that comes while another is served cancels it. Goals may come faster than any can be
    served, so the one that is served next after a cancelled one is not cancelled in its turn:
    at least every second goal that is begun is finished.

    Parameters
    ----------
    serve :
        Serves a goal. When the second argument says that it is cancelled, it may return at any
        time or raise `CancelledError`.
    drop :
        Called with each goal that was not served to its end.
    rest :
        Called when a goal was served and no other came for `PAUSE`: for work that can wait.
    """

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
        self._is_serving = False
        self._may_cancel = True
        self._is_cancelled = False
        self._is_closed = False
        # A defect that keeps it from ending must not keep the process from it.
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    def submit(self, goal: T) -> None:
        """Have a goal served as soon as possible."""
        with self._changed:
            overtaken, self._waiting = self._waiting, goal
            if self._is_serving and self._may_cancel:
                self._is_cancelled = True
            self._changed.notify_all()
        if overtaken is not None:
            self._drop(overtaken)

    @property
    def is_idle(self) -> bool:
        """Whether no goal is served or waits."""
        return self._waiting is None and not self._is_serving

    def cancel(self) -> None:
        """Give up what waits and what is served."""
        with self._changed:
            dropped, self._waiting = self._waiting, None
            self._is_cancelled = True
        if dropped is not None:
            self._drop(dropped)

    def close(self, timeout: float = 5.0) -> None:
        """Give up everything and end the thread, within the timeout [s] if goals let it."""
        self.cancel()
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._thread.join(timeout)

    def _run(self) -> None:
        may_rest = False
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._is_closed or self._waiting is not None,
                    PAUSE if may_rest else None,
                )
                if self._is_closed:
                    return
                goal, self._waiting = self._waiting, None
                self._is_serving, self._is_cancelled = goal is not None, False
            if goal is None:
                self._rest()
                may_rest = False
                continue
            may_rest = True
            try:
                self._serve(goal, lambda: self._is_cancelled)
                self._may_cancel = True
            except CancelledError:
                self._may_cancel = False
                self._drop(goal)
            finally:
                self._is_serving = False
