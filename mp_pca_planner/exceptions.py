# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package.

Every error that a user can cause is a :class:`PlannerError`. Its message is one sentence: the wrong
value and what is accepted. Commands print it without a traceback; the node reports it.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import wraps
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar, cast

_PACKAGE = "mp_pca_planner"
_Function = TypeVar("_Function", bound=Callable[..., Any])


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


class DamagedRecordingError(RecordingError):
    """A recording whose file can't be read, wholly or in part."""


class UnusableRecordingError(RecordingError):
    """A recording that could be read, but not used.

    Attributes
    ----------
    findings : dict
        Repairs until then, and facts on the messages, see
        :class:`.repair.recording.CleanRecording`.
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
        The extra of this package that installs it.
    """

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        # The arguments, from which an error that leaves a worker process is made again.
        super().__init__(module, extra, purpose)
        self.module, self.extra = module, extra

    def __str__(self) -> str:
        module, extra, purpose = self.args
        return (
            f"{purpose} needs the Python module '{module}', which is not installed: "
            f"{_how_to_install(extra)}"
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


def _how_to_install(extra: str) -> str:
    """The command that installs an extra for this Python."""
    if extra == "ros":
        # An installed ROS takes precedence over the wheels, which are for machines without ROS.
        set_up = sorted(Path("/opt/ros").glob("*/setup.sh"))
        if set_up and "ROS_DISTRO" not in os.environ:
            return f"run `. {set_up[-1]}` first"
    pip = [sys.executable or "python3", "-m", "pip", "install"]
    if sys.prefix == sys.base_prefix and _is_managed():
        # A sourced ROS uses Debian's Python, where pip needs these options for other packages.
        pip += ["--user", "--break-system-packages"]
    return f"run `{shlex.join([*pip, *_requirements(extra)])}` (the extra {_PACKAGE}[{extra}])"


def _is_managed() -> bool:
    """Whether the Python installation is externally managed (PEP 668): pip rejects packages."""
    return (Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED").exists()


def _requirements(extra: str) -> list[str]:
    """Packages of an extra, or the checkout with the extra if this package is not installed."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        requirements = requires(_PACKAGE) or []
    except PackageNotFoundError:
        return [f"{Path(__file__).resolve().parents[1]}[{extra}]"]
    pairs = [text.partition(";")[::2] for text in requirements]
    return [what.strip() for what, when in pairs if re.search(rf"extra == ['\"]{extra}['\"]", when)]


def shown(value: object, most: int = 80) -> str:
    """A value as one line of Python text for a message, cut; its type if it has no text."""
    try:
        return printable(" ".join(repr(value)[: 4 * most].split()))[:most]
    except Exception:  # an integer of too many digits, lists nested too deep, methods of others
        return f"a value of type {type(value).__name__}"


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
    valid_names = listed([f"'{one}'" for one in names], most) or "none"
    return f"no {kind} is called '{name:.200}'{hint}; valid names: {valid_names}"


def names_options(error: type[PlannerError]) -> Callable[[_Function], _Function]:
    """Decorator of methods and dataclasses: an unknown keyword gets the nearest valid one.

    Parameters
    ----------
    error :
        Type of the error that is raised in place of a `TypeError`.
    """

    def decorate(function: _Function) -> _Function:
        if isinstance(function, type):
            made: Any = function
            made.__init__ = decorate(made.__init__)
            return function
        kind = f"option of {function.__qualname__.removesuffix('.__init__')}"
        _, *valid = signature(function).parameters  # without self or cls

        @wraps(function)
        def call(*values: Any, **options: Any) -> Any:
            for name in options:
                if name not in valid:
                    raise error(unknown_name(kind, name, valid, 40))
            return function(*values, **options)

        return cast(_Function, call)

    return decorate


def printable(text: str) -> str:
    r"""Escape characters that are not printable, so that external text stays on one line.

    Line breaks, terminal controls, bidirectional controls and surrogates become ``\n``, ``\x1b``,
    ``\u202e``.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
