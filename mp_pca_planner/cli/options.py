# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Types of options, and options that several commands have."""

from __future__ import annotations

import argparse
import math
from argparse import ArgumentTypeError
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..planning.options import AUTO, BASES, MODES, OPTIMAL, TIMINGS
from ..renaming import read_rename
from ..robot.limits import given_limits

if TYPE_CHECKING:
    from ..robot.model import Robot

VALUES = "name=value,… or values in the robot description's joint order [rad or m]"
PLACE = "configuration (name=value,…) or pose ('FRAME: X Y Z' or with a quaternion)"


class Stop(str):
    """A value of ``--stop`` among those of ``--via``."""


class Once(argparse.Action):
    """Store a value that may be given once; argparse would silently take the last."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        """Store the value."""
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option_string} is given more than once; pass places with --via")
        setattr(namespace, self.dest, values)


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Type of numbers within bounds."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            expected = f"a number from {low:g} to {high:g} {unit}".rstrip()
            raise ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of whole numbers within bounds."""

    def parse(text: str) -> int:
        # Longer numbers exceed every bound and are slow to convert.
        if not (text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            raise ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


seconds = number(1e-6, 1e6, "s")
"""Type of times [s]."""


def name_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that write files."""
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_node(parser: argparse.ArgumentParser) -> None:
    """Add the options of clients of the node."""
    parser.add_argument("--node", metavar="NAME", default="mp_pca_planner", help="name of the node")
    parser.add_argument("--namespace", metavar="NS", default="", help="namespace of the node")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=seconds,
        default=10.0,
        help="longest time to wait for the node and for its answer [s] (default: %(default)g)",
    )


def add_robot_files(parser: argparse.ArgumentParser) -> None:
    """Add primitive files, and the options on the robot that they move."""
    parser.add_argument("primitives", metavar="FILE", nargs="+", help="primitive files or folders")
    parser.add_argument(
        "--robot", metavar="URDF", type=Path, required=True, help="robot description"
    )
    parser.add_argument(
        "--limits",
        metavar="FILE.yaml",
        type=Path,
        help="limits, in the form of MoveIt's joint_limits.yaml",
    )
    parser.add_argument(
        "--rename",
        metavar="OLD=NEW",
        action="append",
        default=[],
        help="new name of joints in the file of --limits, * for any text",
    )
    parser.add_argument(
        "--package-dirs",
        metavar="DIR",
        type=Path,
        nargs="+",
        default=[],
        help="folders of packages with meshes; searched before ROS's folders and the folders "
        "above the URDF",
    )


def limits_given(arguments: argparse.Namespace, robot: Robot) -> dict[str, dict[str, float]]:
    """The content of the limits file by the joints of the robot; empty without a file."""
    rename = read_rename(arguments.rename)
    if arguments.limits is None:
        return {}
    return given_limits(arguments.limits, robot.movable_joints, rename)


def add_targets(parser: argparse._ActionsContainer, place: str) -> None:
    """Add the options on the targets before the goal; they are kept in their order."""
    parser.add_argument(
        "--via",
        metavar="TARGET[@T]",
        action="append",
        default=[],
        help=f"{place} to pass; @T: T s after the start; may be repeated",
    )
    parser.add_argument(
        "--stop",
        metavar="TARGET[@T]",
        dest="via",
        action="append",
        type=Stop,
        help=f"{place} to rest at; @T: T s after the start; may be repeated",
    )


def add_request(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`plan.plan_request` reads."""
    parser.usage = "%(prog)s FILE… --robot URDF --start VALUES --goal VALUES [OPTION …]"
    add_robot_files(parser)
    _add_ends(parser)
    _add_motion(parser)
    _add_objectives(parser)
    _add_collisions(parser)


def _add_ends(parser: argparse.ArgumentParser) -> None:
    ends = parser.add_argument_group("start and goal")
    ends.add_argument(
        "--start",
        metavar="VALUES",
        required=True,
        help=f"start configuration: {VALUES}; may name further joints, which stay there",
    )
    goal = ends.add_mutually_exclusive_group(required=True)
    goal.add_argument(
        "--goal",
        metavar="VALUES",
        action=Once,
        help=f"goal: {VALUES}, @T with --via; unnamed joints stay",
    )
    goal.add_argument(
        "--goal-pose",
        metavar="'X Y Z QX QY QZ QW'",
        action=Once,
        help="pose of a frame [m, unit quaternion] in the base frame; 3 numbers: position only",
    )
    ends.add_argument(
        "--frame",
        metavar="LINK",
        help="link of --goal-pose (default: the last link that most joints move)",
    )
    ends.add_argument(
        "--degrees", action="store_true", help="angles are in degrees, not in radians"
    )
    add_targets(ends, PLACE)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    motion = parser.add_argument_group("motion")
    motion.add_argument(
        "--primitive", metavar="NAME", help="primitive to use (default: the nearest)"
    )
    motion.add_argument(
        "--mode",
        choices=MODES,
        default=OPTIMAL,
        help="join the predicted segments between targets (real_time), or optimise the motion",
    )
    motion.add_argument(
        "--duration", metavar="T", type=number(1e-3, 600.0, "s"), help="duration [s]"
    )
    motion.add_argument(
        "--timing",
        choices=TIMINGS,
        default=AUTO,
        help="way to choose the duration (default: demonstrated, but free if the in-span score is "
        "above 3, or for a detour)",
    )
    motion.add_argument("--basis", choices=BASES, default=BASES[0], help="basis functions")
    motion.add_argument(
        "--naturalness",
        metavar="ρ",
        type=number(0.0, 1.0),
        help="1: close to the predicted motion; 0: least effort alone; values near 0.01 are "
        "between (default: 1, or (3 / score)³ if the in-span score is above 3)",
    )
    motion.add_argument(
        "--demonstrated-margin",
        metavar="M",
        type=number(0.0, 1e6),
        default=1.2,
        help="largest velocities and accelerations, as multiples of the demonstrated ones; 0: only "
        "the limits (default: %(default)g)",
    )
    motion.add_argument(
        "--max-in-span-score",
        metavar="S",
        type=number(0.0, 1e6),
        default=0.0,
        help="reject requests whose in-span score is above this (default: none); about 1 is like "
        "the demonstrations, above 3 is unlike them",
    )
    motion.add_argument(
        "--max-solve-time",
        metavar="S",
        type=seconds,
        help="longest time for planning [s] (default: 5, or none with --via); more may find a "
        "better motion among obstacles",
    )


def _add_objectives(parser: argparse.ArgumentParser) -> None:
    motion = parser.add_argument_group("objectives and constraints")
    motion.add_argument(
        "--objective",
        metavar="NAME=WEIGHT,…",
        default="effort=1",
        help="weighted sum of objectives to minimise: effort, energy, jerk, time, straightness "
        "(default: %(default)s)",
    )
    motion.add_argument(
        "--constraint",
        metavar="NAME:VALUE…;…",
        default="",
        help="constraints on every configuration, such as upright:FRAME:DEGREES: the z axis of a "
        "frame stays within that angle of the vertical",
    )


def _add_collisions(parser: argparse.ArgumentParser) -> None:
    world = parser.add_argument_group("collisions")
    world.add_argument(
        "--collision",
        action=argparse.BooleanOptionalAction,
        help="avoid self-collisions (default: where the URDF has shapes)",
    )
    world.add_argument(
        "--obstacles",
        metavar="FILE",
        type=Path,
        help="obstacles to avoid: a planning scene of MoveIt, .scene or YAML",
    )
    world.add_argument(
        "--margin",
        metavar="M",
        type=number(0.0, 10.0, "m"),
        help="least clearance from --obstacles [m] (default: 0)",
    )
    world.add_argument(
        "--srdf",
        metavar="FILE",
        type=Path,
        help="file of link pairs to skip (default: neighbours, and links that touch in the "
        "neutral configuration)",
    )


def add_bag_topic(parser: argparse.ArgumentParser) -> None:
    """Add the options on the messages of recordings."""
    parser.add_argument(
        "--topic",
        help="JointState topic of the bags (default: the only one), or column of a LeRobot "
        "dataset; several with commas between",
    )
    parser.add_argument(
        "--field", metavar="a.b", help="field of the topic's messages that is a JointState"
    )
    parser.add_argument(
        "--recover",
        "--salvage",
        action="store_true",
        help="read the part of a damaged .mcap or .bag before the damage",
    )
