# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The commands and their options, as `options.toml` declares them.

This module imports no room, so that help is printed at once.
"""

from __future__ import annotations

import argparse
import math
import re
import tomllib
from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..exceptions import unknown_name
from .terminal import DEBUG, DEBUG_HELP, PROGRAM, OneLineParser

ROS_ARGUMENTS = "--ros-args"
HELP_ALL = "--help-all"

_TABLE: dict[str, Any] = tomllib.loads(
    Path(__file__).with_name("options.toml").read_text(encoding="utf-8")
)
COMMANDS: dict[str, str] = {name: parts[0]["summary"] for name, parts in _TABLE["commands"].items()}
"""What each command is for."""


def module_of(command: str) -> str:
    """The module that runs a command."""
    return str(_TABLE["commands"][command][0].get("module", command))


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
        formatter_class=_HelpFormatter,
    )
    # The usual help is that of a parser without the options for experts.
    is_usual_help = not {"-h", "--help"}.isdisjoint(argv)
    parser.add_argument(HELP_ALL, action="help", help="show this help with the expert options")
    if not is_usual_help:
        # The guard around all commands handles this option. It is added here for the help only.
        parser.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)
    add_options(parser, command, with_experts=not is_usual_help)
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


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help formatter that appends default values, unless the help text states them."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        has_value = action.default not in (None, False, "") and action.default not in ([], ())
        if not has_value or "(default:" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


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
