# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Types of options, and options that several commands have."""

from __future__ import annotations

import argparse
import math
from argparse import ArgumentTypeError
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..arrays import read_values
from ..exceptions import RecordingError
from ..planning.options import AUTO, BASES, MAX_NATURALNESS, MODES, OPTIMAL, TIMINGS
from ..renaming import read_rename
from ..robot.limits import given_limits

if TYPE_CHECKING:
    from ..robot.model import Robot


class Stop(str):
    """A value of ``--stop`` among those of ``--via``."""


def number(
    low: float, high: float, unit: str = "", kind: type[float] = float
) -> Callable[[str], float]:
    """Type of numbers within bounds; of whole ones if the kind is int."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            word = "a whole number" if kind is int else "a number"
            expected = f"{word} from {low:g} to {high:g} {unit}".rstrip()
            raise ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return parse


seconds = number(1e-6, 1e6, "s")
"""Type of times [s]."""


def folder(text: str) -> Path:
    """A folder that exists."""
    if not Path(text).is_dir():
        raise ArgumentTypeError(f"there is no folder '{text}'")
    return Path(text)


def name_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that write files."""
    parser.add_argument("--force", action="store_true", help="overwrite files")
    add_json(parser)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option of all commands that print results."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_node(parser: argparse.ArgumentParser) -> None:
    """Add the options of clients of the node."""
    parser.add_argument("--node", metavar="NAME", default="mp_pca_planner", help="name of the node")
    parser.add_argument("--namespace", metavar="NS", default="", help="namespace of the node")
    help_text = "longest time to wait for the node and its answer [s] (default: %(default)g)"
    parser.add_argument("--timeout", metavar="S", type=seconds, default=10.0, help=help_text)


def add_file(parser: argparse._ActionsContainer, name: str, metavar: str, help_text: str) -> None:
    """Add an option whose value is a path."""
    parser.add_argument(name, metavar=metavar, type=Path, help=help_text)


def add_bag_topic(parser: argparse._ActionsContainer) -> None:
    """Add the options on the messages of recordings."""
    help_text = "of the bags (default: the only JointState one), or column of LeRobot"
    parser.add_argument("--topic", help=help_text)
    help_text = "field of the topic's messages that is a JointState"
    parser.add_argument("--field", metavar="a.b", help=help_text)
    help_text = "read a damaged .mcap or .bag up to the damage"
    parser.add_argument("--recover", "--salvage", action="store_true", help=help_text)


def add_units(parser: argparse._ActionsContainer) -> None:
    """Add the options on the units and names of the joints of recordings."""
    help_text = "recorded in degrees, but joints with a --scale"
    parser.add_argument("--degrees", action="store_true", help=help_text)
    several: dict[str, Any] = {"action": "append", "default": []}
    help_text = "new name of joints, * for any text (left_*=* strips a prefix)"
    parser.add_argument("--rename", metavar="OLD=NEW", **several, help=help_text)
    help_text = "whole factor to rad or m; or LeRobot's calibration FILE.json"
    parser.add_argument("--scale", metavar="JOINT=FACTOR", **several, help=help_text)


def reading_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """The fields of :class:`.LoadOptions` by these options; without ``=``, a scale is a file."""
    from ..recordings.reading import scale_of_calibration  # slow to import

    scale: dict[str, float] = {}
    for text in arguments.scale:
        if "=" in text:
            scale |= read_values(text, "--scale", "joint")
        elif Path(text).is_file():
            scale |= scale_of_calibration(text)
        else:
            raise RecordingError(f"--scale '{text}' is neither JOINT=FACTOR nor a calibration file")
    return {
        "topic": arguments.topic,
        "state_field": arguments.field,
        "salvage": arguments.recover,
        "degrees": arguments.degrees,
        "rename": read_rename(arguments.rename),
        "scale": scale,
    }


def add_robot_files(parser: argparse.ArgumentParser, *, is_needed: bool = True) -> None:
    """Add primitive files, and the options on the robot that they move."""
    add, several = parser.add_argument, "+" if is_needed else "*"
    add("primitives", metavar="FILE", nargs=several, help="primitive files or folders")
    add("--robot", metavar="URDF", type=Path, required=is_needed, help="robot description")
    add_file(parser, "--limits", "FILE.yaml", "limits, as in MoveIt's joint_limits.yaml")
    folders: dict[str, Any] = {"metavar": "DIR", "type": folder, "nargs": "+", "default": []}
    help_text = "folders of packages with meshes; searched before ROS's"
    add("--package-dirs", **folders, help=help_text)


def limits_given(arguments: argparse.Namespace, robot: Robot) -> dict[str, dict[str, float]]:
    """The content of the limits file by the joints of the robot; empty without a file."""
    file = arguments.limits
    return {} if file is None else given_limits(file, robot.movable_joints)


def add_targets(parser: argparse._ActionsContainer, place: str) -> None:
    """Add the options on the targets before the goal; they are kept in their order."""
    shared: dict[str, Any] = {"metavar": "TARGET[@T]", "action": "append"}
    help_text = f"{place} to pass at T s"
    parser.add_argument("--via", **shared, default=[], help=help_text)
    help_text = "the same to rest at; both may be repeated"
    parser.add_argument("--stop", **shared, dest="via", type=Stop, help=help_text)


def add_request(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`plan.plan_request` reads."""
    parser.usage = "%(prog)s FILE… --robot URDF --start VALUES --goal VALUES [OPTION …]"
    add_robot_files(parser)
    _add_ends(parser)
    _add_motion(parser)
    _add_collisions(parser)


def _add_ends(parser: argparse.ArgumentParser) -> None:
    ends = parser.add_argument_group("start and goal: name=value,… or all values in joint order")
    help_text = "start [rad or m]; may also name joints that stay there"
    ends.add_argument("--start", metavar="VALUES", required=True, help=help_text)
    goal = ends.add_mutually_exclusive_group(required=True)
    help_text = "goal [rad or m], to reach at T s; joints that are not named stay"
    goal.add_argument("--goal", metavar="VALUES[@T]", help=help_text)
    help_text = "pose in the base frame [m, quaternion]; 3 numbers: position only"
    goal.add_argument("--goal-pose", metavar="'X Y Z …'", help=help_text)
    help_text = "link of --goal-pose (default: the last that most joints move)"
    ends.add_argument("--frame", metavar="LINK", help=help_text)
    ends.add_argument("--degrees", action="store_true", help="angles are in degrees")
    add_targets(ends, "configuration, or pose 'FRAME: X Y Z …',")


def _add_motion(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("motion").add_argument
    add("--primitive", metavar="NAME", help="primitive to use (default: the nearest)")
    duration = number(1e-3, 600.0, "s")
    add("--duration", metavar="T", type=duration, help="duration [s], as @T")
    help_text = "optimise, or join predicted segments (real_time)"
    add("--mode", choices=MODES, default=OPTIMAL, help=help_text)
    help_text = "how to choose the duration (auto: demonstrated below score 3)"
    add("--timing", choices=TIMINGS, default=AUTO, help=help_text)
    add("--basis", choices=BASES, default=BASES[0], help="basis functions")
    help_text = "1: like the demonstrations, 0: least effort (default: by score)"
    add("--naturalness", metavar="ρ", type=number(0.0, MAX_NATURALNESS), help=help_text)
    most = number(0.0, 1e6)
    help_text = "most speed and acceleration, in demonstrated ones; 0: only limits"
    add("--demonstrated-margin", metavar="M", type=most, default=1.2, help=help_text)
    help_text = "reject requests above; 1: like the demonstrations, 3: unlike them"
    add("--max-in-span-score", metavar="S", type=most, default=0.0, help=help_text)
    help_text = "longest time for planning [s] (default: 5, or none with --via)"
    add("--max-solve-time", metavar="S", type=seconds, help=help_text)
    help_text = "sum to minimise of effort, energy, jerk, time, straightness"
    add("--objective", metavar="NAME=WEIGHT,…", default="effort=1", help=help_text)
    help_text = "upright:FRAME:DEGREES keeps its z axis (or :X:Y:Z) within this angle of upright"
    add("--constraint", metavar="TEXT;…", default="", help=help_text)


def _add_collisions(parser: argparse.ArgumentParser) -> None:
    world = parser.add_argument_group("collisions")
    help_text = "avoid self-collisions (default: where the URDF has shapes)"
    world.add_argument("--collision", action=argparse.BooleanOptionalAction, help=help_text)
    add_file(world, "--obstacles", "FILE", SCENE)
    help_text = "least clearance from --obstacles [m] (default: 0)"
    world.add_argument("--margin", metavar="M", type=number(0.0, 10.0, "m"), help=help_text)
    add_file(world, "--srdf", "FILE", "pairs of links to skip (default: those that touch at 0)")


SCENE = "obstacles: a planning scene of MoveIt, .scene or YAML"
"""What a file of obstacles is."""
