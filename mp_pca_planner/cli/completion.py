# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Completion of commands and options in the shell, by argcomplete.

The shell calls the program with these variables after
``eval "$(register-python-argcomplete mp-pca)"``.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from contextlib import suppress

from .options import options_of
from .parser import Options

_IS_ASKED = "_ARGCOMPLETE"


def complete_if_asked(commands: Iterable[str]) -> None:
    """Print completions and exit if the shell asks for them and argcomplete is installed.

    Parameters
    ----------
    commands : iterable of str
        The names of the commands.
    """
    if _IS_ASKED not in os.environ:
        return
    with suppress(ImportError):
        from argcomplete import autocomplete

        parser = argparse.ArgumentParser()
        parsers = parser.add_subparsers()
        for name in commands:
            add_options = options_of(name)
            command = parsers.add_parser(name)
            if add_options is not None:
                add_options(Options(command))
        autocomplete(parser)
