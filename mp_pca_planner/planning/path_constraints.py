# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Constraints on every configuration of a motion, such as a glass that is kept upright.

A path constraint computes values of configurations that must not be negative, with derivatives by
the joint positions. The program keeps them at phases of the motion, and the check of the trajectory
at all of its points. To add one, write a class as :class:`Upright` and add its reader to
`CONSTRAINTS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..arrays import FloatArray, check_number, check_type, frozen_array, set_frozen
from ..exceptions import GoalError, unknown_name
from ..robot.model import Robot


class PathConstraint(Protocol):
    """A constraint on configurations; as text, it completes "the start does not keep …".

    Attributes
    ----------
    frame : str
        The frame (link) that it concerns: locked joints that move it make a difference.
    """

    @property
    def frame(self) -> str:
        """The frame."""

    def values(self, robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values that must not be negative, about 1 far from the bound, and their derivatives.

        Parameters
        ----------
        robot : Robot
            The model.
        q : array, shape (n_steps, n_joints)
            Configurations [rad or m].

        Returns
        -------
        values : array, shape (n_steps, n_values)
            The values.
        slopes : array, shape (n_steps, n_values, n_joints)
            Their derivatives by the positions.
        """


@dataclass(frozen=True)
class Upright:
    """An axis of a frame that leans at most by an angle from the vertical: a cone around it.

    Attributes
    ----------
    frame : str
        Name of the frame (link).
    angle : float
        Largest angle [rad], above 0 and at most 3.
    axis : tuple of float
        The axis in the frame.
    up : tuple of float
        The direction in the base frame that it is kept at.

    Raises
    ------
    GoalError
        If the angle is out of its range, or a direction is 0.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> options = mp.PlannerOptions(constraints=(mp.Upright("gripper", 0.26),))
    >>> print(options.constraints[0])
    'gripper' within 14.9° of upright
    """

    frame: str
    angle: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        check_number(self.angle, "the angle of an upright frame [rad]", GoalError, 1e-3, 3.0)
        check_type(self.frame, "the frame of a constraint", GoalError, str)
        for field in ("axis", "up"):
            direction = frozen_array(getattr(self, field), (3,), "a direction", GoalError)
            if not 1e-9 < np.linalg.norm(direction) < np.inf:
                raise GoalError("a direction must not be 0")
            set_frozen(self, **{field: tuple(direction.tolist())})

    def __str__(self) -> str:
        return f"'{self.frame}' within {np.rad2deg(self.angle):.3g}° of upright"

    def values(self, robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """1 where the axis is vertical, 0 on the cone."""
        axis, up = (np.array(x) / np.linalg.norm(x) for x in (self.axis, self.up))
        points = robot.attach_points([self.frame] * 2, np.array([np.zeros(3), axis]))
        places, jacobians = points.positions_and_jacobians(q)
        cosines = (places[:, 1] - places[:, 0]) @ up
        slopes = up @ (jacobians[:, 1] - jacobians[:, 0])
        room = 1.0 - np.cos(self.angle)
        return ((cosines - 1.0) / room + 1.0)[:, None], (slopes / room)[:, None]


def _upright(text: str) -> Upright:
    """Read ``FRAME,DEGREES``, and an axis of the frame after it."""
    frame, *numbers = (part.strip() for part in text.split(","))
    try:
        degrees, *axis = map(float, numbers)
    except ValueError:
        degrees, axis = float("nan"), []
    if not np.isfinite(degrees) or len(axis) not in (0, 3):
        raise GoalError(
            "expected upright:FRAME:DEGREES, or with the axis of the frame that is kept upright, "
            "z unless given, upright:FRAME:DEGREES:X:Y:Z"
        )
    check_number(degrees, "the angle of an upright frame, in degrees,", GoalError, 0.1, 170.0)
    x, y, z = axis or (0.0, 0.0, 1.0)
    return Upright(frame, float(np.deg2rad(degrees)), (x, y, z))


CONSTRAINTS: dict[str, Callable[[str], PathConstraint]] = {"upright": _upright}
"""Readers of path constraints, by name."""


def path_constraints(text: str, what: str, robot: Robot) -> tuple[PathConstraint, ...]:
    """Read constraints: ``NAME=VALUE`` or ``NAME:VALUE:…``, separated by semicolons.

    Parameters
    ----------
    text : str
        The text, such as ``upright=gripper,15`` or ``upright:gripper:15``; none if empty.
    what : str
        Name of the option in messages.
    robot : Robot
        The model.

    Raises
    ------
    GoalError
        If a name is unknown, or a value can't be read.
    RobotError
        If there is no such frame.
    """
    found = []
    for part in filter(None, (part.strip() for part in text.split(";"))):
        name, *words = (word.strip() for word in re.split("[=:]", part))
        value = ",".join(words)
        if name not in CONSTRAINTS:
            raise GoalError(f"{what}: {unknown_name('constraint', name, tuple(CONSTRAINTS))}")
        try:
            found.append(CONSTRAINTS[name](value))
        except GoalError as error:
            raise GoalError(f"{what} '{part}': {error}") from None
        found[-1].values(robot, np.zeros((0, robot.n_joints)))
    return tuple(found)
