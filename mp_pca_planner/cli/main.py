# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The table of commands, and the program that runs one of them."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, unknown_name
from .options import COMMANDS, ROS_ARGUMENTS, add_options, module_of, parse
from .terminal import DEBUG, DEBUG_HELP, PROGRAM, OneLineParser, guard


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
    if argv is None:
        _complete_if_asked()
    arguments, is_debugged = _without_debug(sys.argv[1:] if argv is None else argv)
    program = " ".join([PROGRAM, *(name for name in arguments[:1] if name in COMMANDS)])
    return guard(program, lambda: _run(arguments), debug=is_debugged)


def _complete_if_asked() -> None:
    """Print completions and exit if the shell asks for them and argcomplete is installed.

    It sets a variable to ask, after ``eval "$(register-python-argcomplete mp-pca)"``.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    with suppress(ImportError):
        from argcomplete import autocomplete

        parser = argparse.ArgumentParser()
        parsers = parser.add_subparsers()
        for name in COMMANDS:
            add_options(parsers.add_parser(name), name)
        autocomplete(parser)


def _run(arguments: Sequence[str]) -> int:
    # The command parses the other arguments.
    name = _parser().parse_args(arguments[:1] or ["--help"]).command
    if name not in COMMANDS:
        raise PlannerError(unknown_name("command", name, COMMANDS, len(COMMANDS)))
    try:
        return load_command(name)(arguments[1:])
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name)
        if extra is None:
            raise
        raise MissingDependencyError(str(error.name), extra, f"the command '{name}'") from error


def _without_debug(argv: Sequence[str]) -> tuple[list[str], bool]:
    """Remove the option that all commands share from the arguments before those for ROS."""
    end = argv.index(ROS_ARGUMENTS) if ROS_ARGUMENTS in argv else len(argv)
    own = [word for word in argv[:end] if word != DEBUG]
    return [*own, *argv[end:]], len(own) < end


def load_command(name: str) -> Callable[[Sequence[str]], int]:
    """The function that runs a command with its arguments and returns the exit status."""
    if name == "planner_node":
        from ..ros.planner_node import main as planner_node

        return planner_node
    return partial(_parse_and_run, name)


def _parse_and_run(name: str, argv: Sequence[str]) -> int:
    # The module is imported after the parser has printed help or refused the arguments.
    arguments = parse(name, argv)
    module = import_module(f".{module_of(name)}", __package__)
    status: int = module.run(arguments)
    return status


def _extra_with(module_name: str | None) -> str | None:
    """The extra of the package that installs a module."""
    top_level = (module_name or "").partition(".")[0]
    if top_level in {"rclpy", "std_srvs"} or top_level.endswith(("_msgs", "_interfaces")):
        return "ros"
    return "view" if top_level in {"jinja2", "rich", "trimesh", "viser", "websockets"} else None


def _parser() -> OneLineParser:
    width = max(map(len, COMMANDS))
    parser = OneLineParser(
        prog=PROGRAM,
        usage="%(prog)s [-h] [--version] [--debug] COMMAND ...",
        description="Movement primitives from recordings, and motions made of them.",
        epilog="commands (each has its own --help):\n"
        + "\n".join(f"  {name:{width}}  {summary}" for name, summary in COMMANDS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mp_pca_planner {__version__}")
    parser.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)
    parser.add_argument("command", metavar="COMMAND", help="one of the commands below")
    return parser
