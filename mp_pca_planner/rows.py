# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays of many rows, in temporary files, so that their number takes no memory.

Such an array is a memory map: the system reads its pages when they are used. They count as memory
of the process until they are released, so many rows are processed in blocks.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .exceptions import PlannerError

Floats = NDArray[np.float64]

BLOCK = 512
"""Rows that are processed at a time."""

# Arrays that take less memory together are no files [bytes].
_LEAST_IN_FILE = 1 << 17


def empty_rows(
    n_rows: int, kinds: Mapping[str, tuple[DTypeLike, tuple[int, ...]]]
) -> dict[str, NDArray[Any]]:
    """Arrays to be filled.

    Parameters
    ----------
    n_rows : int
        Rows of each array.
    kinds : mapping of str to pair
        Data type and shape of a row of each.

    Raises
    ------
    PlannerError
        If there is no space for them.
    """
    n_bytes = n_rows * sum(np.dtype(x).itemsize * prod(shape) for x, shape in kinds.values())
    if n_bytes < _LEAST_IN_FILE:
        return {name: np.empty((n_rows, *shape), x) for name, (x, shape) in kinds.items()}
    with tempfile.TemporaryFile(prefix="mp_pca_planner-") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, n_bytes)
        except OSError as error:
            raise PlannerError(
                f"{n_bytes >> 20} MiB don't fit into '{tempfile.gettempdir()}' "
                f"({error.strerror}): set TMPDIR to a folder with more space"
            ) from None
        content, offset = mmap.mmap(file.fileno(), n_bytes), 0
    arrays = {}
    for name, (x, shape) in kinds.items():
        arrays[name] = np.ndarray((n_rows, *shape), x, content, offset)
        offset += arrays[name].nbytes
    return arrays


def row_blocks(*arrays: NDArray[Any]) -> Iterator[tuple[NDArray[Any], ...]]:
    """Some rows of all arrays at a time; those in files take memory for these rows only."""
    for first in range(0, len(arrays[0]), BLOCK):
        yield tuple(array[first : first + BLOCK] for array in arrays)
        for array in arrays:
            release(array)


def row_mean(array: Floats) -> Floats:
    """Mean of the rows."""
    total = np.zeros(array.shape[1:])
    for (block,) in row_blocks(array):
        total += block.sum(axis=0)
    return total / len(array)


def release(array: NDArray[Any]) -> None:
    """Take no more memory for an array in a file, until it is used again."""
    mapped = file_of(array)
    if mapped is not None:
        mapped.madvise(mmap.MADV_DONTNEED)


def file_of(array: object) -> mmap.mmap | None:
    """The file that an array is in, if it is in one."""
    while isinstance(array, np.ndarray):
        array = array.base
    if isinstance(array, memoryview):
        array = array.obj
    return array if isinstance(array, mmap.mmap) else None
