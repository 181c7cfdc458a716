# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Hold recorded velocities against the derivative of the positions; they are never used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import quote_names
from .byte_layout import NS_PER_S
from .joint_states import IntArray

WINDOW = 0.1
"""Velocities are compared over that time [s]: over one period noise would hide them."""

MAX_COMPARED = 20000
"""As many places in a recording say enough."""

MIN_COMPARED = 20
MIN_SPEED = 0.02
"""Slower than that [rad/s or m/s] a joint tells nothing about its velocity field."""

MAX_SPEED = 20.0
MAX_STRETCH = 2.0
"""Windows that are so much longer than the usual one hold a gap."""

MAX_SCALE_ERROR = 0.2
MIN_CORRELATION = 0.8


class VelocityCheck:
    """Compares recorded velocities with the positions, one part of a recording after the other.

    Parameters
    ----------
    joint_names :
        Names of the joints.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._names = tuple(joint_names)
        self._sums = [_Sums() for _ in joint_names]
        self._n_messages = 0
        self._n_missing = 0

    def add_without(self, n_messages: int) -> None:
        """Add messages that have no velocities."""
        self._n_messages += n_messages
        self._n_missing += n_messages

    def add(
        self,
        stamps: IntArray,
        positions: FloatArray,
        velocities: NDArray[np.float32],
        rows: IntArray,
        columns: Sequence[int],
    ) -> None:
        """Add messages.

        Parameters
        ----------
        stamps : array of int, shape (n_messages,)
            Stamps [ns].
        positions, velocities : array, shape (n_messages, n_columns)
            Joint positions [rad or m] and velocities as recorded [/s], NaN where there are none.
        rows :
            Messages to look at, their stamps increasing.
        columns :
            Where each of the joints is.
        """
        known = np.isfinite(velocities[:, columns]).all(axis=1)
        self._n_messages += known.size
        self._n_missing += known.size - int(np.count_nonzero(known))
        if rows.size < MIN_COMPARED:
            return
        for sums, column in zip(self._sums, columns, strict=True):
            sums.add(*_compared(stamps[rows], positions[rows, column], velocities[rows, column]))

    def notes(self) -> tuple[str, ...]:
        """Say in one sentence each what is wrong with the velocities."""
        if self._n_missing == self._n_messages:
            return (f"velocities are empty or NaN in all {self._n_messages} messages",)
        notes = []
        if self._n_missing:
            notes.append(
                f"velocities are empty or NaN in {self._n_missing} of {self._n_messages} messages"
            )
        verdicts: dict[str, list[str]] = {}
        for name, sums in zip(self._names, self._sums, strict=True):
            if verdict := sums.verdict():
                verdicts.setdefault(verdict, []).append(name)
        notes += [
            f"the velocities of {quote_names(names)} {verdict}: they are not used"
            for verdict, names in verdicts.items()
        ]
        return tuple(notes)


class _Sums:
    """Products of a joint's true and recorded velocities, summed up."""

    def __init__(self) -> None:
        self._n = 0
        self._true = self._told = self._both = 0.0

    def add(self, true: FloatArray, told: FloatArray) -> None:
        # A faster joint has wrapped or jumped.
        usable = np.isfinite(told) & (np.abs(true) > MIN_SPEED) & (np.abs(true) < MAX_SPEED)
        true, told = true[usable], told[usable]
        self._n += true.size
        self._true += float(np.sum(true * true))
        self._told += float(np.sum(told * told))
        self._both += float(np.sum(true * told))

    def verdict(self) -> str:
        if self._n < MIN_COMPARED:
            return ""
        if not self._told:
            return "are zero while the positions change"
        scale = self._both / self._true
        if abs(self._both) < MIN_CORRELATION * (self._true * self._told) ** 0.5:
            return "do not follow the positions"
        if abs(scale - 1.0) <= MAX_SCALE_ERROR:
            return ""
        if abs(scale + 1.0) <= MAX_SCALE_ERROR:
            return "have the opposite sign"
        return f"are {scale:.2g} times the derivative of the positions"


def _compared(
    stamps: IntArray, position: FloatArray, velocity: NDArray[np.float32]
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities of a joint over short windows: by its positions, and as recorded."""
    width = max(1, round(WINDOW * NS_PER_S / float(np.median(np.diff(stamps)))))
    starts = np.arange(0, stamps.size - width, max(1, stamps.size // MAX_COMPARED))
    times = (stamps[starts + width] - stamps[starts]) / NS_PER_S
    true = (position[starts + width] - position[starts]) / times
    # Weights of the trapezoidal rule, so that a window of one period is compared rightly, too.
    told = np.zeros(starts.size)
    for offset in range(width + 1):
        told += (0.5 if offset in (0, width) else 1.0) * velocity[starts + offset]
    usable = times < MAX_STRETCH * np.median(times) if times.size else np.zeros(0, dtype=bool)
    return true[usable], told[usable] / width
