# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The primitive file: one .npz of arrays and a JSON string `metadata`."""

from __future__ import annotations

import hashlib
import io
import json
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..arrays import FloatArray
from ..exceptions import PrimitiveFileError
from ..files import write_whole
from .primitive import MovementPrimitive

FORMAT_NAME = "mp_pca_planner/movement_primitive"
FORMAT_VERSION = 1

# What reading a damaged or hostile .npz was seen to raise, or may by its documentation.
_UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    MemoryError,
    SyntaxError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
# No primitive comes near this; a header that claims more is damaged or hostile.
_MAX_BYTES = 1 << 30


def save_primitive(
    primitive: MovementPrimitive, path: str | Path, *, overwrite: bool = False
) -> None:
    """Write a primitive file, whole or not at all.

    The same primitive gives the same bytes.

    Raises
    ------
    PlannerError
        If the file exists and may not be overwritten, or can't be written.
    """
    arrays = primitive.arrays()
    metadata = {
        **primitive.metadata,
        "format": FORMAT_NAME,
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "name": primitive.name,
        "joint_names": list(primitive.joint_names),
        "coupling": primitive.coupling,
    }
    metadata["checksum"] = _checksum(arrays, metadata)
    buffer = io.BytesIO()
    content: dict[str, Any] = {"metadata": np.array(json.dumps(metadata, sort_keys=True))}
    np.savez(buffer, **content, **arrays)  # type: ignore[arg-type]  # its stub takes bool only
    write_whole(path, buffer.getvalue(), overwrite=overwrite)


def load_primitive(path: str | Path) -> MovementPrimitive:
    """Read a primitive file.

    Raises
    ------
    PrimitiveFileError
        If it is no primitive file, of another version, incomplete, or damaged. The message
        names the file and the reason.
    """
    try:
        arrays, metadata = _read(Path(path))
        if metadata.get("format") != FORMAT_NAME:
            raise PrimitiveFileError(
                "it was not made by this package (no 'format' in its metadata)"
            )
        version = metadata.get("format_version")
        if version != FORMAT_VERSION:
            raise PrimitiveFileError(
                f"its format version is {version}, "
                f"this release reads version {FORMAT_VERSION}: build it again"
            )
        missing = [name for name in MovementPrimitive.ARRAYS if name not in arrays]
        if missing:
            raise PrimitiveFileError(f"it lacks the arrays {', '.join(missing)}")
        stated = metadata.pop("checksum", None)
        if stated != _checksum(arrays, metadata):
            raise PrimitiveFileError("its content does not match its checksum: it was damaged")
        return MovementPrimitive.from_arrays(
            metadata.get("name", ""),
            tuple(metadata.get("joint_names", ())),
            metadata.get("coupling", ""),
            arrays,
            metadata,
        )
    except PrimitiveFileError as error:
        raise PrimitiveFileError(f"primitive file '{path}' is refused: {error}") from None


def _read(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                raise PrimitiveFileError("it claims to hold over 1 GiB")
            damaged = archive.testzip()
            if damaged is not None:
                raise PrimitiveFileError(f"its entry '{damaged}' is damaged")
        with np.load(path, allow_pickle=False) as content:
            raw = {name: content[name] for name in content.files}
    except FileNotFoundError:
        raise PrimitiveFileError("there is no such file") from None
    except _UNREADABLE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise PrimitiveFileError(f"it is no readable .npz file ({reason})") from None
    text = raw.pop("metadata", None)
    if text is None or text.dtype.kind != "U" or text.ndim != 0:
        raise PrimitiveFileError("it lacks the string 'metadata'")
    try:
        metadata = json.loads(str(text))
    except ValueError as error:
        raise PrimitiveFileError(f"its metadata is not JSON: {error}") from None
    if not isinstance(metadata, dict):
        raise PrimitiveFileError("its metadata is not a JSON object")
    wrong = [name for name, array in raw.items() if array.dtype != np.float64]
    if wrong:
        raise PrimitiveFileError(f"array '{wrong[0]}' holds {raw[wrong[0]].dtype}, not float64")
    return raw, metadata


def _checksum(arrays: Mapping[str, FloatArray], metadata: Mapping[str, Any]) -> str:
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
