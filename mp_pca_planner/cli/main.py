# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the command that is asked for and hands over to it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import NamedTuple, cast

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, unknown_name
from .terminal import DEBUG, DEBUG_HELP, OneLineParser, guard

PROGRAM = "mp_pca_planner"
_ROS_ARGUMENTS = "--ros-args"

CommandFunction = Callable[[Sequence[str] | None], int]


class Command(NamedTuple):
    """Where a command lives (``module:function``) and what it does."""

    target: str
    summary: str


COMMANDS = {
    "build_primitives": Command(
        "mp_pca_planner.cli.build_primitives:main", "recorded bags to a primitive file"
    ),
    "inspect": Command("mp_pca_planner.cli.inspect:main", "what is in a bag or a primitive file"),
    "plan": Command("mp_pca_planner.cli.plan:main", "one motion from primitive files, offline"),
    "sequence": Command(
        "mp_pca_planner.cli.sequence:main", "one motion through several configurations, offline"
    ),
    "refine": Command("mp_pca_planner.cli.refine:main", "improve a motion, keep it as a primitive"),
    "benchmark": Command(
        "mp_pca_planner.cli.benchmark:main", "components against B-splines and other methods"
    ),
    "library": Command(
        "mp_pca_planner.cli.versioned_library:main", "a folder of primitives that keeps its history"
    ),
    "verify": Command(
        "mp_pca_planner.cli.verify:main", "a control law for a motion, its bound, simulations of it"
    ),
    "case_study": Command(
        "mp_pca_planner.cli.case_study:main", "the paper's case study, and naturalness measured"
    ),
    "demo": Command("mp_pca_planner.cli.demo:main", "the whole way: record, build, plan, publish"),
    "send_goal": Command(
        "mp_pca_planner.cli.send_goal:main", "a goal for the running node, and what it answers"
    ),
    "simulate": Command(
        "mp_pca_planner.cli.simulate:main", "a simulated robot on ROS topics, with faults on demand"
    ),
    "watch": Command("mp_pca_planner.cli.watch:main", "the running node in the terminal, live"),
    "planner_node": Command("mp_pca_planner.ros.planner_node:main", "the ROS 2 node"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command named by the first argument with the arguments after it.

    Parameters
    ----------
    argv :
        The arguments without the program's name; those of the process by default.

    Returns
    -------
    :
        The exit status: the command's own, 1 if it failed or was interrupted, or 2 if there is no
        such command or it can't be loaded. Without a command, the help is printed.
    """
    arguments, is_debugged = _without_debug(sys.argv[1:] if argv is None else argv)
    program = " ".join([PROGRAM, *(name for name in arguments[:1] if name in COMMANDS)])
    return guard(program, lambda: _run(arguments), debug=is_debugged)


def _run(arguments: Sequence[str]) -> int:
    # Only the first argument is ours: the command sees the others as they were typed.
    name = _parser().parse_args(arguments[:1] or ["--help"]).command
    if name not in COMMANDS:
        raise PlannerError(unknown_name("command", name, COMMANDS))
    return load_command(name)(arguments[1:])


def _without_debug(argv: Sequence[str]) -> tuple[list[str], bool]:
    """Take the option of every command off, wherever it is before the arguments for ROS."""
    end = argv.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in argv else len(argv)
    own = [word for word in argv[:end] if word != DEBUG]
    return [*own, *argv[end:]], len(own) < end


def load_command(name: str) -> CommandFunction:
    """Import a command of the table; the others stay unloaded, and with them what they need.

    Raises
    ------
    MissingDependencyError
        If the command needs ROS 2 and there is none.
    """
    module_name, _, function_name = COMMANDS[name].target.partition(":")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if not _belongs_to_ros(error.name):
            raise
        raise MissingDependencyError(str(error.name), "ros", f"the command '{name}'") from error
    return cast(CommandFunction, getattr(module, function_name))


def _belongs_to_ros(module_name: str | None) -> bool:
    top_level = (module_name or "").partition(".")[0]
    return top_level in {"rclpy", "std_srvs"} or top_level.endswith(("_msgs", "_interfaces"))


def _parser() -> OneLineParser:
    width = max(map(len, COMMANDS))
    parser = OneLineParser(
        prog=PROGRAM,
        usage="%(prog)s [-h] [--version] [--debug] COMMAND ...",
        description="Movement primitives from recordings, and least-effort motions made of them.",
        epilog="commands (each has its own --help):\n"
        + "\n".join(f"  {name:{width}}  {c.summary}" for name, c in COMMANDS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    parser.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)
    parser.add_argument("command", metavar="COMMAND", help="one of the commands below")
    return parser
