# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Keys of a person at a terminal, or the lines of another program."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any


class Keys:
    """Keys of standard input; a context manager.

    At a terminal, each key counts at once. Otherwise the first letter of each line does.
    """

    def __init__(self) -> None:
        self._input = 0 if sys.stdin is None else sys.stdin.fileno()
        self._waiting, self._line, self._is_open = "", "", True
        self._settings: list[Any] | None = None

    def __enter__(self) -> Keys:
        if os.isatty(self._input):
            self._settings = termios.tcgetattr(self._input)
            tty.setcbreak(self._input)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if self._settings is not None:
            termios.tcsetattr(self._input, termios.TCSADRAIN, self._settings)

    def pressed(self, timeout: float | None) -> str | None:
        """The next key; '' if none comes within a time [s], None if none can come any more."""
        if not self._waiting and self._is_open:
            ready, _, _ = select.select([self._input], [], [], timeout)
            if ready:
                self._read()
        if not self._waiting:
            return "" if self._is_open else None
        key, self._waiting = self._waiting[0], self._waiting[1:]
        return key

    def answer(self) -> bool:
        """Whether the next key is a yes; at a terminal, keys pressed before don't count."""
        if self._settings is not None:
            termios.tcflush(self._input, termios.TCIFLUSH)
            self._waiting = ""
        key = ""
        while key == "":
            key = self.pressed(None) or ("" if self._is_open else "n")
        return key == "y"

    def _read(self) -> None:
        text = os.read(self._input, 4096).decode(errors="replace")
        self._is_open = bool(text)
        if self._settings is not None:
            self._waiting += text.lower()
            return
        *lines, self._line = (self._line + text).split("\n")
        if not text:
            lines, self._line = [self._line], ""
        self._waiting += "".join(line.strip()[:1].lower() for line in lines)
