# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions as trajectories, compared with limits and checked for collisions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...motion.collision import Collision
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck, check_limits
from ..context import Context
from ..motion import Motion
from ..path_constraints import PathConstraint

# Violation of a path constraint that counts as rounding.
_ROUNDING = 1e-6


class Examined(NamedTuple):
    """A motion and the validator's verdict on it.

    Attributes
    ----------
    trajectory : Trajectory
        Its points.
    check : LimitCheck
        Comparison with the limits.
    collisions : tuple of Collision
        Collisions, not known if limits are violated.
    strayed : tuple of (PathConstraint, float)
        Path constraints that are violated, and how far.
    """

    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    strayed: tuple[tuple[PathConstraint, float], ...] = ()


def examine(context: Context, motions: Sequence[Motion], *, collides: bool = True) -> Examined:
    """Sample a motion of several segments, and check it.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    motions : sequence of Motion
        The segments.
    collides : bool
        Whether collisions are checked. They are not if limits are violated: then another motion
        will be checked.

    Raises
    ------
    GoalError
        If the motion would take too long or too short; nothing is sampled then.
    """
    ends = np.cumsum([motion.duration for motion in motions])
    context.check_duration("the motion would take", float(ends[-1]))
    times, states = [], []
    for i, (motion, end) in enumerate(zip(motions, ends, strict=True)):
        own, values = motion.sample(context.options.sample_period)
        times.append(end - motion.duration + own[min(i, 1) :])
        states.append(values[:, min(i, 1) :])
    q, v, a = np.concatenate(states, axis=1)
    trajectory = Trajectory(context.robot.joint_names, np.concatenate(times), q, v, a)
    check = check_limits(trajectory, context.robot, context.limits)
    collisions: tuple[Collision, ...] = ()
    if collides and context.collision is not None and not check.violations:
        collisions = context.collision.collisions(trajectory, precisely=False)
    strayed = []
    for constraint in context.options.constraints:
        values, _ = constraint.values(context.robot, q)
        if values.min() < -_ROUNDING:
            strayed.append((constraint, -float(values.min())))
    return Examined(trajectory, check, collisions, tuple(strayed))


def collides(context: Context, trajectory: Trajectory) -> bool:
    """Whether bodies collide, if that is checked."""
    model = context.collision
    return model is not None and bool(model.collisions(trajectory, precisely=False))


def searches_paths(context: Context) -> bool:
    """Whether there are pairs of bodies that paths lead around."""
    return context.collision is not None and bool(context.collision.pairs)
