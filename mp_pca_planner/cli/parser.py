# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The parser of a command: types of its arguments, options of several commands, help, messages."""

from __future__ import annotations

import argparse
import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from inspect import getdoc
from typing import Any

from .terminal import DEBUG, DEBUG_HELP, OneLineParser

ROS_ARGUMENTS = "--ros-args"
NODE = "mp_pca_planner"
"""Name of the planner's node."""


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Type of numbers from `low` to `high`."""

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
    """Type of whole numbers from `low` to `high`."""

    def parse(text: str) -> int:
        # Longer numbers exceed every bound and are slow to convert.
        if not (text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            raise ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


seconds = number(1e-6, 1e6, "s")
"""Type of times [s]."""

count = whole(1, 1_000_000)
"""Type of counts."""

jobs = whole(1, 1024)
"""Type of numbers of processes."""

seed = whole(0, 2**63 - 1)
"""Type of seeds of random numbers."""


def duration(text: str) -> str | float:
    """Read a duration [s], or one of the words for a duration that the planner chooses."""
    if text in ("shortest", "free"):
        return text
    try:
        return number(1e-3, 600.0, "s")(text)
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"{error}, 'shortest' or 'free'") from None


def name_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


class Stop(str):
    """A value of ``--stop`` among those of ``--via``."""


class Options:
    """Adds options to a parser, or to a group of its options; called with one at a time."""

    def __init__(self, target: argparse._ActionsContainer) -> None:
        self._target = target

    def __call__(
        self,
        option: str,
        text: str,
        kind: Callable[[str], Any] = str,
        default: Any = None,
        **more: Any,
    ) -> None:
        """Add an option or a positional argument.

        Parameters
        ----------
        option : str
            Its names, or the name of the argument, and the placeholder of the value:
            ``--limits FILE.yaml``.
        text : str
            The help.
        kind : callable, optional
            Reads the value.
        default : object
            The default.
        **more
            Further arguments of :meth:`argparse.ArgumentParser.add_argument`.
        """
        words = option.split()
        names = [word for word in words if word.startswith("-")] or words[:1]
        if len(words) > len(names):
            more["metavar"] = " ".join(words[len(names) :])
        self._target.add_argument(*names, help=text, type=kind, default=default, **more)

    def flag(self, names: str, text: str) -> None:
        """Add an option without a value."""
        self._target.add_argument(*names.split(), action="store_true", help=text)

    def group(self, title: str, description: str | None = None) -> Options:
        """Options under a title of their own."""
        return Options(self._target.add_argument_group(title, description))

    def one_of(self, *, required: bool = False) -> Options:
        """Options that exclude each other."""
        return Options(self._target.add_mutually_exclusive_group(required=required))

    def report(self, written: str | None = "files") -> None:
        """Add ``--json`` and, for files that are written, ``--force``."""
        if written is not None:
            self.flag("--force", f"overwrite {written}")
        self.flag("--json", "print one JSON object")

    def node(self) -> None:
        """Add the name and the namespace of the planner's node."""
        self("--node NAME", "name of the node", default=NODE)
        self("--namespace NS", "namespace of the node", default="")

    def via(self, form: str, text: str, *, with_stops: bool = False) -> None:
        """Add ``--via`` and ``--stop``; the values of both stand in order in ``via``."""
        self(f"--via {form}", f"{text}; may be repeated", str, [], action="append")
        if with_stops:
            text = "likewise, with a stop there"
            self(f"--stop {form}", text, Stop, [], action="append", dest="via")

    def preset(self, **values: Any) -> None:
        """Set values that are no options of the command."""
        self._target.set_defaults(**values)


def parse_command(
    command: str, add_options: Callable[[Options], None], argv: Sequence[str]
) -> argparse.Namespace:
    """Parse the arguments of a command; prints a message and exits if they are wrong.

    Parameters
    ----------
    command : str
        Its name.
    add_options : callable
        Declares its options; the docstring describes the command.
    argv : sequence of str
        The arguments.

    Returns
    -------
    :
        The values, with the name of the command and, for `simulate`, the arguments for ROS.
    """
    parser = OneLineParser(
        prog=f"mp_pca_planner {command}",
        description=getdoc(add_options),
        allow_abbrev=False,
        formatter_class=_HelpFormatter,
    )
    # The guard around all commands handles this option. It is added here for the help only.
    parser.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)
    add_options(Options(parser))
    has_ros_arguments = command == "simulate" and ROS_ARGUMENTS in argv
    cut = argv.index(ROS_ARGUMENTS) if has_ros_arguments else len(argv)
    given = argparse.Namespace(command=command, ros_arguments=list(argv[cut:]))
    return parser.parse_args(_with_negative_values(argv[:cut]), given)


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
