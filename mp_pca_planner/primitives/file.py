# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The primitive file: one .npz of arrays and a JSON string `metadata`."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.npyio import NpzFile

from .. import __version__
from ..arrays import FloatArray
from ..exceptions import PlannerError, PrimitiveError
from ..files import check_form, open_regular, reading, write_whole
from ..input_limits import INPUT_LIMITS
from .motion_statistics import MotionSource, MotionStatistics
from .prediction import ConditionalModel
from .primitive import COUPLINGS, MovementPrimitive
from .timing import PACE_DEGREE

FORMAT_NAME = "mp_pca_planner/movement_primitive"
FORMAT_VERSION = 3

_METADATA = {
    "name": str,
    "joint_names": [str],
    "coupling": str,
    "angle_variance_ratio": {str: [float]},
    "demonstrations": [
        {
            "recording": str,
            "label": str,
            "start_time_s": float,
            "end_time_s": float,
            "checksum?": str,
        }
    ],
    "prismatic_joints?": [str],
    "refined_from?": dict,
}

# Shapes of the arrays of a primitive and of its model; equal names denote equal sizes.
_ARRAYS: dict[str, tuple[str | int, ...]] = {
    "mean_coefficients": ("joints", "degrees"),
    "component_coefficients": ("weights", "joints", "degrees"),
    "explained_variance": ("weights",),
    "total_variance": ("joints",),
    "weights": ("demonstrations", "weights"),
    "boundary_states": ("demonstrations", 6, "joints"),
    "durations": ("demonstrations",),
    "warps": ("demonstrations", "phases"),
    "fit_residual": ("demonstrations", "joints"),
    "requests": ("requests", "entries"),
    "shape_coefficients": ("fits", 2, "requests", "weights"),
    "straight_weights": ("weights",),
    "pace_coefficients": ("fits", 2, "requests", "rates"),
    "duration_coefficients": (1, 2, "requests", 1),
    "weight_covariance": ("weights", "weights"),
    "weight_precision": ("weights", "weights"),
    "error_variance": (1,),
    "request_precision": ("entries", "entries"),
}
# Those of its statistics beside them, which refined primitives don't have.
_STATISTICS: dict[str, tuple[str | int, ...]] = {
    "extents": ("demonstrations",),
    "paces": ("demonstrations", "rates"),
    "shapes": ("demonstrations", "joints", "functions"),
    "shape_remainders": ("demonstrations", "joints"),
    "angles": ("demonstrations", "joints", "angle functions"),
    "angle_remainders": ("demonstrations", "joints"),
}


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
    arrays, statistics = _arrays_of(primitive), primitive.statistics
    if statistics is not None:
        arrays |= {name: getattr(statistics, name) for name in _STATISTICS}
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
            return _primitive(arrays, metadata)
    except PrimitiveError as error:
        raise PrimitiveError(f"primitive file '{path}' is rejected: {error}") from None


def checksum(arrays: Mapping[str, FloatArray], metadata: Mapping[str, Any]) -> str:
    """SHA-256 of the arrays and of the metadata without their checksum."""
    content = {key: value for key, value in metadata.items() if key != "checksum"}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(f"{name}{arrays[name].shape}".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()


def _arrays_of(primitive: MovementPrimitive) -> dict[str, FloatArray]:
    owners = {name: primitive if hasattr(primitive, name) else primitive.model for name in _ARRAYS}
    return {name: getattr(owner, name) for name, owner in owners.items()}


def _read(path: str | Path) -> tuple[dict[str, FloatArray], str]:
    """Arrays and metadata of a file."""
    with open_regular(path) as file:
        file.read(1)  # a file that can't be read is not damaged
        file.seek(0)
        with _archive(file) as content:
            entries = content.zip.infolist() if content.zip else []
            most = INPUT_LIMITS.primitive_bytes
            if sum(int(entry.file_size) for entry in entries) > most:
                raise PrimitiveError(f"it claims to hold over {most >> 20} MiB")
            raw = {name: content[name] for name in content.files}
    text = raw.pop("metadata", None)
    if text is None or text.dtype.kind != "U" or text.ndim != 0:
        raise PrimitiveError("it lacks the string 'metadata'")
    return raw, str(text)


def _archive(file: BinaryIO) -> NpzFile:
    try:
        content = np.load(file, allow_pickle=False)
    except (zipfile.BadZipFile, EOFError, ValueError):
        content = None
    if not isinstance(content, NpzFile):
        raise PrimitiveError(
            "it is not a complete .npz file: expected a file that build_primitives made"
        )
    return content


def _check(arrays: Mapping[str, FloatArray], metadata: dict[str, Any]) -> None:
    """Reject content that is not that of a primitive file; this is the only check of it."""
    check_form(metadata, {"format_version?": int}, "it")
    if metadata.get("format") != FORMAT_NAME:
        raise PrimitiveError("it was not made by this package (no 'format' in its metadata)")
    version = metadata.get("format_version")
    if version != FORMAT_VERSION:
        raise PrimitiveError(
            f"its format version is {version}, this release reads version {FORMAT_VERSION}: build "
            "it again"
        )
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise PrimitiveError(f"it lacks the arrays {', '.join(missing)}")
    check_form(metadata, {**_METADATA, "checksum": str}, "it")
    names, couplings = metadata["joint_names"], " or ".join(COUPLINGS)
    if metadata["coupling"] not in COUPLINGS:
        raise PrimitiveError(f"its coupling is '{metadata['coupling']}', expected {couplings}")
    if not names or len(set(names)) < len(names) or not all([metadata["name"], *names]):
        raise PrimitiveError("it and its joints need names that differ")
    sizes: dict[str | int, int] = {"joints": len(names), "entries": 2 * len(names) + 1}
    sizes |= {"rates": PACE_DEGREE, "demonstrations": len(metadata["demonstrations"])}
    sizes |= {1: 1, 2: 2, 6: 6}  # numbers denote themselves
    for name, shape in (_ARRAYS | _STATISTICS).items():
        if name not in arrays:
            continue
        array, expected = arrays[name], tuple(sizes.get(x) for x in shape)
        fits = len(array.shape) == len(expected) and all(
            x in (y, None) for x, y in zip(expected, array.shape, strict=True)
        )
        if not fits or array.dtype != np.float64:
            raise PrimitiveError(
                f"array '{name}' has shape {array.shape} of {array.dtype}, expected {expected} of "
                "float64"
            )
        if not np.isfinite(array).all():
            raise PrimitiveError(f"array '{name}' holds a number that is not finite")
        sizes |= dict(zip(shape, array.shape, strict=True))
    if metadata["checksum"] != checksum(arrays, metadata):
        raise PrimitiveError("its content does not match its checksum: it was damaged")
    is_usable = sizes["demonstrations"] > 0 and np.all(arrays["durations"] > 0.0)
    if not is_usable or sizes["requests"] == 0:
        raise PrimitiveError("it needs at least one demonstration, and each must last > 0 s")


def _primitive(arrays: Mapping[str, FloatArray], metadata: dict[str, Any]) -> MovementPrimitive:
    of_model = {field.name for field in fields(ConditionalModel)}
    own: dict[str, Any] = {name: arrays[name] for name in _ARRAYS if name not in of_model}
    joint_names, statistics = tuple(metadata["joint_names"]), None
    if set(_STATISTICS) <= set(arrays):
        statistics = MotionStatistics(
            joint_names=joint_names,
            durations=arrays["durations"],
            boundary_states=arrays["boundary_states"],
            warps=arrays["warps"],
            sources=tuple(map(MotionSource.of_facts, metadata["demonstrations"])),
            **{name: arrays[name] for name in _STATISTICS},
        )
    del metadata["checksum"]
    return MovementPrimitive(
        metadata["name"],
        joint_names,
        metadata["coupling"],
        metadata,
        **own,
        model=ConditionalModel(**{name: arrays[name] for name in of_model}),
        statistics=statistics,
    )
