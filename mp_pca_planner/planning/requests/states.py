# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States in requests: completion, and rejection if no motion can begin or end there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, quote_names, unknown_name
from ...motion.goal import JointState
from ...motion.validation import nearest_start
from ...robot.limits import JointLimits
from ...robot.model import Robot

# Largest positions, velocities and accelerations where there is no limit [SI].
_NO_ROBOT = 1e6
_QUANTITIES = ("position", "velocity", "acceleration")
_UNITS = ("radians (or metres)", "rad/s (or m/s)", "rad/s² (or m/s²)")


def in_order(state: JointState, names: Sequence[str]) -> JointState:
    """The present state of the named joints alone, in their order.

    Raises
    ------
    GoalError
        If the state lacks a joint.
    """
    if state.joint_names == names:
        return state
    missing = [name for name in names if name not in state.joint_names]
    if missing:
        raise GoalError(
            f"the present state lacks {quote_names(missing)}; it has "
            f"{quote_names(state.joint_names)}"
        )
    index = [state.joint_names.index(name) for name in names]
    return JointState(
        names, state.positions[index], state.velocities[index], state.accelerations[index]
    )


def completed(state: JointState, before: JointState, robot: Robot, what: str) -> JointState:
    """The goal state of all joints; joints that are not named stay at rest.

    Parameters
    ----------
    state : JointState
        The requested state.
    before : JointState
        The state before, of all joints in the robot's order.
    robot : Robot
        The model; its continuous joints turn by less than half a turn.
    what : str
        Name of the state in messages.

    Raises
    ------
    GoalError
        If it names an unknown joint, or a position that no robot has.
    """
    names = robot.joint_names
    if state.joint_names == names and not robot.continuous.any():
        _check_plausible(state.positions, names, what)
        return state
    for name in state.joint_names:
        if name not in names:
            raise GoalError(f"the {what} can't be used: {unknown_name('joint', name, names)}")
    q, v, a = before.positions.copy(), np.zeros(len(names)), np.zeros(len(names))
    index = [names.index(name) for name in state.joint_names]
    q[index], v[index], a[index] = state.positions, state.velocities, state.accelerations
    # Checked before the reduction of a continuous joint's angle, which would lose all digits.
    _check_plausible(q, names, what)
    return JointState(names, unwrapped(q, before, robot), v, a)


def _check_plausible(q: FloatArray, names: Sequence[str], what: str) -> None:
    absurd = np.abs(q) > _NO_ROBOT
    if absurd.any():
        j = int(absurd.argmax())
        raise GoalError(
            f"the {what} position of joint '{names[j]}' is {q[j]:.6g}, but no robot goes "
            f"beyond ±{_NO_ROBOT:g}"
        )


def unwrapped(q: FloatArray, before: JointState, robot: Robot) -> FloatArray:
    """Positions to which continuous joints turn by less than half a turn."""
    turns = np.round((before.positions - q) / (2.0 * np.pi))
    return np.asarray(q + np.where(robot.continuous, 2.0 * np.pi * turns, 0.0))


def check_start(start: JointState, limits: JointLimits) -> None:
    """Reject a start that violates a limit, except positions within `START_TOLERANCE` of it.

    Raises
    ------
    GoalError
        If it violates a limit.
    """
    inside = nearest_start(start.positions, limits)
    _check("present", start.joint_names, (inside, start.velocities, start.accelerations), limits)


def check_within_limits(what: str, state: JointState, limits: JointLimits) -> None:
    """Reject an end state that violates a limit.

    Raises
    ------
    GoalError
        If it violates a limit.
    """
    _check(what, state.joint_names, state.values, limits)


def _check(
    what: str, names: Sequence[str], state: tuple[FloatArray, ...], limits: JointLimits
) -> None:
    values, (low, high) = np.array(state), _bounds(limits)
    inside = (low <= values) & (values <= high)
    if inside.all():
        return
    k, j = np.argwhere(~inside)[0].tolist()
    raise GoalError(
        f"the {what} {_QUANTITIES[k]} of joint '{names[j]}' is {values[k, j]:.9g}, "
        f"outside its limits [{low[k, j]:.9g}, {high[k, j]:.9g}] in {_UNITS[k]}"
    )


@lru_cache(maxsize=8)
def _bounds(limits: JointLimits) -> tuple[FloatArray, FloatArray]:
    """Least and largest positions, velocities and accelerations, shape (3, n_joints)."""
    rates = limits.velocity, limits.acceleration
    low = np.maximum([limits.lower, *(-bound for bound in rates)], -_NO_ROBOT)
    return low, np.minimum([limits.upper, *rates], _NO_ROBOT)
