# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The primitive file: one .npz of arrays and a JSON string `metadata`."""

from __future__ import annotations

import hashlib
import json
import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..arrays import FloatArray, check_choice, check_number, unique_names
from ..exceptions import PlannerError, PrimitiveError
from ..files import check_form, open_regular, reading, write_whole
from ..input_limits import INPUT_LIMITS
from .basis import MAX_DEGREE, N_END_CONDITIONS
from .prediction import LENGTHS, ConditionalModel
from .primitive import COUPLINGS, MovementPrimitive
from .timing import PACE_DEGREE

FORMAT_NAME = "mp_pca_planner/movement_primitive"
FORMAT_VERSION = 4

_METADATA = {
    "name": str,
    "joint_names": [str],
    "coupling": str,
    "checksum": str,
    "angle_variance_ratio": {str: [float]},
    "demonstrations": [
        {"recording": str, "label": str, "start_time_s": float, "end_time_s": float}
    ],
    "left_out_error?": (float, type(None)),
    "minimum_jerk_error?": float,
    "prismatic_joints?": [str],
    "refined_from?": dict,
}

_POSITION, _TIME = INPUT_LIMITS.position, INPUT_LIMITS.segment_time
_ANY = 1e15
# Shapes of the arrays, and their least and largest values; equal names denote equal sizes.
_ARRAYS: dict[str, tuple[tuple[str | int, ...], float, float]] = {
    "mean_coefficients": (("joints", "degrees"), -_POSITION, _POSITION),
    "component_coefficients": (("weights", "joints", "degrees"), -_POSITION, _POSITION),
    "explained_variance": (("weights",), 1e-30, _ANY),
    "total_variance": (("joints",), 0.0, _ANY),
    "weights": (("demonstrations", "weights"), -_ANY, _ANY),
    "boundary_states": (("demonstrations", 6, "joints"), -_ANY, _ANY),
    "durations": (("demonstrations",), 1e-9, _TIME),
    "warps": (("demonstrations", "phases"), 0.0, 1.0),
    "fit_residual": (("demonstrations", "joints"), 0.0, _POSITION),
    "requests": (("requests", "entries"), -_POSITION, _POSITION),
    "shape_coefficients": ((len(LENGTHS), 2, "requests", "weights"), -_ANY, _ANY),
    "straight_weights": (("weights",), -_ANY, _ANY),
    "pace_coefficients": ((len(LENGTHS), 2, "requests", "rates"), -_ANY, _ANY),
    "duration_coefficients": ((len(LENGTHS), 2, "requests", 1), -_ANY, _ANY),
    "duration_growth": ((1,), 0.0, 1.0),
    "weight_covariance": (("weights", "weights"), -_ANY, _ANY),
    "error_variance": ((1,), 0.0, _ANY),
    "request_precision": (("entries", "entries"), -_ANY, _ANY),
}
# Least and largest sizes.
_SIZES = (
    ("degrees", N_END_CONDITIONS + 1, MAX_DEGREE + 1),
    ("demonstrations", 1, math.inf),
    ("requests", 1, math.inf),
    ("phases", 2, math.inf),
)


def save_primitive(
    primitive: MovementPrimitive, path: str | Path, *, overwrite: bool = False
) -> None:
    """Write a primitive file atomically; the same primitive gives the same bytes.

    Raises
    ------
    PlannerError
        If its name does not end in .npz, it exists and may not be overwritten, or it can't be
        written.
    """
    if Path(path).suffix != ".npz":
        raise PlannerError(f"the output '{path}' must end in .npz")
    values = vars(primitive.model) | vars(primitive)
    arrays: dict[str, FloatArray] = {name: values[name] for name in _ARRAYS}
    metadata = {
        **primitive.metadata,
        "format": FORMAT_NAME,
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "name": primitive.name,
        "joint_names": list(primitive.joint_names),
        "coupling": primitive.coupling,
    }
    metadata["checksum"] = checksum(arrays, metadata)
    content: dict[str, Any] = {"metadata": np.array(json.dumps(metadata, sort_keys=True)), **arrays}
    write_whole(path, lambda file: np.savez(file, **content), overwrite=overwrite)


def load_primitive(path: str | Path) -> MovementPrimitive:
    """Read a primitive file.

    Raises
    ------
    PrimitiveError
        If it is no primitive file, of another version, incomplete, or damaged. The message
        names the file and the reason.
    """
    try:
        with reading("it", PrimitiveError):
            arrays, text = _read(path)
        with reading("its metadata", PrimitiveError):
            metadata = json.loads(text)
            _check(arrays, metadata)
    except PrimitiveError as error:
        raise PrimitiveError(f"primitive file '{path}' is rejected: {error}") from None
    del metadata["checksum"]
    model = ConditionalModel(**{x.name: arrays.pop(x.name) for x in fields(ConditionalModel)})
    names = tuple(metadata["joint_names"])
    others = {key: arrays[key] for key in _ARRAYS if key in arrays}
    return MovementPrimitive(
        metadata["name"], names, metadata["coupling"], metadata, **others, model=model
    )


def checksum(arrays: Mapping[str, FloatArray], metadata: Mapping[str, Any]) -> str:
    """SHA-256 of the arrays and of the metadata without their checksum."""
    content = {key: value for key, value in metadata.items() if key != "checksum"}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(f"{name}{arrays[name].shape}".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()


def _read(path: str | Path) -> tuple[dict[str, FloatArray], str]:
    """Arrays and metadata of a file."""
    with open_regular(path) as file:
        n_bytes = os.fstat(file.fileno()).st_size
        if not zipfile.is_zipfile(file):
            raise PrimitiveError(
                "it is not a complete .npz file: expected a file that build_primitives made"
            )
        # Arrays are stored without compression: no content is larger than its file.
        claimed = sum(entry.file_size for entry in zipfile.ZipFile(file).infolist())
        if claimed > min(n_bytes, INPUT_LIMITS.primitive_bytes):
            raise PrimitiveError(
                f"it claims to hold {claimed:,} bytes; accepted are at most its size on the disk "
                f"and {INPUT_LIMITS.primitive_bytes:,}"
            )
        file.seek(0)
        content = np.load(file, allow_pickle=False)
        arrays = {name: content[name] for name in content.files}
    text = arrays.pop("metadata", None)
    if text is None or text.dtype.kind != "U" or text.ndim != 0:
        raise PrimitiveError("it lacks the string 'metadata'")
    return arrays, str(text)


def _check(arrays: Mapping[str, FloatArray], metadata: dict[str, Any]) -> None:
    """Reject content that is not that of a primitive file; this is the only check of it."""
    check_form(metadata, {"format": str, "format_version": int}, "it")
    if (metadata["format"], metadata["format_version"]) != (FORMAT_NAME, FORMAT_VERSION):
        raise PrimitiveError(
            f"it is a {metadata['format']:.60} of format version {metadata['format_version']}, "
            f"this release reads version {FORMAT_VERSION} of {FORMAT_NAME}: build it again"
        )
    check_form(metadata, _METADATA, "it")
    check_choice(metadata["coupling"], "its coupling", PrimitiveError, COUPLINGS)
    names = unique_names(metadata["joint_names"], "its joints", PrimitiveError)
    if missing := [name for name in _ARRAYS if name not in arrays]:
        raise PrimitiveError(f"it lacks the arrays {', '.join(missing)}")
    sizes: dict[str | int, int] = {"joints": len(names), "entries": 2 * len(names) + 1}
    sizes |= {"rates": PACE_DEGREE, "demonstrations": len(metadata["demonstrations"])}
    for name, (shape, low, high) in _ARRAYS.items():
        array = arrays[name]
        # The first array with a size decides it.
        sizes = dict(zip(shape, array.shape)) | sizes  # noqa: B905 (numbers of axes may differ)
        expected = tuple(sizes.get(x, x) if isinstance(x, str) else x for x in shape)
        if array.shape != expected or array.dtype != np.float64:
            raise PrimitiveError(
                f"array '{name}' has shape {array.shape} of {array.dtype}, expected {expected} of "
                "float64"
            )
        if wrong := array[~((array >= low) & (array <= high))].tolist():
            raise PrimitiveError(f"array '{name}' holds {wrong[0]:g}, expected {low:g} to {high:g}")
    for key, least, most in _SIZES:
        check_number(sizes[key], f"its number of {key}", PrimitiveError, least, most)
    for name in ("weight_covariance", "request_precision"):
        if np.linalg.eigvalsh(arrays[name]).min(initial=1.0) <= 0.0:
            raise PrimitiveError(f"matrix '{name}' is not positive definite")
    if np.abs(arrays["requests"][:, -1]).max() > math.log(_TIME):
        raise PrimitiveError(f"array 'requests' holds durations that are not up to {_TIME:g} s")
    if metadata["checksum"] != checksum(arrays, metadata):
        raise PrimitiveError("its content does not match its checksum: it was damaged")
