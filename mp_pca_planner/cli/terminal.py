# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Output of the commands in the terminal, and the guard around each command."""

from __future__ import annotations

import argparse
import errno
import io
import re
import sys
import traceback
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NoReturn

from ..exceptions import PlannerError, printable

PROGRAM = "mp-pca"
DONE, FAILED, REFUSED = 0, 1, 2
DEBUG = "--debug"
DEBUG_HELP = "print the traceback of an error"

# Errors of a full disk.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class HelpFormatter(argparse.HelpFormatter):
    """Help with most options on one line each."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32)


class OneLineParser(argparse.ArgumentParser):
    """Argument parser whose errors are one line on stderr, with exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": HelpFormatter, **options})
        # Lists such as -0.2,0.1 are values, too, not options.
        self._negative_number_matcher = re.compile(r"-[\d.]")
        self._words: list[str] = []

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse arguments, which :meth:`error` looks at."""
        self._words = list(args or ())
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print the error and exit."""
        if any(_is_number(one) and _is_number(next_one) for one, next_one in pairwise(self._words)):
            message = f"put quotes around the numbers of a pose, as in '0.4 0.1 0.6': {message}"
        complain(f"{self.prog}: {message} (see --help)")
        sys.exit(REFUSED)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", text) is not None


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
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        if isinstance(error, OSError) and error.errno in _FULL:
            # Otherwise Python would write the rest at its exit, and fail again.
            sys.stdout = None
        complain(f"{program}: {_reason(error)}")
        is_refused = isinstance(error, PlannerError) and not isinstance(error, TimeoutError)
        return REFUSED if is_refused else FAILED


def _reason(error: BaseException) -> str:
    """The cause of an error, in one sentence."""
    if isinstance(error, PlannerError):
        return str(error)
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this ({error or 'MemoryError'})"
    if isinstance(error, ImportError):
        return f"the installation is incomplete: {error}"
    if isinstance(error, OSError):
        named = f"'{error.filename}'" if error.filename else "input or output failed"
        what = "the output can't be written" if error.errno in _FULL else named
        return f"{what}: {error.strerror or error}"
    kind = type(error).__name__
    return f"internal error, {kind}: {error} (repeat with {DEBUG} for the traceback)"
