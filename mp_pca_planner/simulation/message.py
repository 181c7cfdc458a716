# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages to a trajectory controller: ``trajectory_msgs/JointTrajectory`` without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..motion.trajectory import Trajectory

NANOSECONDS = 10**9


@dataclass(frozen=True)
class TrajectoryPoint:
    """One point of a message; every sequence holds one number per joint, or is empty.

    Attributes
    ----------
    time_from_start_ns : int
        Time since the start of the trajectory [ns].
    positions, velocities, accelerations, effort : sequence of float
        Joint positions [rad or m], their derivatives [/s, /s²], torques [N·m] or forces [N].
    """

    time_from_start_ns: int
    positions: Sequence[float] = ()
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    effort: Sequence[float] = ()


@dataclass(frozen=True)
class TrajectoryMessage:
    """A message as it is received, without any check.

    Attributes
    ----------
    joint_names : tuple of str
        Joints in the order of the numbers of every point.
    points : tuple of TrajectoryPoint
        The points.
    stamp_ns : int
        Time at which the trajectory starts [ns]; 0 means on arrival.
    """

    joint_names: tuple[str, ...]
    points: tuple[TrajectoryPoint, ...]
    stamp_ns: int = 0


def to_message(
    trajectory: Trajectory, stamp: float | None = None, *, last_point_only: bool = False
) -> TrajectoryMessage:
    """Message of a trajectory, with positions, velocities and accelerations on every point.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    stamp : float, optional
        Time at which it starts [s]; on arrival unless given.
    last_point_only : bool
        Whether only the last point is sent, to which the controller interpolates by itself.
    """
    rows = zip(
        (trajectory.times * NANOSECONDS).round().astype(int).tolist(),
        trajectory.positions.tolist(),
        trajectory.velocities.tolist(),
        trajectory.accelerations.tolist(),
        strict=True,
    )
    points = tuple(TrajectoryPoint(*row) for row in rows)
    return TrajectoryMessage(
        trajectory.joint_names,
        points[-1:] if last_point_only else points,
        0 if stamp is None else round(stamp * NANOSECONDS),
    )
