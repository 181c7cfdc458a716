# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Types of option values, for argparse: numbers within bounds, names, durations."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError
from collections.abc import Callable


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Type of numbers from `low` to `high`."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            expected = f"a number from {low:g} to {high:g} {unit}".rstrip()
            raise ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of whole numbers from `low` to `high`."""

    def parse(text: str) -> int:
        # Longer numbers exceed every bound and are slow to convert.
        if not (text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            raise ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


seconds = number(1e-6, 1e6, "s")
"""Type of times [s]."""

count = whole(1, 1_000_000)
"""Type of counts."""

jobs = whole(1, 1024)
"""Type of numbers of processes."""

seed = whole(0, 2**63 - 1)
"""Type of seeds of random numbers."""


def duration(text: str) -> str | float:
    """Read a duration [s], or one of the words for a duration that the planner chooses."""
    if text in ("shortest", "free"):
        return text
    try:
        return number(1e-3, 600.0, "s")(text)
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"{error}, 'shortest' or 'free'") from None


def name_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


class Stop(str):
    """A value of ``--stop`` among those of ``--via``."""
