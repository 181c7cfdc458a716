# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Units in which positions of joints are shown: degrees, or millimetres of prismatic joints."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from ..primitives.primitive import MovementPrimitive


class Unit(NamedTuple):
    """A unit of positions, and what a radian or a metre is in it.

    Attributes
    ----------
    name, speed : str
        Of positions and of speeds.
    factor : float
        How many of it are a radian or a metre.
    decimals : int
        With how many values are shown.
    """

    name: str
    speed: str
    factor: float
    decimals: int

    def number(self, value: float) -> str:
        """A value [rad or m] as a number of these."""
        return f"{self.factor * value:.{self.decimals}f}"


_DEGREES = Unit("deg", "deg/s", float(np.rad2deg(1.0)), 2)
_MILLIMETRES = Unit("mm", "mm/s", 1e3, 2)
# For one value of joints of both kinds.
_EITHER = Unit("rad or m", "rad/s or m/s", 1.0, 4)


def unit_of(joint_names: Collection[str], prismatic: Collection[str]) -> Unit:
    """Find the unit for values that belong to all of some joints.

    Parameters
    ----------
    joint_names : collection of str
        The joints.
    prismatic : collection of str
        Those that are measured in metres, among others.
    """
    n_prismatic = sum(name in prismatic for name in joint_names)
    if n_prismatic == 0:
        return _DEGREES
    return _MILLIMETRES if n_prismatic == len(joint_names) else _EITHER


def prismatic_joints(primitive: MovementPrimitive) -> tuple[str, ...]:
    """Joints that are prismatic, as far as a robot description told when it was built."""
    return tuple(primitive.metadata.get("prismatic_joints", ()))
