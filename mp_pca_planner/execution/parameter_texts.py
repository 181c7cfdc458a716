# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters whose texts hold several values."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..exceptions import PlannerError


class ParameterError(PlannerError):
    """A parameter that is unknown or has a value that can't be used."""


def locked_positions(text: str) -> dict[str, float]:
    """Read the parameter ``locked_joints``: positions by joint [rad or m].

    Raises
    ------
    ParameterError
        If it has another form.
    """
    found: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (piece.strip() for piece in part.partition("="))
        value = _numbers(number)
        if not name or name in found or len(value) != 1:
            raise ParameterError(
                f"parameter 'locked_joints': '{part:.80}' is not accepted; expected name=value,… "
                "with each joint once and finite numbers"
            )
        found[name] = value[0]
    return found


def fixed_frames(texts: Sequence[str]) -> dict[str, list[float]]:
    """Read the parameter ``fixed_frames``: poses by frame, each x, y, z and a unit quaternion.

    Raises
    ------
    ParameterError
        If a text has another form.
    """
    found: dict[str, list[float]] = {}
    for text in filter(None, texts):
        name, _, numbers = (piece.strip() for piece in text.partition(":"))
        values = _numbers(numbers)
        values += [0.0, 0.0, 0.0, 1.0] * (len(values) == 3)
        length = math.hypot(*values[3:])
        if not name or name in found or len(values) != 7 or abs(length - 1.0) > 1e-3:
            raise ParameterError(
                f"parameter 'fixed_frames': '{text:.80}' is not accepted; expected each frame once "
                "as FRAME: X Y Z, or FRAME: X Y Z QX QY QZ QW with a quaternion of length 1"
            )
        found[name] = [*values[:3], *(value / length for value in values[3:])]
    return found


def _numbers(text: str) -> list[float]:
    """The finite numbers of a text, separated by spaces or commas; none if one is not."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []
