# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Marker maps: YAML files with the places of markers on the links of a robot or person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import RecordingError, unknown_name
from ..files import load_yaml, read_text, reading

BaseMotion = Literal["moving", "identity"]
BASE_MOTIONS: tuple[BaseMotion, ...] = get_args(BaseMotion)
"""Motion of the root link in the frame that markers are recorded in: its pose is fitted to the
markers on it frame by frame, or it is that frame."""

OriginFit = Literal["position", "length"]
ORIGIN_FITS: tuple[OriginFit, ...] = get_args(OriginFit)
"""Fitted part of a joint's origin in its parent link: its position, or its distance only."""


@dataclass(frozen=True, eq=False)
class MarkerPlacement:
    """A marker on a link.

    Attributes
    ----------
    name : str
        Name in reports.
    link : str
        The link that it is attached to.
    position : array, shape (3,)
        Position in the link's frame [m].
    weight : float
        Weight of its squared distance, over 0.
    body : str
        Name in the recording; its own name unless given.
    offset : array, shape (3,)
        Position of the marker in the recorded body's own frame [m]. A body that is recorded with
        its orientation gives any number of markers.

    Raises
    ------
    RecordingError
        If a position has another shape or is not finite, or the weight is not positive.
    """

    name: str
    link: str
    position: FloatArray
    weight: float = 1.0
    body: str = ""
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    where: InitVar[str] = "marker map"

    def __post_init__(self, where: str) -> None:
        def set_number(name: str, shape: tuple[int, ...]) -> None:
            what = f"{where}: {name} of marker '{self.name}'"
            array = frozen_array(getattr(self, name), shape, what, RecordingError)
            if not shape and array <= 0.0:
                raise RecordingError(f"{what} is {float(array):g}, but it must be positive")
            object.__setattr__(self, name, array if shape else float(array))

        set_number("position", (3,))
        set_number("offset", (3,))
        set_number("weight", ())
        object.__setattr__(self, "body", self.body or self.name)


@dataclass(frozen=True)
class MarkerMap:
    """All markers, and the parts of the model that are fitted to the recording.

    Attributes
    ----------
    markers : tuple of MarkerPlacement
        The markers.
    base : str
        Motion of the root link, see :data:`BASE_MOTIONS`.
    fit_origins : mapping
        Joints whose origin in the parent link is fitted to each recording, so that one model
        serves people (or calibrations) that differ, see :data:`ORIGIN_FITS`.
    source : str
        Name of the map in messages.
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
        If the file can't be read or has other content.
    """
    where = f"marker map '{path}'"
    with reading(f"the {where}", RecordingError):
        content = load_yaml(read_text(path))
        if not isinstance(content, dict) or not isinstance(content.get("markers"), dict):
            raise RecordingError(
                f"the {where} must hold a mapping 'markers' from names to links and positions"
            )
        for key in content:
            _one_of(key, "key", ("base", "fit_origins", "markers"), where)
        base = content.get("base", "moving")
        fits = content.get("fit_origins", {})
        if not isinstance(fits, dict):
            raise RecordingError(f"{where}: fit_origins must map joints to 'position' or 'length'")
        for joint, fit in fits.items():
            _one_of(fit, f"fit of the origin of joint '{joint}'", ORIGIN_FITS, where)
        return MarkerMap(
            tuple(_placement(str(name), e, where) for name, e in content["markers"].items()),
            _one_of(base, "motion of the base", BASE_MOTIONS, where),
            {str(joint): fit for joint, fit in fits.items()},
            where,
        )


def _placement(name: str, entry: Any, where: str) -> MarkerPlacement:
    if not isinstance(entry, dict) or not {"link", "position"} <= entry.keys():
        raise RecordingError(f"{where}: marker '{name}' must have a link and a position in it")
    for key in entry:
        valid = ("link", "position", "weight", "body", "offset")
        _one_of(key, f"key of marker '{name}'", valid, where)
    body = entry.get("body")
    texts = {"link": str(entry["link"]), "body": "" if body is None else str(body)}
    return MarkerPlacement(name, where=where, **{**entry, **texts})


def _one_of(value: Any, kind: str, valid: tuple[Any, ...], where: str) -> Any:
    if value not in valid:
        raise RecordingError(f"{where}: {unknown_name(kind, str(value), valid)}")
    return value
