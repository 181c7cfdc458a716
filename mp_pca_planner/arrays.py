# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Checks and conversions of arrays and names, for all value types."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import inf
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import GoalError, PlannerError, printable, quote_names, shown, unknown_name

FloatArray = NDArray[np.float64]

MAX_SIZE = 1 << 28
"""Largest number of numbers that are made of a recording."""


def frozen_array(
    values: ArrayLike, shape: tuple[int | None, ...], what: str, error: type[PlannerError]
) -> FloatArray:
    """Copy values into a read-only, finite float array of a given shape.

    Parameters
    ----------
    values :
        The values.
    shape :
        The expected shape; ``None`` stands for any length.
    what :
        Name of the array in the message.
    error :
        The error to raise.

    Raises
    ------
    PlannerError
        (as `error`) If the values are not numbers, have another shape or are not finite.
    """
    array = float_array(values, what, error, shape)
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = f"[{', '.join(map(str, index))}]" if index else ""
        raise error(f"{what}{where} is {array[index]}, but only finite numbers are accepted")
    array.setflags(write=False)
    return array


def float_array(
    values: object,
    what: str,
    error: type[PlannerError],
    shape: tuple[int | None, ...] | None = None,
) -> FloatArray:
    """Copy numbers into a float array.

    Text, truth values, dates, complex numbers and masked values are no numbers.

    Parameters
    ----------
    values, what, error
        See :func:`frozen_array`.
    shape :
        The expected shape; any unless given.

    Raises
    ------
    PlannerError
        (as `error`) If the values are not numbers, or have another shape.
    """
    try:
        given = np.asarray(values)
    except (TypeError, ValueError):  # lists of different lengths
        given = np.array("")
    if given.dtype.kind == "O":
        is_numeric = all(map(is_number, given.flat))
    else:
        is_numeric = given.dtype.kind in "iuf" and not isinstance(values, np.ma.MaskedArray)
    if not is_numeric:
        raise error(f"{what} must be numbers, got {shown(values)}")
    fits = shape is None or (
        given.ndim == len(shape)
        and all(n in (None, have) for n, have in zip(shape, given.shape, strict=True))
    )
    if not fits:
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape or ()) + ")"
        raise error(f"{what} must have the shape {expected}, got {given.shape}")
    return np.array(given, dtype=np.float64, order="C")


def is_number(
    value: Any,
    low: float = -sys.float_info.max,
    high: float = sys.float_info.max,
    *,
    is_whole: bool = False,
) -> bool:
    """Whether a value is a real number, or a whole one, from `low` to `high`; no truth value.

    By default, any finite number that a float can represent.
    """
    return (
        isinstance(value, Integral if is_whole else Real)
        and not isinstance(value, bool | np.bool_)
        and bool(low <= float(value) <= high)
    )


def check_number(
    value: Any,
    what: str,
    error: type[PlannerError],
    low: float,
    high: float = inf,
    *,
    is_whole: bool = False,
) -> None:
    """Reject a value that is no number from `low` to `high`, both included.

    Raises
    ------
    PlannerError
        (as `error`) With the name, the value and what is accepted.
    """
    if not is_number(value, low, high, is_whole=is_whole):
        word = "a whole number" if is_whole else "a number"
        bounds = f"from {low:g} to {high:g}" if high < inf else f"of at least {low:g}"
        raise error(f"{what} must be {word} {bounds}, got {shown(value)}")


def check_type(value: object, what: str, error: type[PlannerError], *kinds: Any) -> None:
    """Reject a value that is of none of some types.

    Raises
    ------
    PlannerError
        (as `error`) With the name, the value and the types.
    """
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__.replace("NoneType", "None") for kind in kinds)
        raise error(f"{what} must be of type {names}, got {shown(value)}")


def check_choice(
    value: object, what: str, error: type[PlannerError], choices: Sequence[str]
) -> None:
    """Reject a value that is none of some words.

    Raises
    ------
    PlannerError
        (as `error`) With the name, the value and the words.
    """
    if not (isinstance(value, str) and value in choices):
        raise error(f"{what} must be one of {quote_names(choices)}, got {shown(value)}")


def as_list(values: Any, what: str, error: type[PlannerError]) -> list[Any]:
    """The values of a sequence or another iterable; text and mappings are none.

    Raises
    ------
    PlannerError
        (as `error`) With what is needed, if the values are none.
    """
    is_single = isinstance(values, str | bytes | Mapping) or getattr(values, "ndim", 1) == 0
    if is_single or not isinstance(values, Iterable):
        raise error(f"{what}, got {shown(values)}")
    return list(values)


def unique_names(names: Sequence[str], what: str, error: type[PlannerError]) -> tuple[str, ...]:
    """Return the names as a tuple; reject an empty list, empty names and repetitions."""
    result = tuple(as_list(names, f"{what}: a list of names is needed", error))
    if not result or not all(isinstance(name, str) and name for name in result):
        raise error(f"{what}: non-empty strings are needed, got {shown(result)}")
    if len(set(result)) < len(result):
        raise error(f"{what}: {quote_names(repeated_names(result))} given more than once")
    return result


def repeated_names(names: Iterable[str]) -> list[str]:
    """Those that occur more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def set_frozen(value: object, **attributes: object) -> None:
    """Set attributes of a frozen dataclass in its constructor."""
    for name, attribute in attributes.items():
        object.__setattr__(value, name, attribute)


def by_name(names: Sequence[str], values: FloatArray) -> dict[str, float]:
    """Values, of shape (n_names,), by their names."""
    return dict(zip(names, values.tolist(), strict=True))


def name_values(values: Mapping[str, float]) -> str:
    """Format values as ``a=0.1, b=-1.2``, the form that commands accept."""
    return ", ".join(f"{name}={value:.6g}" for name, value in values.items())


def read_numbers(text: str, what: str) -> list[float]:
    """Read finite numbers separated by spaces or commas, also in square brackets.

    Raises
    ------
    GoalError
        If one is no finite number.
    """
    inner = text.strip()
    inner = inner[1:-1] if inner[:1] == "[" and inner[-1:] == "]" else inner
    numbers = []
    for part in inner.replace(",", " ").split():
        try:
            numbers.append(float(part))
        except ValueError:
            raise GoalError(f"{what} is '{part}', not a number") from None
        if not np.isfinite(numbers[-1]):
            raise GoalError(f"{what} is '{part}', but only finite numbers are accepted")
    return numbers


def read_values(
    text: str, what: str, kind: str, names: Sequence[str] | None = None, default: str = ""
) -> dict[str, float]:
    """Read ``name=value,…``.

    Parameters
    ----------
    text : str
        The values.
    what, kind : str
        What is read, and of what, for messages.
    names : sequence of str, optional
        The names that are accepted; all unless given.
    default : str
        The value of a name alone.

    Raises
    ------
    GoalError
        If a name is unknown or repeated, or a value is no finite number.
    """
    values: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (piece.strip() for piece in part.partition("="))
        if not name or (names is not None and name not in names):
            raise GoalError(f"{what}: {unknown_name(kind, name, names or ())}")
        if name in values:
            raise GoalError(f"{what}: {kind} '{name}' is given more than once")
        numbers = read_numbers(number or default, f"{what}: the value of {kind} '{name}'")
        if len(numbers) != 1:
            raise GoalError(f"{what}: {kind} '{name}' needs a value, as in name=value,…")
        values[name] = numbers[0]
    return values


def text_table(rows: Sequence[Sequence[str]], *, header: Sequence[str]) -> str:
    """Lines of columns, the first aligned left, the others right; unprintable text is escaped."""
    lines = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
