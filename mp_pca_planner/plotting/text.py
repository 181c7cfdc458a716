# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers as text: units (degrees, or metres for prismatic joints), tables, shares of variance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..primitives.primitive import MovementPrimitive


class Unit(NamedTuple):
    """A unit of positions, with that of speeds and the label of torques that belong to it.

    Attributes
    ----------
    name, speed : str
        Names of the units of positions and speeds.
    torque : str
        Label of the axis of torques or forces, with their unit.
    factor : float
        Value of one radian or metre in this unit.
    decimals : int
        Number of decimals shown.
    """

    name: str
    speed: str
    torque: str
    factor: float = 1.0
    decimals: int = 4

    def number(self, value: float) -> str:
        """A value [rad or m] as text in this unit."""
        return f"{self.factor * value:.{self.decimals}f}"

    def text(self, value: float) -> str:
        """A value [rad or m] as a round number in this unit."""
        return f"{self.factor * value:.{self.decimals - 2}f}"


DEGREES = Unit("deg", "deg/s", "torque [N·m]", float(np.rad2deg(1.0)), 2)
METRES = Unit("m", "m/s", "force [N]")
MIXED = Unit("rad or m", "rad/s or m/s", "torque or force [N·m or N]")


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


Table = tuple[list[str], list[list[str]]]
"""A header and rows of text."""


def percent(share: float) -> str:
    """A share as a percentage with two decimals, as in [P] Table 2."""
    return f"{100.0 * share:.2f}"


def variance_table(shares: Mapping[str, Sequence[float]], n_components: int | None = None) -> Table:
    """Shares of the variance by component, and their sums [%].

    Parameters
    ----------
    shares :
        By the names of the rows.
    n_components :
        Number of columns; by default as many as the longest row has.
    """
    n = max(map(len, shares.values()), default=0) if n_components is None else n_components
    rows = [[name, *percents(values, n), percent(sum(values))] for name, values in shares.items()]
    return ["", *(f"PC{k + 1}" for k in range(n)), "sum"], rows


def percents(values: Sequence[float], n: int) -> list[str]:
    """The first n shares [%], with empty texts where there are fewer."""
    return [percent(values[k]) if k < len(values) else "" for k in range(n)]
