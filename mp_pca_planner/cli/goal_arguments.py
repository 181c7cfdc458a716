# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, vias and start states from the text of command-line arguments."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Collection, Sequence

from ..arrays import read_numbers, read_values
from ..exceptions import GoalError
from ..motion.goal import JointState, Pose, SequenceGoal
from ..planning.options import AUTO
from ..robot.model import Robot
from .options import Stop, seconds


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
    if "=" in text:
        # A space after a value separates; others belong to the name of a joint.
        separated = re.sub(r"(=\s*[^\s,=]+)\s+", r"\1,", text.strip(" []"))
        values = read_values(separated, what, kind, names)
    else:
        numbers = read_numbers(text, f"{what}, name=value,… or a list,")
        if len(numbers) != len(names):
            hint = "; a pose is --goal-pose 'X Y Z …'" if "goal" in what else ""
            raise GoalError(
                f"{what} has {len(numbers)} values, expected {len(names)}: {', '.join(names)}{hint}"
            )
        values = dict(zip(names, numbers, strict=True))
    return {name: math.radians(x) if name in angles else x for name, x in values.items()}


def angles_in_degrees(arguments: argparse.Namespace, robot: Robot) -> tuple[str, ...]:
    """The joints whose values are in degrees: with ``--degrees``, all that turn."""
    turning = (name for name in robot.joint_names if name not in robot.prismatic_joints)
    return tuple(turning) if arguments.degrees else ()


def start_positions(arguments: argparse.Namespace, robot: Robot) -> dict[str, float]:
    """Positions by name that ``--start`` gives, also for joints that the primitives don't move.

    Raises
    ------
    GoalError
        If the text can't be read, or positions of joints are missing.
    """
    names = robot.movable_joints if "=" in arguments.start else robot.described_joints
    angles = angles_in_degrees(arguments, robot.with_joints(robot.movable_joints))
    q = joint_values(arguments.start, names, "--start", angles=angles)
    missing = [name for name in robot.joint_names if name not in q]
    if missing:
        raise GoalError(f"--start lacks a position for {', '.join(missing)}")
    return q


def planned_goal(arguments: argparse.Namespace, robot: Robot) -> SequenceGoal:
    """The targets of `plan`, of which the last is the goal.

    Raises
    ------
    GoalError
        If a text can't be read, or the duration of a sequence is none that it can have.
    """
    angles = angles_in_degrees(arguments, robot)

    def read(text: str, option: str) -> JointState | Pose:
        if option == "--goal-pose":
            return pose(arguments.frame or robot.end_effector, text, option)
        frame, is_pose, numbers = text.partition(":")
        if is_pose:
            return pose(frame.strip(), numbers, option)
        q = joint_values(text, robot.described_joints, option, angles=angles)
        return JointState(list(q), list(q.values()))

    goal = ("--goal", arguments.goal)
    if arguments.goal_pose is not None:
        goal = ("--goal-pose", arguments.goal_pose)
    if arguments.via and arguments.timing != AUTO:
        raise GoalError(
            f"--timing {arguments.timing} can't be given with --via: sequences are timed like the "
            "demonstrations, or by --duration or @T"
        )
    return sequence_goal(arguments, read, goal, arguments.duration)


def sequence_goal(
    arguments: argparse.Namespace,
    read: Callable[[str, str], JointState | Pose],
    goal: tuple[str, str],
    duration: float | None = None,
) -> SequenceGoal:
    """Targets, stops and times of a sequence, from ``--via``, ``--stop`` and the goal.

    Parameters
    ----------
    arguments : Namespace
        The arguments.
    read : callable
        Reads one target from its text and the name of its option.
    goal : (str, str)
        Name of the goal's option, and its text.
    duration : float, optional
        Time of the goal [s], if its text has none.

    Raises
    ------
    GoalError
        If a text can't be read, the times don't increase, or the goal has two.
    """
    targets, times = [], []
    for option, text in [*(("--via", via) for via in arguments.via), goal]:
        place, at, moment = text.partition("@")
        targets.append(read(place, option))
        try:
            times.append(seconds(moment) if at else None)
        except argparse.ArgumentTypeError as error:
            raise GoalError(f"{option} '{text}': after @, {error}") from None
    if times[-1] and duration:
        raise GoalError(f"{goal[0]} '{goal[1]}' has a time already: remove @T or --duration")
    times[-1] = times[-1] or duration
    stops = (*(isinstance(via, Stop) for via in arguments.via), False)
    return SequenceGoal(tuple(targets), tuple(times), arguments.primitive, stops)


def pose(frame: str, text: str, option: str) -> Pose:
    """Read a position, or a pose with a quaternion, of or in a frame.

    Raises
    ------
    GoalError
        If these are not three or seven numbers, or the quaternion is not of length 1.
    """
    numbers = read_numbers(text, option)
    if len(numbers) not in (3, 7):
        raise GoalError(
            f"{option} '{text}' has {len(numbers)} numbers, but a position has 3 (x y z) and a "
            "pose 7 (x y z qx qy qz qw)"
        )
    return Pose(frame, numbers[:3], numbers[3:] or None)
