# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that answers the newest request."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class NewestFirst(Generic[T]):
    """Serves one request at a time, in a thread; a newer one replaces the one that waits.

    Parameters
    ----------
    serve :
        Serves a request.
    fail :
        Called with a request and the exception that serving it has raised.
    """

    def __init__(
        self, serve: Callable[[T], None], fail: Callable[[T, BaseException], None]
    ) -> None:
        self._serve, self._fail = serve, fail
        self._changed = threading.Condition()
        self._waiting: T | None = None
        self._is_serving = self._is_closed = False
        # A daemon: a request that never ends must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    def submit(self, request: T) -> None:
        """Serve a request as soon as possible; it replaces the waiting one."""
        with self._changed:
            self._waiting = request
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether no request is served or waits."""
        with self._changed:
            return self._waiting is None and not self._is_serving

    def close(self, timeout: float = 5.0) -> None:
        """End the thread, within the timeout [s] if the served request ends."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._is_serving = False
                self._changed.wait_for(lambda: self._is_closed or self._waiting is not None)
                if self._is_closed:
                    return
                request, self._waiting = self._waiting, None
                self._is_serving = True
            assert request is not None
            try:
                self._serve(request)
            except BaseException as error:  # such as SystemExit, which ends a thread silently
                self._fail(request, error)
