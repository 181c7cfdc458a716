# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller, and its validation of messages.

Both are those of ``joint_trajectory_controller`` (Jazzy).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..exceptions import SimulationError, quote_names, unknown_name
from .message import NANOSECONDS, TrajectoryMessage

_STANDSTILL = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class ControllerOptions:
    """Parameters of the controller; names and defaults are those of the original.

    Attributes
    ----------
    allow_nonzero_velocity_at_trajectory_end : bool
        Whether the last point may have a velocity.
    allow_partial_joints_goal : bool
        Whether joints may be missing; they hold their commanded positions.
    state_tolerance : float
        Largest deviation of a joint while moving [rad or m]; 0 allows any. Where it is exceeded,
        the measured position is held.

    Raises
    ------
    SimulationError
        If the tolerance is negative or not finite.
    """

    allow_nonzero_velocity_at_trajectory_end: bool = False
    allow_partial_joints_goal: bool = False
    state_tolerance: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.state_tolerance < math.inf:
            raise SimulationError(
                f"state_tolerance is {self.state_tolerance}, expected a finite number from 0 on"
            )


def rejection(
    message: TrajectoryMessage, joint_names: Sequence[str], now_ns: int, options: ControllerOptions
) -> str | None:
    """Why a message is rejected, as a sentence; None if it is accepted.

    Numbers that are not finite are accepted, as by the original.

    Parameters
    ----------
    message : TrajectoryMessage
        The message.
    joint_names : sequence of str
        Joints of the controller.
    now_ns : int
        The present time [ns].
    options : ControllerOptions
        Parameters of the controller.
    """
    return (
        _wrong_joints(message.joint_names, joint_names, options.allow_partial_joints_goal)
        or ("the trajectory has no points" if not message.points else None)
        or (None if options.allow_nonzero_velocity_at_trajectory_end else _moving_end(message))
        or _ended(message, now_ns)
        or _wrong_times(message)
        or _wrong_numbers(message)
    )


def _wrong_joints(given: Sequence[str], expected: Sequence[str], allow_partial: bool) -> str | None:
    if not given or (len(given) != len(expected) and not allow_partial):
        return f"the trajectory has {len(given)} joints, the controller {len(expected)}"
    for name in given:
        if name not in expected:
            return unknown_name("joint of the controller", name, expected)
    repeated = sorted({name for name in given if list(given).count(name) > 1})
    # The original accepts these, but keeps the numbers of an older message for the other joints.
    return f"{quote_names(repeated)} given more than once" if repeated else None


def _moving_end(message: TrajectoryMessage) -> str | None:
    for name, v in zip(message.joint_names, message.points[-1].velocities, strict=False):
        if abs(v) > _STANDSTILL:
            return f"the last point moves joint '{name}' at {v:g} rad/s or m/s, expected 0"
    return None


def _ended(message: TrajectoryMessage, now_ns: int) -> str | None:
    late = now_ns - message.stamp_ns - message.points[-1].time_from_start_ns
    if message.stamp_ns == 0 or late <= 0:
        return None
    return f"the trajectory ended {late / NANOSECONDS:g} s before it arrived"


def _wrong_times(message: TrajectoryMessage) -> str | None:
    times = [point.time_from_start_ns for point in message.points]
    for k, (before, after) in enumerate(pairwise(times)):
        if after <= before:
            return (
                f"the times of points {k} and {k + 1} are {before} and {after} ns, not increasing"
            )
    return None


def _wrong_numbers(message: TrajectoryMessage) -> str | None:
    n = len(message.joint_names)
    for k, point in enumerate(message.points):
        if len(point.positions) != n:
            return f"point {k} has {len(point.positions)} positions for {n} joints"
        for field in ("velocities", "accelerations"):
            length = len(getattr(point, field))
            if length not in (0, n):
                return f"point {k} has {length} {field} for {n} joints"
        if len(point.effort) > 0:
            return f"point {k} has efforts, but the controller has no effort interface"
    return None
