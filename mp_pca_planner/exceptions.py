# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package.

Every error that a user can cause is a :class:`PlannerError`. Its message is one sentence: the wrong
value and what is accepted. Commands print it without a traceback; the node reports it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any

_PACKAGE = "mp_pca_planner"


class PlannerError(Exception):
    """Base class of all errors of this package for rejected input.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> try:
    ...     mp.Sphere(radius=-1.0)
    ... except mp.PlannerError as error:
    ...     print(error)
    radius of a sphere must be above 0 and at most 1000 m, got -1
    """


class RobotError(PlannerError):
    """A robot description or a robot state that can't be used."""


class WorldError(PlannerError):
    """Obstacles that can't be used."""


class RecordingError(PlannerError):
    """A recording (or a part of it) that can't be used."""


class UnusableRecordingError(RecordingError):
    """A recording that could be read, but not used.

    Attributes
    ----------
    findings : dict
        Repairs until then, and facts on the messages, see
        :class:`.recordings.recording.Recording`.
    """

    def __init__(self, reason: str, findings: Mapping[str, Any]) -> None:
        super().__init__(reason)
        self.findings = dict(findings)


class PrimitiveError(PlannerError):
    """Demonstrations that give no primitive, or a primitive that can't be read or used."""


class GoalError(PlannerError):
    """A goal that can't be served."""


class TrajectoryError(PlannerError):
    """A trajectory that must not be executed, or that is not well-formed."""


class LimitsError(PlannerError):
    """Limits that are malformed or contradict each other."""


class LearningError(PlannerError):
    """Trials that can't be used, or a motion that can't be saved."""


class ControlError(PlannerError):
    """A control law, or an assumption on its errors, that can't be used."""


class MissingDependencyError(PlannerError):
    """An optional dependency that is not installed.

    Attributes
    ----------
    module : str
        The Python module that is missing.
    extra : str
        The extra of this package that installs it; empty for a base dependency.
    """

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        # The arguments, from which an error that leaves a worker process is made again.
        super().__init__(module, extra, purpose)
        self.module, self.extra = module, extra

    def __str__(self) -> str:
        module, extra, purpose = self.args
        return (
            f"{purpose} needs the Python module '{module}', which is not installed: "
            f"{_how_to_install(extra, module)}"
        )


def require(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an optional dependency.

    Raises
    ------
    MissingDependencyError
        If it can't be imported.
    """
    try:
        return import_module(module)
    except ImportError as error:
        # An installed module may itself lack another one.
        missing = error.name if isinstance(error, ModuleNotFoundError) and error.name else module
        raise MissingDependencyError(missing.partition(".")[0], extra, purpose) from None


def _how_to_install(extra: str, module: str) -> str:
    """What installs an extra, or a module without one, for this Python."""
    what = f"{_PACKAGE}[{extra}]" if extra else module
    pip = f"run `{sys.executable or 'python3'} -m pip install '{what}'`"
    return f"source the setup.sh of ROS 2, or {pip}" if extra == "ros" else pip


def shown(value: object, most: int = 80) -> str:
    """A value as one line of Python text for a message, cut."""
    return printable(" ".join(repr(value)[: 4 * most].split()))[:most]


def quote_names(names: Iterable[str]) -> str:
    """Format names as ``'a', 'b', 'c'``, at most a dozen of them, or ``none``."""
    return listed([f"'{name}'" for name in names]) or "none"


def listed(items: Sequence[str], most: int = 12, between: str = ", ") -> str:
    """The first items, at most this number, and how many more there are."""
    more = f" and {len(items) - most} more" if items[most:] else ""
    return between.join(items[:most]) + more


def unknown_name(kind: str, name: object, valid: Iterable[str], most: int = 12) -> str:
    """Message for an unknown name, with the nearest valid name and the first of them."""
    names = list(valid)
    if not isinstance(name, str):
        return f"the name of a {kind} must be a string, got {shown(name)}"
    # Each takes 20 µs, and more for long names.
    close = get_close_matches(name[:200], names[:2000], n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    valid_names = listed([f"'{known}'" for known in names], most) or "none"
    return f"no {kind} is called '{name:.200}'{hint}; valid names: {valid_names}"


def printable(text: str) -> str:
    r"""Escape characters that are not printable, so that external text stays on one line.

    Line breaks, terminal controls, bidirectional controls and surrogates become ``\n``, ``\x1b``,
    ``\u202e``.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
