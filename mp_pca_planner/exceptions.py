# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package.

Every error that a user can cause is a :class:`PlannerError`. Its message is one
sentence that names the offender and says what would be accepted; commands print
it without a traceback and the node puts it into its report.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import sysconfig
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path

_PACKAGE = "mp_pca_planner"

MAX_NAMES = 100
"""Names that a message lists."""


class PlannerError(Exception):
    """Base class of all errors raised by this package for refused input."""


class RobotError(PlannerError):
    """A robot description or a robot state that can't be used."""


class RecordingError(PlannerError):
    """A recording (or a part of it) that can't be used."""


class DamagedRecordingError(RecordingError):
    """A recording whose file can't be read, wholly or in part."""


class UnusableRecordingError(RecordingError):
    """Joint states that can't be used, with what was found until then.

    That is: the repairs counted, the topic, its number of messages, the joints they list, and
    notes on how they were read.
    """

    def __init__(
        self,
        reason: str,
        repairs: Mapping[str, int],
        topic: str,
        n_messages: int,
        listed_joints: Iterable[str],
        notes: Iterable[str],
    ) -> None:
        super().__init__(reason)
        self.repairs = dict(repairs)
        self.topic = topic
        self.n_messages = n_messages
        self.listed_joints = tuple(listed_joints)
        self.notes = tuple(notes)


class PrimitiveError(PlannerError):
    """Demonstrations that make no primitive, or a primitive that does not fit its use."""


class PrimitiveFileError(PrimitiveError):
    """A primitive file that can't be read or written."""


class GoalError(PlannerError):
    """A goal that can't be served."""


class TrajectoryError(PlannerError):
    """A trajectory that must not be executed, or that is not well-formed."""


class LimitsError(PlannerError):
    """Limits that are malformed or contradict each other."""


class LearningError(PlannerError):
    """Trials that can't be learned from, or a motion that is not worth keeping."""


class ControlError(PlannerError):
    """A control law, or an assumption on its errors, that can't be used."""


class SimulationError(PlannerError):
    """A simulated robot, or a fault of it, that can't be as it is asked for."""


class MissingDependencyError(PlannerError):
    """An optional dependency that is not installed."""

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the Python module '{module}', which is not installed: "
            f"{_how_to_install(extra)}"
        )
        self.module = module
        self.extra = extra


def _how_to_install(extra: str) -> str:
    """Say how to get what an extra brings, where this Python runs."""
    if extra == "ros":
        # A ROS that is here is better than its wheels, which are for machines without one.
        set_up = sorted(Path("/opt/ros").glob("*/setup.sh"))
        if set_up and "ROS_DISTRO" not in os.environ:
            return f"run `. {set_up[-1]}` first"
    pip = [sys.executable or "python3", "-m", "pip", "install"]
    if sys.prefix == sys.base_prefix and _is_managed():
        # Debian's Python, which a sourced ROS uses, takes packages from elsewhere only this way.
        pip += ["--user", "--break-system-packages"]
    needed = _requirements(extra) or [f"{_source_tree() or _PACKAGE}[{extra}]"]
    return f"run `{shlex.join([*pip, *needed])}` (the extra {_PACKAGE}[{extra}])"


def _is_managed() -> bool:
    """Whether the Python installation refuses packages that pip installs, as PEP 668 has it."""
    return (Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED").exists()


def _source_tree() -> Path | None:
    """The checkout this module belongs to, if it is not installed."""
    folder = Path(__file__).resolve().parents[1]
    return folder if (folder / "setup.py").is_file() else None


def _requirements(extra: str) -> list[str]:
    """What an extra asks for: the package itself need not be where pip finds it by its name."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        all_of_them = requires(_PACKAGE) or []
    except PackageNotFoundError:
        return []
    pairs = [text.partition(";")[::2] for text in all_of_them]
    return [what.strip() for what, when in pairs if re.search(rf"extra == ['\"]{extra}['\"]", when)]


def quote_names(names: Iterable[str]) -> str:
    """List names for a message: ``'a', 'b', 'c'`` (``none`` if there are none); not too many."""
    quoted = [f"'{name}'" for name in names]
    more = f" and {len(quoted) - MAX_NAMES} more" if quoted[MAX_NAMES:] else ""
    return ", ".join(quoted[:MAX_NAMES]) + more or "none"


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> str:
    """Say that a name is unknown, which one may have been meant, and which are valid."""
    names = list(valid)
    close = get_close_matches(name, names, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    return f"no {kind} is called '{name}'{hint}; valid names: {quote_names(names)}"


def printable(text: str) -> str:
    r"""Escape what is not printable, so that foreign text stays on its line.

    Names, notes and keys come from files and messages of others. Line breaks, terminal control
    characters, bidirectional controls and surrogates are shown as Python writes them: ``\n``,
    ``\x1b``, ``\u202e``.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
