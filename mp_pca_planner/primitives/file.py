# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The primitive file: one .npz of arrays and a JSON string `metadata`."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.lib.npyio import NpzFile

from .. import __version__
from ..arrays import BLOCK, FloatArray, frozen_array, row_blocks
from ..exceptions import PlannerError, PrimitiveError
from ..files import check_form, open_regular, reading, write_whole
from ..input_limits import INPUT_LIMITS
from .in_span import request_precision
from .motion_statistics import MotionSource, MotionSources, MotionStatistics, source_rows, thinned
from .prediction import ConditionalModel
from .primitive import MovementPrimitive
from .primitive_values import ARRAY_SHAPES
from .timing import PACE_DEGREE, fit_paces, reversed_paces

FORMAT_NAME = "mp_pca_planner/movement_primitive"
FORMAT_VERSION = 2

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

# Arrays from which the model of a file of version 1 is fitted anew.
_REFITTED = (
    "mean_coefficients",
    "component_coefficients",
    "weights",
    "boundary_states",
    "durations",
    "warps",
    "straight_weights",
)

# Arrays of the statistics beside those of the primitive; None: any size.
_STATISTICS: dict[str, tuple[int | None, ...]] = {
    "extents": (),
    "paces": (PACE_DEGREE,),
    "shapes": (None, None),
    "shape_remainders": (None,),
    "angles": (None, None),
    "angle_remainders": (None,),
}


def save_primitive(
    primitive: MovementPrimitive, path: str | Path, *, overwrite: bool = False
) -> None:
    """Write a primitive file atomically.

    Raises
    ------
    PlannerError
        If its name does not end in .npz, it exists and may not be overwritten, or it can't be
        written.
    """
    if Path(path).suffix != ".npz":
        raise PlannerError(f"the output '{path}' must end in .npz")
    write_whole(path, partial(write_primitive, primitive), overwrite=overwrite)


def primitive_bytes(primitive: MovementPrimitive) -> bytes:
    """The content of a primitive file, see :func:`write_primitive`."""
    buffer = io.BytesIO()
    write_primitive(primitive, buffer)
    return buffer.getvalue()


def write_primitive(primitive: MovementPrimitive, file: BinaryIO) -> None:
    """Write the content of a primitive file; the same primitive gives the same bytes."""
    arrays, statistics = primitive.arrays(), primitive.statistics
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
    n_letters = sum(map(len, _json_parts(metadata)))
    # As NumPy writes it, but some rows at a time.
    with zipfile.ZipFile(file, "w") as archive:
        with _member(archive, "metadata", f"<U{n_letters}", ()) as member:
            for part in _json_parts(metadata):
                member.write(part.encode("utf-32-le"))
        for name, array in arrays.items():
            with _member(archive, name, "<f8", array.shape) as member:
                for (block,) in row_blocks(array):
                    member.write(block.tobytes())


@contextmanager
def _member(
    archive: zipfile.ZipFile, name: str, descr: str, shape: tuple[int, ...]
) -> Iterator[IO[bytes]]:
    """A member of an .npz file for an array, after its header."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        yield member


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
            return _primitive(arrays, json.loads(text))
    except PrimitiveError as error:
        raise PrimitiveError(f"primitive file '{path}' is rejected: {error}") from None


def _primitive(arrays: dict[str, FloatArray], metadata: dict[str, Any]) -> MovementPrimitive:
    check_form(metadata, {"format_version?": int}, "it")
    if metadata.get("format") != FORMAT_NAME:
        raise PrimitiveError("it was not made by this package (no 'format' in its metadata)")
    version = metadata.get("format_version")
    if version not in (1, FORMAT_VERSION):
        raise PrimitiveError(
            f"its format version is {version}, this release reads versions 1 and {FORMAT_VERSION}: "
            "build it again"
        )
    fitted_anew = {"error_variance"} if version == 1 else set()
    missing = [name for name in ARRAY_SHAPES if name not in arrays.keys() | fitted_anew]
    if missing:
        raise PrimitiveError(f"it lacks the arrays {', '.join(missing)}")
    stated = metadata.pop("checksum", None)
    if stated != checksum(arrays, metadata):
        raise PrimitiveError("its content does not match its checksum: it was damaged")
    check_form(metadata, _METADATA, "it")
    of_model = {field.name for field in fields(ConditionalModel)}
    if version == 1:
        try:
            with np.errstate(all="ignore"):
                model = _model_of_version_1(arrays, metadata)
        except (ValueError, IndexError, np.linalg.LinAlgError):
            raise PrimitiveError("its model can't be fitted anew: build it again") from None
    else:
        model = ConditionalModel(**{key: arrays[key] for key in of_model})
    own: dict[str, Any] = {key: arrays[key] for key in ARRAY_SHAPES if key not in of_model}
    primitive = MovementPrimitive(
        metadata["name"],
        tuple(metadata["joint_names"]),
        metadata["coupling"],
        metadata,
        **own,
        model=model,
    )
    if len(metadata["demonstrations"]) != len(primitive.durations):
        raise PrimitiveError("its metadata must name each of its demonstrations")
    if not set(_STATISTICS) <= set(arrays):
        return primitive
    return replace(primitive, statistics=_statistics(arrays, primitive))


def _model_of_version_1(
    arrays: dict[str, FloatArray], metadata: dict[str, Any]
) -> ConditionalModel:
    """Fit the model anew; the time scalings of the file are replaced by those of its warps."""
    own = {key: arrays[key] for key in ARRAY_SHAPES if key in arrays}
    sizes: dict[str | int, int] = {}
    for name in _REFITTED:
        expected = tuple(x if isinstance(x, int) else sizes.get(x) for x in ARRAY_SHAPES[name])
        frozen_array(own[name], expected, f"array '{name}'", PrimitiveError)
        sizes |= dict(zip(ARRAY_SHAPES[name], own[name].shape, strict=True))
    states, components = own["boundary_states"], own["component_coefficients"]
    paces = arrays["paces"] = fit_paces(own["warps"])
    requests = np.column_stack([states[:, 0], states[:, 3], np.log(own["durations"])])
    used = thinned(requests)
    # Legendre polynomials are alternately even and odd.
    rows = np.concatenate([own["mean_coefficients"][None], components])
    norms = np.sqrt(2.0 * np.arange(rows.shape[2]) + 1.0)
    signs = (-1.0) ** np.arange(rows.shape[2])
    there, back = ((rows * x / norms).reshape(len(rows), -1) for x in (1.0, signs))
    shapes = back[0] + own["weights"][used] @ back[1:]
    weights = np.linalg.lstsq(there[1:].T, shapes.T, rcond=None)[0].T
    straight = own["straight_weights"]
    labels = [metadata["demonstrations"][i]["label"] for i in used]
    return ConditionalModel.fit(
        requests[used],
        np.array([own["weights"][used] - straight, weights]),
        straight,
        np.array([paces, reversed_paces(paces)])[:, used],
        labels,
        request_precision(requests),
    )


def _statistics(arrays: dict[str, FloatArray], primitive: MovementPrimitive) -> MotionStatistics:
    size, joints = len(primitive.durations), (primitive.n_joints,)
    of_joints = ("shapes", "shape_remainders", "angles", "angle_remainders")
    expected = {
        name: (size, *(joints + shape[1:] if name in of_joints else shape))
        for name, shape in _STATISTICS.items()
    }
    return MotionStatistics(
        joint_names=primitive.joint_names,
        durations=primitive.durations,
        boundary_states=primitive.boundary_states,
        warps=primitive.warps,
        sources=source_rows(map(MotionSource.of_facts, primitive.metadata["demonstrations"])),
        **{
            name: frozen_array(arrays[name], shape, f"array '{name}'", PrimitiveError)
            for name, shape in expected.items()
        },
    )


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
    wrong = [name for name, array in raw.items() if array.dtype != np.float64]
    if wrong:
        raise PrimitiveError(f"array '{wrong[0]}' holds {raw[wrong[0]].dtype}, not float64")
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


def checksum(arrays: Mapping[str, FloatArray], metadata: Mapping[str, Any]) -> str:
    """SHA-256 of the arrays and of the metadata without their checksum."""
    digest = hashlib.sha256()
    for part in _json_parts(metadata):
        digest.update(part.encode())
    for name in sorted(arrays):
        digest.update(f"{name}{arrays[name].shape}".encode())
        for (block,) in row_blocks(arrays[name]):
            digest.update(block.tobytes())
    return digest.hexdigest()


def _json_parts(metadata: Mapping[str, Any]) -> Iterator[str]:
    """The text of metadata as JSON with sorted keys, in parts.

    Values with many items are made in blocks.
    """
    before = "{"
    for key in sorted(metadata):
        yield f"{before}{json.dumps(key)}: "
        yield from _value_parts(metadata[key])
        before = ", "
    yield "}"


def _value_parts(value: Any) -> Iterator[str]:
    if not isinstance(value, Mapping | Sequence) or isinstance(value, str):
        yield json.dumps(value)
        return
    is_mapping = isinstance(value, Mapping)
    yield "{" if is_mapping else "["
    for i, text in enumerate(_item_texts(value)):
        yield f", {text}" if i else text
    yield "}" if is_mapping else "]"


def _item_texts(value: Any) -> Iterator[str]:
    """The JSON of some items at a time, without the brackets around them."""
    if isinstance(value, MotionSources):
        yield from value.texts()
        return
    kind: type = dict if isinstance(value, Mapping) else list
    items = iter(sorted(value.items()) if kind is dict else value)
    for block in iter(lambda: kind(islice(items, BLOCK)), kind()):
        yield json.dumps(block, sort_keys=True)[1:-1]
