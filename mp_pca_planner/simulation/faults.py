# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Faults of a simulated robot, set on demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..exceptions import SimulationError, unknown_name

# Ranges of the numbers.
RANGES = {
    "speed_scaling": (0.0, 1.0),
    "delay": (0.0, 1.0),
    "jitter": (0.0, 1.0),
    "drop": (0.0, 1.0),
    "payload": (0.0, 1000.0),
    "noise": (0.0, 0.1),
}


@dataclass
class Faults:
    """Faults of a simulated robot; every attribute may be set at any time.

    Attributes
    ----------
    speed_scaling : float
        Speed of the trajectory's clock, 0 to 1. The robot follows a change smoothly, in about
        0.4 s, as real robots do.
    held : bool
        Whether the robot is held: a speed scaling of 0 until it is released.
    silent : bool
        Whether no joint states are published.
    delay, jitter : float
        Transport time of a message, and its largest random addition [s].
    active : bool
        Whether the controller is active; it rejects messages unless it is.
    drop : float
        Probability that a message is lost.
    payload : float
        Mass at the end effector that gravity compensation does not include [kg].
    noise : float
        Standard deviation of measured positions [rad or m]; that of velocities is 100/s times it.

    Raises
    ------
    SimulationError
        If a name is unknown or a value out of range.
    """

    speed_scaling: float = 1.0
    held: bool = False
    silent: bool = False
    delay: float = 0.0
    jitter: float = 0.0
    active: bool = True
    drop: float = 0.0
    payload: float = 0.0
    noise: float = 0.0

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.__dataclass_fields__:
            raise SimulationError(unknown_name("fault", name, self.__dataclass_fields__))
        if name in RANGES:
            low, high = RANGES[name]
            if isinstance(value, str) or not low <= value <= high:
                raise SimulationError(
                    f"{name} is {value}, expected a number from {low:g} to {high:g}"
                )
        elif not isinstance(value, bool):
            raise SimulationError(f"{name} is {value!r}, expected true or false")
        object.__setattr__(self, name, value)
