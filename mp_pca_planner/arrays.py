# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Checks and conversions of arrays and names, for all value types."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from html import escape
from math import inf
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import PlannerError, quote_names
from .rows import is_in_file, row_blocks

FloatArray = NDArray[np.float64]


def frozen_array(
    values: ArrayLike, shape: tuple[int | None, ...], what: str, error: type[PlannerError]
) -> FloatArray:
    """Copy values into a read-only, finite float array of a given shape.

    An array in a file is not copied, see :mod:`.rows`.

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
    try:
        is_mapped = is_in_file(values)
        make = np.asarray if is_mapped else np.array
        array = make(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what} must be numbers, got {values!r:.80}") from None
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(n is not None and have != n for have, n in zip(array.shape, shape, strict=True))
    ):
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise error(f"{what} must have the shape {expected}, got {array.shape}")
    if is_mapped:
        is_finite = all(np.isfinite(block).all() for (block,) in row_blocks(array))
    else:
        is_finite = bool(np.isfinite(array).all())
    if not is_finite:
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = f"[{', '.join(map(str, index))}]" if index else ""
        raise error(f"{what}{where} is {array[index]}, but only finite numbers are accepted")
    array.setflags(write=False)
    return array


def check_number(
    value: Any,
    what: str,
    error: type[PlannerError],
    low: float = -inf,
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
    is_kind = isinstance(value, Integral if is_whole else Real) and not isinstance(value, bool)
    if not (is_kind and low <= value <= high):
        word = "a whole number" if is_whole else "a number"
        bounds = f"from {low:g} to {high:g}" if high < inf else f"of at least {low:g}"
        raise error(f"{what} must be {word} {bounds}, got {value!r:.80}")


def check_type(value: object, what: str, error: type[PlannerError], *kinds: Any) -> None:
    """Reject a value that is of none of some types.

    Raises
    ------
    PlannerError
        (as `error`) With the name, the value and the types.
    """
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__.replace("NoneType", "None") for kind in kinds)
        made = [kind.__name__ for kind in kinds if hasattr(kind, "from_file")]
        hint = f" ({made[0]}.from_file reads one)" if made else ""
        article = "an" if names[0] in "AEIO" else "a"
        raise error(f"{what} must be {article} {names}{hint}, got {value!r:.80}")


def unique_names(names: Sequence[str], what: str, error: type[PlannerError]) -> tuple[str, ...]:
    """Return the names as a tuple; reject an empty list, empty names and repetitions."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise error(f"{what}: a list of names is needed, got {names!r:.80}")
    result = tuple(names)
    if not result:
        raise error(f"{what}: at least one is needed, none was given")
    if any(not isinstance(name, str) or not name for name in result):
        raise error(f"{what}: names must be non-empty strings, got {result!r:.80}")
    if repeated := repeated_names(result):
        raise error(f"{what}: {quote_names(repeated)} given more than once")
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


def html_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for notebooks."""
    cells = [[f"<th>{escape(name)}</th>" for name in header]]
    cells += [[f"<td>{escape(value)}</td>" for value in row] for row in rows]
    return "<table>" + "".join(f"<tr>{''.join(row)}</tr>" for row in cells) + "</table>"


@lru_cache(maxsize=64)  # The same few joints are checked often.
def short(value: str) -> str:
    """A value, with four digits if it is a number that is not whole."""
    try:
        return value if value.lstrip("-").isdigit() else f"{float(value):.4g}"
    except ValueError:
        return value
