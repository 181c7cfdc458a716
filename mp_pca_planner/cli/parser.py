# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The parser of a command: its arguments, help and messages."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from inspect import getdoc
from typing import Any

from .terminal import DEBUG, DEBUG_HELP, OneLineParser

ROS_ARGUMENTS = "--ros-args"


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
