# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The commands with their options, as `options.toml` declares them, and the program that runs one.

A command is the function `run` of a module of its name. This module imports no room, so that help
is printed at once.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import tomllib
from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from .. import __version__
from ..exceptions import MissingDependencyError, PlannerError, unknown_name
from .terminal import DEBUG, DEBUG_HELP, PROGRAM, OneLineParser, guard

ROS_ARGUMENTS = "--ros-args"
HELP_ALL = "--help-all"

_TABLE: dict[str, Any] = tomllib.loads(
    Path(__file__).with_name("options.toml").read_text(encoding="utf-8")
)
COMMANDS: dict[str, str] = {name: parts[0]["summary"] for name, parts in _TABLE["commands"].items()}
"""What each command is for."""


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
    module = import_module(f".{_TABLE['commands'][name][0].get('module', name)}", __package__)
    status: int = module.run(arguments)
    return status


def _extra_with(module_name: str | None) -> str | None:
    """The extra of the package that installs a module."""
    top_level = (module_name or "").partition(".")[0]
    if top_level in {"rclpy", "std_srvs"} or top_level.endswith(("_msgs", "_interfaces")):
        return "ros"
    return "view" if top_level in {"jinja2", "rich", "viser", "websockets"} else None


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


class Stop(str):
    """A value of ``--stop`` among those of ``--via``."""


def number(low: str, high: str, unit: str = "") -> Callable[[str], float]:
    """Type of numbers within bounds."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not float(low) <= value <= float(high):
            expected = f"a number from {float(low):g} to {float(high):g} {unit}".rstrip()
            raise ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return parse


def whole(low: str, high: str) -> Callable[[str], int]:
    """Type of whole numbers within bounds."""

    def parse(text: str) -> int:
        # Longer numbers exceed every bound and are slow to convert.
        if not (text.isdecimal() and len(text) < 20 and int(low) <= int(text) <= int(high)):
            raise ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


seconds = number("1e-6", "1e6", "s")
"""Type of times [s]."""


def duration(text: str) -> str | float:
    """Read a duration [s], or one of the words for a duration that the planner chooses."""
    if text in ("shortest", "demonstrated", "free"):
        return text
    try:
        return number("1e-3", "600", "s")(text)
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"{error}, 'shortest', 'demonstrated' or 'free'") from None


def name_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


_BOUNDED: dict[str, Callable[..., Callable[[str], Any]]] = {"number": number, "whole": whole}
_TYPES: dict[str, Callable[[str], Any]] = {
    "text": str,
    "path": Path,
    "int": int,
    "float": float,
    "names": name_list,
    "seconds": seconds,
    "duration": duration,
    "count": whole("1", "1000000"),
    "seed": whole("0", str(2**63 - 1)),
    "stop": Stop,
}


def add_options(
    parser: argparse.ArgumentParser, command: str, *, with_experts: bool = True
) -> None:
    """Add the options of a command to a parser: in titled groups, those for experts last."""
    experts = parser.add_argument_group("expert options")
    for section in _TABLE["commands"][command]:
        target: argparse._ActionsContainer = parser
        if "title" in section:
            target = parser.add_argument_group(section["title"], section.get("description"))
        sets = [_TABLE["sets"][name] for name in section.get("use", ())]
        together: dict[str, argparse._ActionsContainer] = {}
        for options in (*sets, section.get("options", {})):
            for names, content in options.items():
                option = {"help": content} if isinstance(content, str) else {**content}
                is_expert = option.pop("expert", False) or section.get("expert", False)
                if with_experts or not is_expert:
                    _add_option(experts if is_expert else target, together, names, option)
        parser.set_defaults(**section.get("preset", {}))
    # After the titled groups.
    parser._action_groups.append(parser._action_groups.pop(parser._action_groups.index(experts)))


def _add_option(
    target: argparse._ActionsContainer,
    together: dict[str, argparse._ActionsContainer],
    option: str,
    more: dict[str, Any],
) -> None:
    """Add an option; `together` holds the groups of those that exclude each other."""
    group = more.pop("one_of", None)
    if group is not None:
        required = more.pop("required", False)
        made = together.get(group) or target.add_mutually_exclusive_group(required=required)
        target = together[group] = made
    words = option.split()
    names = [word for word in words if word.startswith("-")] or words[:1]
    if len(words) > len(names):
        more["metavar"] = " ".join(words[len(names) :])
    more["help"] = more["help"].format(**_TABLE["texts"])
    kind, *bounds = more.pop("type", "text").split()
    if kind == "flag":
        more["action"] = "store_true"
    else:
        more["type"] = _BOUNDED[kind](*bounds) if bounds else _TYPES[kind]
        more.setdefault("default", None)
    target.add_argument(*names, **more)


def parse(command: str, argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command; prints a message and exits if they are wrong.

    Parameters
    ----------
    command : str
        Its name.
    argv : sequence of str
        The arguments.

    Returns
    -------
    :
        The values, with the name of the command and, for `simulate`, the arguments for ROS.
    """
    parser = OneLineParser(
        prog=f"{PROGRAM} {command}",
        description=_TABLE["commands"][command][0]["about"],
        allow_abbrev=False,
    )
    # The usual help is that of a parser without the options for experts.
    is_usual_help = not {"-h", "--help"}.isdisjoint(argv)
    parser.add_argument(HELP_ALL, action="help", help="show this help with the expert options")
    if not is_usual_help:
        # The guard around all commands handles this option. It is added here for the help only.
        parser.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)
    add_options(parser, command, with_experts=not is_usual_help)
    _state_defaults(parser)
    has_ros_arguments = command == "simulate" and ROS_ARGUMENTS in argv
    cut = argv.index(ROS_ARGUMENTS) if has_ros_arguments else len(argv)
    words = _with_one_goal(argv[:cut]) if command == "sequence" else argv[:cut]
    if not is_usual_help:
        _check_options(parser, words)
    given = argparse.Namespace(command=command, ros_arguments=list(argv[cut:]))
    return parser.parse_args(_with_negative_values(words), given)


def _with_one_goal(argv: Sequence[str]) -> list[str]:
    """The arguments of a sequence, whose goals before the last one are configurations to pass."""
    words, goal = list(argv), "--goal"
    goals = [k for k, word in enumerate(words) if word.partition("=")[0] == goal]
    for k in goals[:-1]:
        words[k] = f"--via{words[k].removeprefix(goal)}"
    return words


def _check_options(parser: argparse.ArgumentParser, argv: Sequence[str]) -> None:
    """Exit with a suggestion if there is no such option; argparse would first name missing ones.

    Of several goals, argparse would silently take the last.
    """
    known = [name for name in parser._option_string_actions if name.startswith("--")]
    names = [word.partition("=")[0] for word in argv if word.startswith("--") and word != "--"]
    for name in names:
        if name not in known:
            parser.error(unknown_name("option", name, known).partition("; valid")[0])
    for name in ("--goal", "--goal-pose"):
        if names.count(name) > 1:
            hint = "; pass places on the way with --via" if "--via" in known else ""
            parser.error(
                f"a motion has one goal, but {name} is given {names.count(name)} times{hint}"
            )


def _state_defaults(parser: argparse.ArgumentParser) -> None:
    """Append default values to the help of options, unless their help states them."""
    for action in parser._actions:
        has_value = action.default not in (None, False, "", argparse.SUPPRESS, [], ())
        if has_value and action.help and "(default:" not in action.help:
            action.help += " (default: %(default)s)"


def _with_negative_values(argv: Sequence[str]) -> list[str]:
    """Join lists such as -0.2,0.1 with the option before them: argparse parses them as options."""
    joined: list[str] = []
    for word in argv:
        before = joined[-1] if joined else ""
        if re.match(r"-[\d.]", word) and before.startswith("--") and "=" not in before:
            joined[-1] = f"{before}={word}"
        else:
            joined.append(word)
    return joined
