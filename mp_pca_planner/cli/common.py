# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""JSON, progress bars and checks of outputs, for all commands."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray, short
from ..exceptions import PlannerError, RobotError, quote_names, unknown_name
from ..files import check_writable, write_whole
from .terminal import say

# Only for type checking: these imports take a second, and some commands need neither.
if TYPE_CHECKING:
    from ..motion.trajectory import Trajectory
    from ..primitives.library import PrimitiveLibrary
    from ..primitives.primitive import MovementPrimitive
    from ..robot.model import Robot

Progress = Callable[[int, int], None]

REPORTED = (
    "status",
    "effort_cost",
    "solve_time_s",
    "duration",
    "primitive",
    "in_span_score",
)
"""Values of the node's report that are printed by default."""


def print_json(content: Any) -> None:
    """Print one JSON object on stdout."""
    say(json_text(content))


def show(
    arguments: argparse.Namespace, facts: Mapping[str, Any], *, hidden: Collection[str] = ()
) -> None:
    """Print the results of a command: one JSON object if ``--json`` was given, else as text.

    Parameters
    ----------
    arguments : Namespace
        The arguments.
    facts : mapping
        The results.
    hidden : collection of str
        Names that the text leaves out.
    """
    if arguments.json:
        print_json(facts)
    else:
        say(*fact_lines({name: x for name, x in facts.items() if name not in hidden}))


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
    """A progress bar on stderr, if that is a terminal; called with (done, total)."""
    from tqdm import tqdm

    bars: list[tqdm[Any]] = []

    def update(done: int, total: int) -> None:
        if not bars:  # before, the total is unknown
            bar = partial(tqdm, unit=unit, unit_scale=unit == "B", leave=False, disable=None)
            bars.append(bar(desc=description, total=total))
        bars[0].total = total
        bars[0].update(done - bars[0].n)

    try:
        yield update
    finally:
        for bar in bars:
            bar.close()


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
    if suffix == ".png":
        from ..plotting.style import require_matplotlib

        require_matplotlib()
    if suffix == ".html":
        from ..plotting.style import require_pages

        require_pages()
    if path.suffix != suffix:
        raise PlannerError(f"the output '{path}' must end in {suffix}")
    check_writable(path, overwrite=force)


def check_motion_file(path: Path | None, *, force: bool) -> None:
    """Reject a motion file that can't be written, before any computation.

    Raises
    ------
    PlannerError
        If its format is unknown, or it could not be written.
    """
    if path is not None:
        from ..recordings.trajectory_files import check_format

        check_format(path)
        check_writable(path, overwrite=force)


def write_motion(
    path: Path | None, trajectory: Trajectory, facts: Mapping[str, Any], *, force: bool
) -> None:
    """Write a motion to the file given by an option; a .json file contains the report.

    Raises
    ------
    PlannerError
        If the file can't be written.
    """
    if path is None:
        return
    if path.suffix == ".json":
        write_whole(path, json_text(facts).encode(), overwrite=force)
    else:
        trajectory.save(path, overwrite=force)


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


def check_frame(frame: str, robot: Robot | None) -> None:
    """Reject the name of a link that the robot lacks; an empty name stands for the end effector.

    Raises
    ------
    RobotError
        If there is no such link, or no robot.
    """
    if frame and robot is None:
        raise RobotError("--frame names a link of --robot: also pass --robot")
    if frame and robot is not None and frame not in robot.frame_names:
        raise RobotError(unknown_name("link", frame, robot.frame_names))


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
            "robot description of the recordings"
        )
    return robot.with_joints(primitives.joint_names)


def usual_ends(ends: FloatArray) -> FloatArray:
    """The start and the goal of the demonstration that starts where most do, of all of them."""
    starts = ends[:, 0]
    usual: FloatArray = ends[np.linalg.norm(starts - np.median(starts, axis=0), axis=1).argmin()]
    return usual


def reported(values: Mapping[str, str]) -> dict[str, str]:
    """The values of the node's report that are printed by default; "nan" marks an unknown one."""
    found = {name: values.get(name, "nan") for name in REPORTED}
    return {name: short(value) for name, value in found.items() if value != "nan"}
