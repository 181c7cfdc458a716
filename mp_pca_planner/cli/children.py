# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that run in processes of their own, and end with the one that started them."""

from __future__ import annotations

import signal
import subprocess
import sys
from types import TracebackType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE = 10.0  # between the signal to end and SIGKILL [s]


class Children:
    """Starts commands, and ends all of them when the block ends; use it as a context manager.

    The first SIGINT, SIGTERM or SIGHUP raises KeyboardInterrupt, but never between the start of a
    child and the moment it is known, nor while the children are ended.
    """

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[str]] = []
        self._previous: dict[int, Any] = {}
        self._is_starting = self._is_interrupted = False

    def start(self, command: str, *arguments: str) -> subprocess.Popen[str]:
        """Start a command of this package; what it prints on stdout is dropped."""
        words = [sys.executable, "-m", __package__.partition(".")[0], command, *arguments]
        self._is_starting = True
        self._processes.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, text=True))
        self._is_starting = False
        if self._is_interrupted:
            raise KeyboardInterrupt
        return self._processes[-1]

    def __enter__(self) -> Children:
        for number in _SIGNALS:
            # nohup ignores SIGHUP, and means it. Shells ignore SIGINT for background jobs, but
            # children that inherited this could not be ended by it.
            if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                self._previous[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._is_interrupted = True  # from now on, signals are ignored
        for process in self._processes:
            process.send_signal(signal.SIGINT)
        for process in self._processes:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for ending, handler in self._previous.items():
            signal.signal(ending, handler)

    def _interrupt(self, *_: object) -> None:
        is_first, self._is_interrupted = not self._is_interrupted, True
        if is_first and not self._is_starting:
            raise KeyboardInterrupt
