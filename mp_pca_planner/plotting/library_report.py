# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The report of `build_library`, an HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.kinds import OUTLIER
from ..primitives.library_building import LibraryContent
from ..primitives.primitive import MovementPrimitive
from ..recordings.demonstration import Refusal
from .page import figure_address, render
from .primitive import PHASES
from .style import GREY, Line, add_header, joint_panels, line, palette_line
from .units import primitive_unit, prismatic_joints, unit_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_KINDS = 40
"""Largest number of kinds with a figure."""
MAX_PATHS = 60
"""Largest number of motions in the figure of a kind."""
MAX_JOINTS = 8
"""Largest number of joints in the figure of a kind."""
MAX_ROWS = 200
"""Largest number of motions in a list."""

_MARKERS = "osD^v<>P*X"
_PATH = line("motions", GREY, "-", 0.8)


def library_page(places: Mapping[Path, LibraryContent], refused: Sequence[Refusal]) -> str:
    """Make the page.

    Parameters
    ----------
    places : mapping
        The libraries by their folders.
    refused : sequence of Refusal
        Recordings that were not used.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    return render(
        "library.html",
        title="Kinds of motions",
        libraries=[_library(folder, content) for folder, content in places.items()],
        refused=refused,
        max_rows=MAX_ROWS,
    )


def _library(folder: Path, content: LibraryContent) -> dict[str, Any]:
    motions, unit = content.statistics.motions, primitive_unit(content.primitives[0])
    kinds = zip(content.primitives, content.errors_alone, content.errors_in_one_pot, strict=True)
    return {
        "folder": str(folder),
        "content": content,
        "unit": unit,
        "map": figure_address(partial(kinds_map, content=content)),
        "agreement": content.label_agreement(),
        "kinds": [
            {
                "primitive": primitive,
                "labels": _labels(primitive),
                "alone": unit.number(alone),
                "together": unit.number(together),
                "figure": _kind_figure(primitive) if i < MAX_KINDS else None,
            }
            for i, (primitive, alone, together) in enumerate(kinds)
        ],
        "outliers": [motions[i] for i in content.kinds.members(OUTLIER)],
        "ambiguous": [(motions[i], ", ".join(names)) for i, names in content.ambiguous],
    }


def _labels(primitive: MovementPrimitive) -> str:
    counts = Counter(d["label"] for d in primitive.metadata["demonstrations"] if d["label"])
    return ", ".join(f"{label} {n}" for label, n in counts.most_common())


def kinds_map(figure: Figure, content: LibraryContent) -> None:
    """Draw every motion as a point, by kind."""
    kinds, styles = content.kinds, [_points(GREY, "x", "none of them")]
    for k, primitive in enumerate(content.primitives):
        colour = palette_line("", k)["color"]
        styles.append(_points(colour, _MARKERS[k % len(_MARKERS)], primitive.name))
    add_header(figure, "Motions by kind", styles[1:] + styles[:1], 10.0, 6.0)
    axes = figure.subplots()
    for k, style in enumerate(styles, start=OUTLIER):
        axes.plot(*kinds.positions[kinds.members(k)].T, **style)
    axes.set(xlabel="first component of the features", ylabel="second component")


def _points(colour: str, marker: str, label: str) -> Line:
    shape = {"marker": marker, "markersize": 6.0, "alpha": 0.8}
    return {"color": colour, "linestyle": "none", "label": label, **shape}


def _kind_figure(primitive: MovementPrimitive) -> str:
    return figure_address(partial(paths_figure, primitive=primitive))


def paths_figure(figure: Figure, primitive: MovementPrimitive) -> None:
    """Draw the motions of a kind over the aligned phase, in the joints that move most."""
    n = len(primitive.durations)
    shown = np.unique(np.linspace(0, n - 1, min(n, MAX_PATHS)).round().astype(int))
    paths = np.array([_aligned(primitive, i) for i in shown])
    moved = np.argsort(-np.ptp(paths, axis=1).mean(axis=0), kind="stable")
    joints = np.sort(moved[:MAX_JOINTS])
    names = [primitive.joint_names[j] for j in joints]
    panels = joint_panels(figure, names, 1, primitive.name, [_PATH])
    for joint, (axes,) in zip(joints, panels, strict=True):
        unit = unit_of([primitive.joint_names[joint]], prismatic_joints(primitive))
        axes.plot(PHASES, unit.factor * paths[:, :, joint].T, **_PATH)
        axes.set(xlabel="phase", ylabel=f"position [{unit.name}]", xlim=(0.0, 1.0))


def _aligned(primitive: MovementPrimitive, i: int) -> FloatArray:
    """A motion as its weights reproduce it, by aligned phase."""
    state, duration = primitive.boundary_states[i], primitive.durations[i]
    straight = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
    return np.asarray(
        hermite_functions(PHASES) @ straight + primitive.basis.shape(primitive.weights[i], PHASES)
    )
