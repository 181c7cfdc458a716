# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Units of displayed values: degrees, or metres for prismatic joints."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from ..primitives.primitive import MovementPrimitive


class Unit(NamedTuple):
    """A unit of positions, with those of speeds and efforts that belong to it.

    Attributes
    ----------
    name, speed, effort : str
        Names of the units of positions, speeds and efforts.
    factor : float
        Value of one radian or metre in this unit.
    decimals : int
        Number of decimals shown.
    """

    name: str
    speed: str
    effort: str
    factor: float = 1.0
    decimals: int = 4

    def number(self, value: float) -> str:
        """A value [rad or m] as text in this unit."""
        return f"{self.factor * value:.{self.decimals}f}"

    def text(self, value: float) -> str:
        """A value [rad or m] as a round number in this unit."""
        return f"{self.factor * value:.{self.decimals - 2}f}"


DEGREES = Unit("deg", "deg/s", "N·m", float(np.rad2deg(1.0)), 2)
METRES = Unit("m", "m/s", "N")
MIXED = Unit("rad or m", "rad/s or m/s", "N·m or N")


def unit_of(joint_names: Collection[str], prismatic: Collection[str]) -> Unit:
    """Return the unit for values shared by several joints.

    Parameters
    ----------
    joint_names : collection of str
        The joints.
    prismatic : collection of str
        All joints that are measured in metres.
    """
    n_prismatic = sum(name in prismatic for name in joint_names)
    if n_prismatic == 0:
        return DEGREES
    return METRES if n_prismatic == len(joint_names) else MIXED


def prismatic_joints(primitive: MovementPrimitive) -> tuple[str, ...]:
    """Prismatic joints, if the primitive was built with a robot description."""
    return tuple(primitive.metadata.get("prismatic_joints", ()))


def primitive_unit(primitive: MovementPrimitive) -> Unit:
    """The unit for values shared by all joints of a primitive."""
    return unit_of(primitive.joint_names, prismatic_joints(primitive))
