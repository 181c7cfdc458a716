# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the markers of a recording sit on the robot or person: the YAML file that says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, frozen_array
from ..exceptions import RecordingError, unknown_name
from ..files import MAX_YAML_BYTES, load_yaml, read_text, reading

BaseMotion = Literal["moving", "fixed", "identity"]
BASE_MOTIONS: tuple[BaseMotion, ...] = get_args(BaseMotion)
"""How the root link moves in the frame that markers are recorded in: its pose is fitted to the
markers on it frame by frame, once for the recording, or it is that frame."""

OriginFit = Literal["position", "length"]
ORIGIN_FITS: tuple[OriginFit, ...] = get_args(OriginFit)
"""What is fitted of a joint's origin in its parent link: all of it, or its distance only."""

_KEYS = ("base", "fit_origins", "markers")
_MARKER_KEYS = ("link", "position", "weight", "body", "offset")


@dataclass(frozen=True, eq=False)
class MarkerPlacement:
    """A marker on a link.

    Attributes
    ----------
    name : str
        How reports call it.
    link : str
        The link it sits on.
    position : array, shape (3,)
        Where, in the link's frame [m].
    weight : float
        How much its squared distance counts, 1 unless given.
    body : str
        What it is called in the recording; its own name unless given.
    offset : array, shape (3,)
        The point that is meant, in the recorded body's own frame [m]; a body that is recorded
        with its orientation gives as many markers as are wanted.
    """

    name: str
    link: str
    position: FloatArray
    weight: float
    body: str
    offset: FloatArray

    def __init__(
        self,
        name: str,
        link: str,
        position: ArrayLike,
        *,
        weight: float = 1.0,
        body: str | None = None,
        offset: ArrayLike = (0.0, 0.0, 0.0),
        where: str = "marker map",
    ) -> None:
        what = f"{where}: %s of marker '{name}'"
        number = float(frozen_array(weight, (), what % "weight", RecordingError))
        if number <= 0.0:
            raise RecordingError(f"{what % 'weight'} is {number:g}, but it must be positive")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "link", link)
        object.__setattr__(self, "weight", number)
        object.__setattr__(self, "body", name if body is None else body)
        for field, values in (("position", position), ("offset", offset)):
            array = frozen_array(values, (3,), what % field, RecordingError)
            object.__setattr__(self, field, array)


@dataclass(frozen=True)
class MarkerMap:
    """All markers, and what of the model is fitted to the recording.

    Attributes
    ----------
    markers : tuple of MarkerPlacement
        The markers.
    base : str
        How the root link moves, see :data:`BASE_MOTIONS`.
    fit_origins : mapping
        Joints whose origin in the parent link is fitted to each recording, so that one model
        serves people (or calibrations) that differ, see :data:`ORIGIN_FITS`.
    source : str
        How messages call the map.
    """

    markers: tuple[MarkerPlacement, ...]
    base: BaseMotion
    fit_origins: Mapping[str, OriginFit]
    source: str = "marker map"


def read_marker_map(path: str | Path) -> MarkerMap:
    """Read a marker map from a YAML file.

    The file holds ``markers: {NAME: {link: LINK, position: [x, y, z]}}`` with the optional keys
    ``weight``, ``body`` and ``offset`` for each marker, and optionally ``base`` and
    ``fit_origins: {JOINT: position | length}``; see the classes of this module.

    Raises
    ------
    RecordingError
        If the file can't be read or says something else.
    """
    where = f"marker map '{path}'"
    with reading(f"the {where}", RecordingError):
        content = load_yaml(read_text(path, MAX_YAML_BYTES))
        if not isinstance(content, dict) or not isinstance(content.get("markers"), dict):
            raise RecordingError(
                f"the {where} must hold a mapping 'markers' from names to links and positions"
            )
        _refuse_unknown(content, "key", _KEYS, where)
        return MarkerMap(
            tuple(
                _placement(str(name), entry, where) for name, entry in content["markers"].items()
            ),
            _one_of(content.get("base", "moving"), "way of the base to move", BASE_MOTIONS, where),
            _origin_fits(content.get("fit_origins", {}), where),
            where,
        )


def _placement(name: str, entry: Any, where: str) -> MarkerPlacement:
    if not isinstance(entry, dict) or not {"link", "position"} <= entry.keys():
        raise RecordingError(f"{where}: marker '{name}' must have a link and a position in it")
    _refuse_unknown(entry, f"key of marker '{name}'", _MARKER_KEYS, where)
    body = entry.get("body")
    return MarkerPlacement(
        name,
        str(entry["link"]),
        entry["position"],
        weight=entry.get("weight", 1.0),
        body=None if body is None else str(body),
        offset=entry.get("offset", np.zeros(3)),
        where=where,
    )


def _origin_fits(content: Any, where: str) -> dict[str, OriginFit]:
    if not isinstance(content, dict):
        raise RecordingError(f"{where}: fit_origins must map joints to 'position' or 'length'")
    return {
        str(joint): _one_of(fit, f"fit of the origin of joint '{joint}'", ORIGIN_FITS, where)
        for joint, fit in content.items()
    }


def _one_of(value: Any, kind: str, valid: tuple[Any, ...], where: str) -> Any:
    if value not in valid:
        raise RecordingError(f"{where}: {unknown_name(kind, str(value), valid)}")
    return value


def _refuse_unknown(content: dict[Any, Any], kind: str, valid: tuple[str, ...], where: str) -> None:
    for key in content:
        if key not in valid:
            raise RecordingError(f"{where}: {unknown_name(kind, str(key), valid)}")
