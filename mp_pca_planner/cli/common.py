# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the offline commands share: exit status, messages, progress, parsing of values."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from ..arrays import FloatArray
from ..exceptions import GoalError, PlannerError, RecordingError, unknown_name
from ..files import check_writable
from ..robot.limits import JointLimits, read_limits_file
from .terminal import DEBUG, DEBUG_HELP, OneLineParser, say

if TYPE_CHECKING:
    from ..recordings.load import RecordingSet
    from ..robot.model import Robot

Progress = Callable[[int, int], None]


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Tells the defaults that are values, unless the help tells them itself."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        says_nothing = action.default in (None, False, "") or action.default in ([], ())
        if says_nothing or "(default:" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


class CommandParser(OneLineParser):
    """Argument parser of a command."""

    def __init__(self, command: str, description: str, **options: Any) -> None:
        super().__init__(
            prog=f"mp_pca_planner {command}",
            description=description,
            allow_abbrev=False,
            formatter_class=_HelpFormatter,
            **options,
        )
        # The guard around all commands takes it; here it is for the help.
        self.add_argument(DEBUG, action="store_true", help=DEBUG_HELP)


def run(
    parser: CommandParser, body: Callable[[argparse.Namespace], int], argv: Sequence[str] | None
) -> int:
    """Parse the arguments and run a command's body.

    Returns
    -------
    :
        The exit status: 0 done, 1 failed, 2 refused input or wrong usage.
    """
    return body(parser.parse_args(_with_negative_values(sys.argv[1:] if argv is None else argv)))


def _with_negative_values(argv: Sequence[str]) -> list[str]:
    """Tie lists such as -0.2,0.1 to the option before them: argparse takes them for options."""
    tied: list[str] = []
    for word in argv:
        before = tied[-1] if tied else ""
        if re.match(r"-[\d.]", word) and before.startswith("--") and "=" not in before:
            tied[-1] = f"{before}={word}"
        else:
            tied.append(word)
    return tied


def print_json(content: Any) -> None:
    """Print one JSON object on stdout."""
    say(json_text(content))


def json_text(content: Any) -> str:
    """One JSON object; numbers that JSON does not know become null."""
    return json.dumps(plain(content), allow_nan=False)


def plain(content: Any) -> Any:
    """What JSON knows: lists for arrays, null for numbers that are not finite."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, np.ndarray):
        return plain(content.tolist())
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, np.generic):
        return plain(content.item())
    if isinstance(content, float) and not np.isfinite(content):
        return None
    return content


def no_motion(recordings: RecordingSet) -> RecordingError:
    """Error for recordings of which no motion is left: why not, by the first one's refusal."""
    if not recordings.refused:
        return RecordingError(
            f"no motion was found: {len(recordings.reports)} recordings hold no motion"
        )
    first = recordings.refused[0]
    more = len(recordings.refused) - 1
    return RecordingError(
        f"no motion was found: {first.recording}: {first.reason}"
        + (f" (and {more} more refused)" if more else "")
    )


@contextmanager
def progress_bar(description: str, unit: str) -> Iterator[Progress]:
    """A progress bar on stderr, if that is a terminal; called with (done, total)."""
    with tqdm(
        desc=description,
        unit=unit,
        unit_scale=unit == "B",
        leave=False,
        file=sys.stderr,
        disable=None,
    ) as bar:

        def update(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield update


def check_output(path: Path | None, suffix: str, *, force: bool) -> None:
    """Refuse an output, if there is one, before the work and not after it.

    Raises
    ------
    PlannerError
        If its name doesn't end in `suffix`, or it could not be written.
    """
    if path is None:
        return
    if path.suffix != suffix:
        raise PlannerError(f"the output '{path}' must end in {suffix}")
    check_writable(path, overwrite=force)


def make_folder(path: Path) -> None:
    """Make sure that there is a folder to write into.

    Raises
    ------
    PlannerError
        If there can't be one.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlannerError(f"'{path}' can't be a folder: {error.strerror}") from None


def limits_of(robot: Robot, file: Path | None) -> JointLimits:
    """The limits of a robot, those of a file (of any of its joints) laid over its own."""
    return robot.limits(read_limits_file(file, robot.movable_joints) if file else {})


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Parser of a number from `low` to `high`, for argparse."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            wanted = f"a number from {low:g} to {high:g} {unit}".rstrip()
            raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
        return value

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Parser of a whole number from `low` to `high`, for argparse."""

    def parse(text: str) -> int:
        # Longer texts are out of every range, and slow to read.
        if not (text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


seconds = number(1e-6, 1e6, "s")
"""Parser of a time [s]."""

count = whole(1, 1_000_000)
"""Parser of how many."""

REPORTED = ("status", "effort_cost", "solve_time_s", "duration", "primitive", "in_span_score")
"""Values of the node's report that everybody wants to see."""

JOBS = whole(1, 1024)
"""Parser of how many processes."""

seed = whole(0, 2**63 - 1)
"""Parser of a seed of random numbers."""


def joint_list(text: str) -> list[str]:
    """Names separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"'{text}' holds an empty name; give a,b,c")
    return names


def number_list(text: str, what: str) -> list[float]:
    """Read numbers separated by spaces or commas.

    Raises
    ------
    GoalError
        If there is none, or one is no finite number.
    """
    parts = text.replace(",", " ").split()
    if not parts:
        raise GoalError(f"{what} '{text}' must be numbers, separated by spaces")
    return [_finite(part, f"a number of {what}") for part in parts]


def joint_values(
    text: str, names: Sequence[str], what: str, kind: str = "joint"
) -> dict[str, float]:
    """Read ``name=value,…``, or one value per joint in joint order.

    Raises
    ------
    GoalError
        If a name is unknown or repeated, a value is no finite number, or the number of
        values in a list is not that of the joints.
    """
    parts = [part.strip() for part in text.replace(" ", ",").split(",") if part.strip()]
    named = ["=" in part for part in parts]
    if not parts or any(named) != all(named):
        raise GoalError(
            f"{what} '{text}' must be name=value,… or {len(names)} values in {kind} order"
        )
    if not named[0]:
        if len(parts) != len(names):
            raise GoalError(
                f"{what} has {len(parts)} values, but there are {len(names)} {kind}s: "
                f"{', '.join(names)}"
            )
        parts = [f"{name}={part}" for name, part in zip(names, parts, strict=True)]
    values: dict[str, float] = {}
    for part in parts:
        name, _, number = (piece.strip() for piece in part.partition("="))
        if name not in names:
            raise GoalError(f"{what}: {unknown_name(kind, name, names)}")
        if name in values:
            raise GoalError(f"{what}: {kind} '{name}' is given more than once")
        values[name] = _finite(number, f"{what}: value of {kind} '{name}'")
    return values


class Stop(str):
    """What is given as ``--stop`` among what is given as ``--via``."""


def add_via_options(parser: CommandParser, form: str, what: str) -> None:
    """Add ``--via`` and ``--stop``, in whose order a sequence goes; both are in ``via``."""
    parser.add_argument(
        "--via", action="append", default=[], metavar=form, help=f"{what} to pass, again for each"
    )
    parser.add_argument(
        "--stop",
        action="append",
        dest="via",
        type=Stop,
        metavar=form,
        help="likewise, to stop at on the way",
    )


def split_time(text: str, what: str) -> tuple[str, float | None]:
    """Split ``VALUES@T`` into the values and the time T [s]; None if there is no ``@``.

    Raises
    ------
    GoalError
        If the time is no number, or out of range.
    """
    values, at, moment = text.partition("@")
    try:
        return values, seconds(moment) if at else None
    except argparse.ArgumentTypeError as error:
        raise GoalError(f"{what} '{text}': after @, {error}") from None


def _finite(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise GoalError(f"{what} is '{text}', not a number") from None
    if not np.isfinite(value):
        raise GoalError(f"{what} is '{text}', but only finite numbers are accepted")
    return value


def known(values: Mapping[str, str], names: Sequence[str] | None = None) -> dict[str, str]:
    """Values of a report by name, without those that are unknown or were not asked for.

    Parameters
    ----------
    values : mapping
        The values; "nan" is none.
    names : sequence of str, optional
        Which of them, in this order; by default all.
    """
    chosen = values if names is None else {n: values[n] for n in names if n in values}
    return {name: value for name, value in chosen.items() if value != "nan"}


def short(value: str) -> str:
    """A value with as many digits as one reads."""
    try:
        return value if value.lstrip("-").isdigit() else f"{float(value):.4g}"
    except ValueError:
        return value


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
