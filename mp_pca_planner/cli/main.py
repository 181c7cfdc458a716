# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The program: it runs the command that its first argument names.

A command is a module with `add_arguments` and `run`, which is imported when the command is named.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, unknown_name
from .terminal import DEBUG, PROGRAM, Parser, UsageError, guard

_ROS = "--ros-args"

_GROUPS = {
    "learn from recordings": {
        "inspect": "show the contents of recordings or primitive files, with every defect",
        "build_primitives": "learn a primitive from recordings",
        "teach": "learn a primitive from motions that you show the running robot",
    },
    "plan without ROS": {
        "plan": "plan a motion or a sequence, offline",
        "view": "drag goals and obstacles on a page in the browser",
        "refine": "improve a motion and keep it as a primitive",
        "verify": "check a control law for a motion: error bound and simulations",
    },
    "run on a robot": {
        "planner_node": "run the ROS 2 node",
        "send_goal": "send a goal to the node, and wait until the robot has arrived",
        "send_obstacles": "give the node the obstacles of a scene, or remove them",
        "stop": "bring the robot to rest",
        "call": "make the node reload its primitives or save its last motion",
    },
    "try it": {
        "demo": "run the whole pipeline: record, learn, plan, execute",
        "simulate": "simulate a robot on ROS topics, with faults on demand",
    },
}
COMMANDS = {name: text for group in _GROUPS.values() for name, text in group.items()}
"""What each command is for."""
COMMANDS["sequence"] = "another name of plan"
_MODULES = {"sequence": "plan", "stop": "call"}
"""Modules of commands that have none of their own."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command named by the first argument with the arguments after it.

    Parameters
    ----------
    argv :
        The arguments without the program's name; those of the process by default.

    Returns
    -------
    :
        The exit status: the command's own, 1 if it failed or was interrupted, or 2 if its input is
        refused or it can't be loaded. Without a command, the help is printed.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
        import argcomplete

        typed = os.environ.get("COMP_LINE", "").split()[1:2]
        argcomplete.autocomplete(parser_with(*(typed or [""])))
    program = " ".join([PROGRAM, *(name for name in words[:1] if name in COMMANDS)])
    return guard(program, lambda: _run(words), debug=DEBUG in words)


def _run(words: list[str]) -> int:
    if words[:1] == ["help"]:
        words = [*words[1:2], "--help"]
    name = words[0] if words else ""
    try:
        if name == "planner_node":
            from ..ros.planner_node import main as planner_node

            return planner_node([word for word in words[1:] if word != DEBUG])
        return run_command(name, words[1:])
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name)
        if extra is None:
            raise
        raise MissingDependencyError(str(error.name), extra, f"the command '{name}'") from error


def run_command(name: str, argv: Sequence[str]) -> int:
    """Run a command with its arguments; returns its exit status."""
    arguments = parse(name, argv)
    status: int = _module(name).run(arguments)
    return status


def parse(name: str, argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command.

    Returns
    -------
    :
        The values, with the name of the command and, for `simulate`, the arguments for ROS.

    Raises
    ------
    PlannerError
        If there is no such command, or it does not accept the arguments.
    """
    if name and name not in COMMANDS and not name.startswith("-"):
        raise PlannerError(unknown_name("command", name, COMMANDS, most=len(COMMANDS)))
    words = list(argv)
    cut = words.index(_ROS) if name == "simulate" and _ROS in words else len(words)
    given = argparse.Namespace(ros_arguments=words[cut:])
    try:
        return parser_with(name).parse_args([name, *words[:cut]] if name else ["--help"], given)
    except UsageError as error:
        if re.search(r"unrecognized arguments: [-+]?[\d.]", str(error)) is None:
            raise
        hint = "put quotes around the numbers of a pose, as in '0.4 0.1 0.6'"
        raise UsageError(f"{hint}: {error}") from None


def parser_with(name: str) -> argparse.ArgumentParser:
    """The parser of the program with the options of one command."""
    groups = (
        "\n".join([f"{title}:", *(f"  {command:<18}{text}" for command, text in members.items())])
        for title, members in _GROUPS.items()
    )
    parser = Parser(
        prog=PROGRAM,
        usage="%(prog)s COMMAND …, or %(prog)s help COMMAND",
        description="Movement primitives from recordings, and motions made of them.",
        epilog="\n\n".join(groups),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mp_pca_planner {__version__}")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", prog=PROGRAM, help=argparse.SUPPRESS
    )
    for command in COMMANDS:
        own = commands.add_parser(command, allow_abbrev=False)
        if command == name:
            _module(name).add_arguments(own)
            own.add_argument(DEBUG, action="store_true", help="print the traceback of an error")
    return parser


def _module(name: str) -> ModuleType:
    return import_module(f".{_MODULES.get(name, name)}", __package__)


def _extra_with(module_name: str | None) -> str | None:
    """The extra of the package that installs a module."""
    top_level = (module_name or "").partition(".")[0]
    if top_level in {"rclpy", "std_srvs"} or top_level.endswith(("_msgs", "_interfaces")):
        return "ros"
    return "view" if top_level in {"jinja2", "rich", "viser"} else None
