# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commands as child processes, which end with the process that started them."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE = 10.0  # time between the signal to end and SIGKILL [s]


class Children:
    """Context manager that starts commands, and ends all of them when its block ends.

    The first SIGINT, SIGTERM or SIGHUP raises KeyboardInterrupt, except while a child is started
    and while the children are ended; then it is deferred or ignored.
    """

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[str]] = []
        self._previous: dict[int, Any] = {}
        self._is_starting = self._is_interrupted = False

    def start(self, command: str, *arguments: str) -> None:
        """Start a command of this package; its stdout is discarded."""
        words = [sys.executable, "-m", __package__.partition(".")[0], command, *arguments]
        self._is_starting = True
        self._processes.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, text=True))
        self._is_starting = False
        if self._is_interrupted:
            raise KeyboardInterrupt

    def __enter__(self) -> Children:
        for number in _SIGNALS:
            # An ignored SIGHUP, as under nohup, stays ignored. SIGINT, which shells ignore for
            # background jobs, is handled, because it must end the children.
            if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                self._previous[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
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
