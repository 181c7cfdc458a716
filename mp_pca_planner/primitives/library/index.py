# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An index of many primitive files: what is needed to choose among them without reading them.

It is kept in a hidden file of the folder. Files that changed since, by size and time, are read
again. An index that can't be read or written is made anew each time.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import PlannerError, PrimitiveError, PrimitiveFileError
from ...files import check_form, load_json, open_regular, reading, write_whole
from ..file import load_primitive
from ..primitive import MovementPrimitive
from ..primitive_values import require_same_joints

INDEX_NAME = ".mp_pca_planner-index"
"""Name of the file."""

_VERSION = 1
_TEXT = {"version": int, "files": [str], "names": [str], "joint_names": [str]}
_ARRAYS = ("stamps", "means", "precisions")


@dataclass(frozen=True, eq=False)
class FileIndex:
    """Names and requests of the primitives of some files.

    Attributes
    ----------
    files : tuple of str
        Names of the files.
    names : tuple of str
        Names of their primitives.
    joint_names : tuple of str
        Joints of all of them.
    stamps : int array, shape (n_files, 2)
        Size [bytes] and time of modification [ns] of the files.
    means, precisions : array
        See :class:`.PrimitiveLibrary`.
    """

    files: tuple[str, ...]
    names: tuple[str, ...]
    joint_names: tuple[str, ...]
    stamps: NDArray[np.int64]
    means: FloatArray
    precisions: FloatArray


def load_unchanged(
    path: Path, name: str, joint_names: tuple[str, ...], stamp: Sequence[int]
) -> MovementPrimitive:
    """Read a file of an index.

    Parameters
    ----------
    path : Path
        The file.
    name, joint_names, stamp
        What the index says of it.

    Raises
    ------
    PrimitiveFileError
        If it can't be read, or has changed since the index was made.
    """
    found = load_primitive(path)
    if (found.name, found.joint_names, _stamp(path)) != (name, joint_names, tuple(stamp)):
        raise PrimitiveFileError(
            f"primitive file '{path}' has changed since its folder was read: read the folder "
            "again (the node: call ~/reload_primitives)"
        )
    return found


def index_files(folder: Path, files: Sequence[str]) -> FileIndex:
    """The index of files of a folder, from the stored one as far as it is up to date.

    Raises
    ------
    PrimitiveError
        If a file is rejected, or two move different joints.
    """
    with reading(f"the folder '{folder}'", PrimitiveError):
        # Joined as text, because paths take twice as long as the system.
        stamps = np.array([_stamp(f"{folder}/{file}") for file in files], dtype=np.int64)
    stored = _stored(folder)
    if stored is None:
        rows = {}
    elif stored.files == tuple(files) and np.array_equal(stored.stamps, stamps):
        return stored
    else:
        rows = _unchanged(stored, dict(zip(files, stamps, strict=True)))
    for file in files:
        if file not in rows:
            found = load_primitive(folder / file)
            requests = found.model.mean, found.model.request_precision
            rows[file] = (found.joint_names, found.name, *requests)
        require_same_joints((f"'{folder / x}'", rows[x][0]) for x in (files[0], file))
    joints, names, means, precisions = zip(*(rows[file] for file in files), strict=True)
    index = FileIndex(tuple(files), names, joints[0], stamps, np.array(means), np.array(precisions))
    with suppress(PlannerError):  # of a folder that may not be changed
        write_whole(folder / INDEX_NAME, _content(index), overwrite=True)
    return index


def _unchanged(stored: FileIndex, stamps: Mapping[str, NDArray[np.int64]]) -> dict[str, Any]:
    """Joints, name and requests by file, of those that have not changed."""
    return {
        file: (stored.joint_names, stored.names[i], stored.means[i], stored.precisions[i])
        for i, file in enumerate(stored.files)
        if file in stamps and np.array_equal(stored.stamps[i], stamps[file])
    }


def _stamp(file: str | Path) -> tuple[int, int]:
    status = os.stat(file)
    return status.st_size, status.st_mtime_ns


def _content(index: FileIndex) -> bytes:
    text = {"version": _VERSION}
    text |= {key: getattr(index, key) for key in _TEXT if key not in text}
    arrays: dict[str, Any] = {key: getattr(index, key) for key in _ARRAYS}
    buffer = io.BytesIO()
    np.savez(buffer, text=np.frombuffer(json.dumps(text).encode(), dtype=np.uint8), **arrays)
    return buffer.getvalue()


def _stored(folder: Path) -> FileIndex | None:
    """The stored index; None if there is none that can be used."""
    try:
        with reading("the index", PrimitiveError):
            with (
                open_regular(folder / INDEX_NAME) as file,
                np.load(file, allow_pickle=False) as content,
            ):
                text = load_json(content["text"].tobytes())
                arrays = [content[key] for key in _ARRAYS]
            check_form(text, _TEXT, "it")
            return _index(text, *arrays)
    except PlannerError:
        return None


def _index(
    text: Mapping[str, Any], stamps: NDArray[np.int64], means: FloatArray, precisions: FloatArray
) -> FileIndex | None:
    """The index with this content; None if it has another form."""
    n, size = len(text["files"]), 2 * len(text["joint_names"]) + 1
    found = [(array.dtype.str, array.shape) for array in (stamps, means, precisions)]
    expected = [("<i8", (n, 2)), ("<f8", (n, size)), ("<f8", (n, size, size))]
    is_usable = (text["version"], len(text["names"]), found) == (_VERSION, n, expected)
    if not (is_usable and np.isfinite(means).all() and np.isfinite(precisions).all()):
        return None
    files, names, joint_names = (tuple(text[key]) for key in ("files", "names", "joint_names"))
    return FileIndex(files, names, joint_names, stamps, means, precisions)
