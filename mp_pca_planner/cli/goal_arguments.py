# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, vias and start states from the text of command-line arguments."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import GoalError, unknown_name
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from .main import Stop, seconds

if TYPE_CHECKING:
    from ..robot.model import Robot


def number_list(text: str, what: str) -> list[float]:
    """Read numbers separated by spaces or commas, also in square brackets.

    Raises
    ------
    GoalError
        If there is none, or one is no finite number.
    """
    parts = _without_brackets(text).replace(",", " ").split()
    if not parts:
        raise GoalError(f"{what} '{text}' must be numbers, separated by spaces")
    return [_finite(part, f"a number of {what}") for part in parts]


def joint_values(
    text: str,
    names: Sequence[str],
    what: str,
    kind: str = "joint",
    angles: Collection[str] = (),
) -> dict[str, float]:
    """Read ``name=value,…``, or one value per joint in joint order, also in square brackets.

    Parameters
    ----------
    text : str
        The values.
    names : sequence of str
        The joints.
    what, kind : str
        What is read, and of what, for messages.
    angles : collection of str
        Joints whose values are in degrees; they become radians.

    Raises
    ------
    GoalError
        If a name is unknown or repeated, a value is no finite number, or the number of
        values in a list is not that of the joints.
    """
    separated = _without_brackets(text).replace(" ", ",").split(",")
    parts = [part.strip() for part in separated if part.strip()]
    named = ["=" in part for part in parts]
    if not parts or any(named) != all(named):
        raise GoalError(
            f"{what} '{text}' must be name=value,… or {len(names)} values in {kind} order"
        )
    if not named[0]:
        if len(parts) != len(names):
            raise GoalError(
                f"{what} has {len(parts)} values, but there are {len(names)} {kind}s: "
                f"{', '.join(names)}"
            )
        parts = [f"{name}={part}" for name, part in zip(names, parts, strict=True)]
    values: dict[str, float] = {}
    for part in parts:
        name, _, number = (piece.strip() for piece in part.partition("="))
        if name not in names:
            raise GoalError(f"{what}: {unknown_name(kind, name, names)}")
        if name in values:
            raise GoalError(f"{what}: {kind} '{name}' is given more than once")
        value = _finite(number, f"{what}: value of {kind} '{name}'")
        values[name] = math.radians(value) if name in angles else value
    return values


def _without_brackets(text: str) -> str:
    """The text of a list such as ``[0.1, 0.2]`` without its brackets."""
    inner = text.strip()
    return inner[1:-1] if inner[:1] == "[" and inner[-1:] == "]" else text


def angles_in_degrees(arguments: argparse.Namespace, robot: Robot) -> tuple[str, ...]:
    """The joints whose values are in degrees: with ``--degrees``, all that turn."""
    turning = (name for name in robot.joint_names if name not in robot.prismatic_joints)
    return tuple(turning) if arguments.degrees else ()


def _finite(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise GoalError(f"{what} is '{text}', not a number") from None
    if not np.isfinite(value):
        raise GoalError(f"{what} is '{text}', but only finite numbers are accepted")
    return value


def locked_at_start(arguments: argparse.Namespace, robot: Robot, whole: Robot) -> dict[str, float]:
    """Positions that ``--start`` names for joints that the primitives do not move.

    Parameters
    ----------
    arguments : Namespace
        The arguments.
    robot, whole : Robot
        The robot of the joints that move, and that of all joints.

    Raises
    ------
    GoalError
        If the text can't be read.
    """
    names, angles = _names_at_start(arguments, robot), angles_in_degrees(arguments, whole)
    q = joint_values(arguments.start, names, "--start", angles=angles)
    return {name: value for name, value in q.items() if name not in robot.joint_names}


def _names_at_start(arguments: argparse.Namespace, robot: Robot) -> Sequence[str]:
    """The joints that ``--start`` may name; a list of values has those that move."""
    return robot.movable_joints if "=" in arguments.start else robot.described_joints


def start_state(arguments: argparse.Namespace, robot: Robot) -> JointState:
    """The start of a motion, at rest.

    Raises
    ------
    GoalError
        If the text can't be read, or positions of joints are missing.
    """
    names, angles = _names_at_start(arguments, robot), angles_in_degrees(arguments, robot)
    q = joint_values(arguments.start, names, "--start", angles=angles)
    missing = [name for name in robot.joint_names if name not in q]
    if missing:
        raise GoalError(f"--start lacks a position for {', '.join(missing)}")
    return JointState(robot.joint_names, [q[name] for name in robot.joint_names])


def planned_goal(
    arguments: argparse.Namespace, robot: Robot
) -> JointGoal | PoseGoal | SequenceGoal:
    """The goal of `plan`; with ``--via``, a sequence.

    Raises
    ------
    GoalError
        If the text can't be read, or the duration of a sequence is none that it can have.
    """
    read = partial(target, robot, angles_in_degrees(arguments, robot))
    duration = arguments.duration if isinstance(arguments.duration, float) else None
    if arguments.goal is not None:
        end = read(arguments.goal, "--goal")
    else:
        end = _pose(_frame(arguments, robot), arguments.goal_pose, "--goal-pose")
    if arguments.via and isinstance(arguments.duration, str):
        raise GoalError(
            f"--duration {arguments.duration} can't be given with --via: sequences are timed like "
            "the demonstrations, or by a number"
        )
    if arguments.via:
        vias = [_via(text, read) for text in arguments.via]
        times = (*(None for _ in vias), duration)
        return SequenceGoal((*vias, end), times, arguments.primitive)
    if isinstance(end, Pose):
        return PoseGoal(end, duration, arguments.primitive)
    return JointGoal(end, duration, arguments.primitive)


def _via(text: str, read: Callable[[str, str], JointState | Pose]) -> JointState | Pose:
    if "@" in text:
        raise GoalError(
            f"--via '{text}': plan passes vias at times of its own; "
            "`sequence --via V@T` passes one at T s"
        )
    return read(text, "--via")


def sequence_goal(
    arguments: argparse.Namespace, read: Callable[[str, str], JointState | Pose], goal: str
) -> SequenceGoal:
    """Targets, stops and times of a sequence, from ``--via``, ``--stop`` and the goal.

    Parameters
    ----------
    arguments : Namespace
        The arguments.
    read : callable
        Reads one target from its text and the name of its option.
    goal : str
        Name of the goal's option in messages.

    Raises
    ------
    GoalError
        If a text can't be read or the times don't increase.
    """
    targets, times = [], []
    for option, text in [*(("--via", via) for via in arguments.via), (goal, arguments.goal)]:
        place, at, moment = text.partition("@")
        targets.append(read(place, option))
        try:
            times.append(seconds(moment) if at else None)
        except argparse.ArgumentTypeError as error:
            raise GoalError(f"{option} '{text}': after @, {error}") from None
    stops = (*(isinstance(via, Stop) for via in arguments.via), False)
    return SequenceGoal(tuple(targets), tuple(times), arguments.primitive, stops)


def target(robot: Robot, angles: Collection[str], text: str, option: str) -> JointState | Pose:
    """Read a configuration (name=value,…) or a pose ('FRAME: X Y Z' or with a quaternion).

    Raises
    ------
    GoalError
        If it is neither.
    """
    frame, is_pose, numbers = text.partition(":")
    if is_pose:
        return _pose(frame.strip(), numbers, option)
    q = joint_values(text, robot.described_joints, option, angles=angles)
    return JointState(list(q), list(q.values()))


def asked_texts(arguments: argparse.Namespace, robot: Robot) -> list[str]:
    """The texts of the vias and the goal; a pose with the name of its frame."""
    goal = arguments.goal or f"{_frame(arguments, robot)}: {arguments.goal_pose}"
    return [*arguments.via, goal]


def _frame(arguments: argparse.Namespace, robot: Robot) -> str:
    return str(arguments.frame or robot.end_effector)


def stated_pose(frame: str, text: str) -> Pose:
    """Read ``--pose``: a position and a quaternion, stated in a frame.

    Raises
    ------
    GoalError
        If these are not seven numbers, or the quaternion is not of length 1.
    """
    pose = _pose(frame, text, "--pose")
    if pose.orientation is None:
        raise GoalError(
            f"--pose '{text}' has 3 numbers, but a pose for the node has 7 (x y z qx qy qz qw): "
            "its message always has an orientation; `plan --goal-pose` takes a position alone, too"
        )
    return pose


def _pose(frame: str, text: str, option: str) -> Pose:
    numbers = number_list(text, option)
    if len(numbers) not in (3, 7):
        raise GoalError(
            f"{option} '{text}' has {len(numbers)} numbers, but a position has 3 (x y z) and a "
            "pose 7 (x y z qx qy qz qw)"
        )
    return Pose(frame, numbers[:3], numbers[3:] or None)
