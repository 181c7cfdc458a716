# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Values of a serialised message, read one after the other."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..recordings.byte_layout import ENCAPSULATION


class CdrReader:
    """Reads one value after the other from a message in CDR.

    Whatever is malformed raises a `ValueError`.

    Parameters
    ----------
    content : bytes
        The message.
    """

    def __init__(self, content: bytes) -> None:
        if len(content) < ENCAPSULATION:
            raise ValueError(f"it has {len(content)} bytes, at least {ENCAPSULATION} are needed")
        self._content, self._order = content, "<" if content[1] & 1 else ">"
        self._place = ENCAPSULATION

    def count(self, least_bytes: int) -> int:
        """The length of a sequence, whose items have this many bytes at least."""
        (n,) = self.numbers("I")
        if n * least_bytes > len(self._content) - self._place + least_bytes:
            raise ValueError(f"it is too short for {n} items")
        return int(n)

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Numbers of the same size, by their characters in `struct`."""
        size = struct.calcsize(f"={kinds[0]}")
        self._align(size)
        try:
            found = struct.unpack_from(self._order + kinds, self._content, self._place)
        except struct.error:
            raise ValueError(f"it ends within its {len(self._content)} bytes") from None
        self._place += size * len(kinds)
        return found

    def text(self) -> str:
        """A string."""
        n = self.count(1)
        begin, self._place = self._place, self._place + n
        return self._content[begin : self._place].rstrip(b"\0").decode()

    def array(self, kind: str, n: int) -> FloatArray:
        """Numbers of a type of NumPy."""
        if not n:
            return np.zeros(0)
        size = int(kind[1])
        self._align(size)
        numbers = np.frombuffer(self._content, self._order + kind, n, self._place)
        self._place += size * n
        return numbers.astype(float) if kind == "f8" else numbers

    def _align(self, size: int) -> None:
        self._place += (ENCAPSULATION - self._place) % size
