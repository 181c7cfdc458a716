# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Output of the commands in the terminal, and the guard around each command."""

from __future__ import annotations

import argparse
import io
import re
import sys
import traceback
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any, NoReturn

from ..exceptions import PlannerError, printable

PROGRAM = "mp-pca"
DONE, FAILED, REFUSED = 0, 1, 2
DEBUG = "--debug"


class UsageError(PlannerError):
    """Arguments that a command does not accept."""


class Parser(argparse.ArgumentParser):
    """Argument parser that raises its errors, and whose help has most options on one line each."""

    def __init__(self, **options: Any) -> None:
        options.setdefault("formatter_class", lambda prog: argparse.HelpFormatter(prog, 2, 32))
        super().__init__(**options)
        # Lists such as -0.2,0.1 are values, too, not options.
        self._negative_number_matcher = re.compile(r"-[\d.]")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Reject unknown options of a command by name, before options that are missing."""
        self._words = [word.partition("=")[0] for word in args or ()]
        known = self._option_string_actions
        if self._subparsers is None:
            for word in self._words:
                if word.startswith("--") and word != "--" and word not in known:
                    close = get_close_matches(word, known, n=1)
                    hint = f" (did you mean {close[0]}?)" if close else ""
                    self.error(f"there is no option {word}{hint}")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Raise the error; of groups of which one option is needed, argparse names only one."""
        if "arguments are required" in message:
            for group in self._mutually_exclusive_groups:
                names = [name for one in group._group_actions for name in one.option_strings]
                if group.required and names and not set(names) & set(self._words):
                    message += f", {' or '.join(names)}"
        raise UsageError(f"{message} (see --help)")


def say(*lines: str) -> None:
    """Print lines on stdout at once; characters that are not printable are escaped."""
    for line in lines:
        print(printable(line), flush=True)


def complain(text: str) -> None:
    """Print one line on stderr."""
    print(printable(text), file=sys.stderr)


def guard(program: str, command: Callable[[], int], *, debug: bool = False) -> int:
    """Run a command; every error becomes one line on stderr and an exit status.

    Parameters
    ----------
    program :
        Start of the line.
    command :
        Returns the exit status.
    debug :
        Whether the traceback precedes the line.

    Returns
    -------
    :
        The status: the command's own, 2 for refused input, 1 for anything else that it raised,
        such as an answer that didn't come in time.
    """
    for stream in (sys.stdout, sys.stderr):
        # Not every terminal can encode characters such as ° and →.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        try:
            return command()
        finally:  # not every text is flushed as it is printed
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output, such as `head`, has closed it.
        sys.stdout = None
        return FAILED
    except PlannerError as error:
        if debug:
            traceback.print_exc()
        complain(f"{program}: {error}")
        return FAILED if isinstance(error, TimeoutError) else REFUSED
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        kind = type(error).__name__
        text = f"unexpected {kind}: {error} (repeat with {DEBUG} for the traceback)"
        complain(f"{program}: {'interrupted' if kind == 'KeyboardInterrupt' else text}")
        return FAILED
