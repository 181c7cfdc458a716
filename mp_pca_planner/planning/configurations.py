# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Configurations that reach a pose, as starting points of the optimisation of a motion to it.

Levenberg–Marquardt steps within the joint limits, from several configurations. With fewer equations
than joints, each start leads to a different solution nearby. The optimisation of the motion chooses
among these, and may move between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..lazy import LazyModule
from ..motion.goal import Pose
from ..robot.limits import JointLimits
from ..robot.model import Robot

lapack = LazyModule("scipy.linalg.lapack")

POSE_TOLERANCE = 1e-6
"""Largest error of a reached pose [m or rad]."""

# Steps from a start at most, and the largest error at which they end [m or rad].
_MAX_STEPS, _REACHED = 30, 1e-8
# Levenberg–Marquardt damping of the first step, and at which the search ends.
_FIRST_DAMPING, _MAX_DAMPING = 1e-3, 1e8
# Further starts, spread over the limits, if the known ones lead to no solution.
_N_RANDOM = 40
# Configurations nearer to each other than this count as one [rad or m].
_DISTINCT = 0.05


def starts_near(robot: Robot, pose: Pose, known: FloatArray, n: int) -> list[FloatArray]:
    """The known configurations whose frame is nearest to a pose, as starts of the search.

    Parameters
    ----------
    robot : Robot
        The model.
    pose : Pose
        The pose to reach.
    known : array, shape (n_configurations, n_joints)
        Ends of demonstrations, for example.
    n : int
        Number of them.

    Raises
    ------
    RobotError
        If there is no such frame.
    """
    places = robot.frame_positions(known, [pose.frame])[:, 0]
    distances = np.linalg.norm(places - pose.position, axis=1)
    return list(known[distances.argsort(kind="stable")[:n]])


def configurations_at(
    robot: Robot,
    limits: JointLimits,
    pose: Pose,
    starts: Iterable[FloatArray],
    is_enough: Callable[[], bool] = bool,
) -> list[FloatArray]:
    """Different configurations within the limits that reach a pose, in the order of the starts.

    Parameters
    ----------
    robot : Robot
        The model.
    limits : JointLimits
        Limits of its joints.
    pose : Pose
        The pose to reach.
    starts : iterable of array, shape (n_joints,)
        Configurations to search from.
    is_enough : callable
        Returns whether one configuration is enough, because time runs out; never unless given.

    Raises
    ------
    GoalError
        If none is found; the message states the least distance.
    RobotError
        If there is no such frame.
    """
    found: list[FloatArray] = []
    nearest = np.array([np.inf])
    for group in (starts, _spread(limits, _N_RANDOM)):
        for start in group:
            q, error = nearest_configuration(robot, limits, pose, start)
            if np.abs(error).max() > POSE_TOLERANCE:
                nearest = min(nearest, error, key=lambda e: float(np.linalg.norm(e)))
            elif all(np.abs(q - other).max() > _DISTINCT for other in found):
                found.append(q)
            if found and is_enough():
                break
        if found:
            return found
    turned = f" and {np.linalg.norm(nearest[3:]):.3g} rad" if nearest.size > 3 else ""
    raise GoalError(
        f"no configuration within the joint limits brings '{pose.frame}' to the pose; the "
        f"nearest one found is {np.linalg.norm(nearest[:3]):.3g} m{turned} away"
    )


def nearest_configuration(
    robot: Robot,
    limits: JointLimits,
    pose: Pose,
    start: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The configuration nearest to a pose, by descent from a start.

    Returns
    -------
    q : array, shape (n_joints,)
        The configuration, within the limits.
    error : array, shape (3,) or (6,)
        See :meth:`.Robot.pose_error`.
    """
    q, damping = np.clip(start, limits.lower, limits.upper), _FIRST_DAMPING
    eye = np.eye(q.size)
    error, jacobian = robot.pose_error(pose.frame, q, pose.position, pose.orientation)
    for _ in range(_MAX_STEPS):
        if np.abs(error).max() <= _REACHED or damping > _MAX_DAMPING:
            break
        downhill = -jacobian.T @ error
        # Joints that are blocked by a limit are held there.
        stopped = np.where(downhill < 0.0, q <= limits.lower, q >= limits.upper)
        free = np.where(stopped, 0.0, jacobian)
        _, step, _ = lapack.dposv(free.T @ free + damping * eye, -free.T @ error)
        moved = np.clip(q + step, limits.lower, limits.upper)
        there, slope = robot.pose_error(pose.frame, moved, pose.position, pose.orientation)
        if there @ there < error @ error:
            q, error, jacobian, damping = moved, there, slope, 0.1 * damping
        else:
            damping *= 10.0
    return q, error


def _spread(limits: JointLimits, n: int) -> Iterable[FloatArray]:
    """Configurations spread over the joint ranges; the same ones in every call."""
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    random = np.random.default_rng(0)
    return (random.uniform(low, high) for _ in range(n))
