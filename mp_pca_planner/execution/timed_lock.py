# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A lock that no thread waits for without a limit."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ..exceptions import GoalError

# Longest wait of the thread that stops the robot, for any lock [s].
SAFETY_WAIT = 5e-3
# Longest wait of all others [s]; locks are held for some milliseconds.
_WAIT = 2.0


class BusyError(GoalError):
    """Another thread has held a lock for too long."""


class TimedLock:
    """A reentrant lock with a limited wait; use it as a context manager.

    Raises
    ------
    BusyError
        If the wait exceeds two seconds.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(timeout=_WAIT):
            raise _busy(_WAIT)

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextmanager
    def within(self, wait: float = SAFETY_WAIT) -> Iterator[None]:
        """The same with another longest wait [s]."""
        if not self._lock.acquire(timeout=wait):
            raise _busy(wait)
        try:
            yield
        finally:
            self._lock.release()


def _busy(wait: float) -> BusyError:
    return BusyError(f"another task of the node took longer than {wait:g} s; send the goal again")
