# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""JSON, progress bars and checks of outputs, for all commands."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, RobotError, quote_names, require
from ..files import check_writable
from .terminal import say

# Only for type checking: these imports take a second, and some commands need neither.
if TYPE_CHECKING:
    from ..primitives.library import PrimitiveLibrary
    from ..primitives.primitive import MovementPrimitive
    from ..robot.model import Robot

Progress = Callable[[int, int], None]


def print_json(content: Any) -> None:
    """Print one JSON object on stdout."""
    say(json_text(content))


def show(
    arguments: argparse.Namespace, facts: Mapping[str, Any], shown: Collection[str] = ()
) -> None:
    """Print the results of a command: one JSON object if ``--json`` was given, else as text.

    Parameters
    ----------
    arguments : Namespace
        The arguments.
    facts : mapping
        The results.
    shown : collection of str
        Names that the text has; all unless given.
    """
    if arguments.json:
        print_json(facts)
    else:
        say(*fact_lines({name: x for name, x in facts.items() if name in (shown or facts)}))


def fact_lines(facts: Mapping[str, Any], most: int = 12) -> list[str]:
    """Results as text: a line for each name; unknown values and long lists are left out."""
    width, lines = max(map(len, facts), default=0), []
    for name, value in plain(dict(facts)).items():
        if isinstance(value, list) and any(isinstance(one, str | dict) for one in value):
            are_names = all(isinstance(one, str) and not set(one) & {" ", "/"} for one in value)
            rows = [", ".join(value)] if are_names else [*map(_fact, value)]
        elif value in (None, "", [], {}) or (isinstance(value, list) and len(value) > most):
            continue
        else:
            rows = [_fact(value)]
        lines += [f"{name:<{width}}  {row}" for row in rows]
    return lines


def primitive_lines(path: str | Path, primitive: MovementPrimitive) -> list[str]:
    """What a primitive is, as text for people."""
    explained = []
    for name, shares in primitive.explained_variance_ratio.items():
        whose = "" if primitive.coupling == "arm" else f" of '{name}'"
        texts = ", ".join(f"{100.0 * share:.1f}" for share in shares)
        explained += [f"  components{whose} explain {texts} % of the variance"] if texts else []
    head, *others = str(primitive).splitlines()
    return [f"{path}: {head}", *explained, *others]


def _fact(value: Any) -> str:
    """A value as text: numbers with four digits, and what a container holds on one line."""
    if isinstance(value, dict):
        parts = ((name, _fact(one)) for name, one in value.items())
        return ", ".join(f"{name}={one}" for name, one in parts if one)
    if isinstance(value, list):
        return " ".join(map(_fact, value))
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: ""}[value]
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def json_text(content: Any) -> str:
    """One JSON object; numbers that JSON does not know become null."""
    return json.dumps(plain(content), allow_nan=False)


def plain(content: Any) -> Any:
    """Convert to JSON types: lists for arrays, null for numbers that are not finite."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, np.ndarray | np.generic):
        return plain(content.tolist())
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return str(content) if isinstance(content, Path) else content


@contextmanager
def progress_bar(description: str, unit: str) -> Iterator[Progress]:
    """A progress bar on stderr, if that is a terminal; called with (done, total).

    It appears after a second.
    """
    from tqdm import tqdm

    shown: dict[str, Any] = {"unit": unit, "unit_scale": unit == "B", "delay": 1.0}
    with tqdm(desc=description, leave=False, disable=None, **shown) as bar:

        def update(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield update


def check_output(path: Path | None, suffix: str, *, force: bool) -> None:
    """Reject an output that can't be written, before any computation.

    Raises
    ------
    PlannerError
        If its name doesn't end in `suffix`, it could not be written, or the package that draws it
        is missing.
    """
    if path is None:
        return
    if suffix in (".png", ".html"):
        require("matplotlib.figure", "plot", "drawing a picture")
    if suffix == ".html":
        require("jinja2", "plot", "making a page")
    if path.suffix != suffix:
        raise PlannerError(f"the output '{path}' must end in {suffix}")
    check_writable(path, overwrite=force)


def make_folder(path: Path) -> None:
    """Make a folder, unless it exists.

    Raises
    ------
    PlannerError
        If it can't be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlannerError(f"'{path}' can't be a folder: {error.strerror}") from None


def robot_of(file: Path, primitives: PrimitiveLibrary) -> Robot:
    """The robot of a URDF file that moves the joints of primitives.

    Raises
    ------
    RobotError
        If the file can't be read, or the robot lacks some of these joints.
    """
    from ..robot.model import Robot

    robot = Robot.from_file(file)
    known = robot.movable_joints
    if missing := [name for name in primitives.joint_names if name not in known]:
        raise RobotError(
            f"{quote_names(primitives.names)} was learned for another robot: its joints "
            f"{quote_names(missing)} are not in '{file}', which has {quote_names(known)}; pass the "
            "robot description of the recordings, or build it with --robot"
        )
    return robot.with_joints(primitives.joint_names)


def usual_ends(ends: FloatArray) -> FloatArray:
    """The start and the goal of the demonstration that starts where most do, of all of them."""
    starts = ends[:, 0]
    usual: FloatArray = ends[np.linalg.norm(starts - np.median(starts, axis=0), axis=1).argmin()]
    return usual
