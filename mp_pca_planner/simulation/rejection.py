# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Validation of messages, as ``joint_trajectory_controller`` (Jazzy) does it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..exceptions import quote_names, unknown_name
from .message import NANOSECONDS, TrajectoryMessage

_STANDSTILL = float(np.finfo(np.float32).eps)


def rejection(
    message: TrajectoryMessage,
    joint_names: Sequence[str],
    now_ns: int,
    *,
    allow_partial: bool,
    allow_moving_end: bool,
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
    allow_partial : bool
        Whether joints may be missing.
    allow_moving_end : bool
        Whether the last point may have a velocity.
    """
    return (
        _wrong_joints(message.joint_names, joint_names, allow_partial)
        or ("the trajectory has no points" if not message.points else None)
        or (None if allow_moving_end else _moving_end(message))
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
    # The original accepts these, and leaves other joints with the numbers of an older message.
    return f"{quote_names(repeated)} given more than once" if repeated else None


def _moving_end(message: TrajectoryMessage) -> str | None:
    for name, v in zip(message.joint_names, message.points[-1].velocities, strict=False):
        if abs(v) > _STANDSTILL:
            return f"the last point moves joint '{name}' at {v:g} rad/s or m/s, expected 0"
    return None


def _ended(message: TrajectoryMessage, now_ns: int) -> str | None:
    end = message.stamp_ns + message.points[-1].time_from_start_ns
    if message.stamp_ns != 0 and end < now_ns:
        late = (now_ns - end) / NANOSECONDS
        return f"the trajectory ended {late:g} s before it arrived"
    return None


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
