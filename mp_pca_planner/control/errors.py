# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Assumed errors of a model and of a start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import ControlError
from ..robot.model import Robot


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Largest errors of a model and of a start.

    Attributes
    ----------
    inertia : float
        Relative error of the mass and of each principal moment of inertia of each link, all
        independent of each other.
    payload : float
        Largest unknown mass at the end effector [kg].
    frame : str or None
        Link of the end effector; None means the last one.
    position : float
        Largest error of each joint at the start [rad or m].
    velocity : float
        The same of velocities [/s].

    Raises
    ------
    ControlError
        If one is negative, or inertias may vanish.
    """

    inertia: float = 0.05
    payload: float = 0.0
    frame: str | None = None
    position: float = 0.001
    velocity: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.inertia < 1.0:
            raise ControlError(f"an error of inertias must be 0 to less than 1, got {self.inertia}")
        for name in ("payload", "position", "velocity"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ControlError(f"the error of {name} must be a number ≥ 0, got {value}")

    def sample(
        self, robot: Robot, rng: np.random.Generator, *, extreme: bool = False
    ) -> tuple[Robot, FloatArray, FloatArray]:
        """One robot within the errors and its start errors: (robot, position, velocity).

        Parameters
        ----------
        robot : Robot
            The nominal one.
        rng : Generator
            Source of random numbers.
        extreme : bool
            Whether every error has its largest magnitude.
        """

        def draw(size: int | tuple[int, ...]) -> FloatArray:
            values = rng.uniform(-1.0, 1.0, size)
            return np.where(values < 0.0, -1.0, 1.0) if extreme else values

        n, shape = robot.n_joints, robot.link_inertias.parts.shape[:2]
        payload = self.payload * 0.5 * (1.0 + float(draw(1)[0]))
        true = robot.with_link_inertias(1.0 + self.inertia * draw(shape))
        true = true.with_payload(payload, self.frame)
        return true, self.position * draw(n), self.velocity * draw(n)
