# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries of one primitive for each kind of motion in mixed recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..robot.model import Robot
from .build import build_from_statistics
from .file import load_primitive, write_primitive
from .kind_names import kind_names
from .kinds import OUTLIER, Indices, KindOptions, Kinds, find_kinds
from .library_journal import Change
from .motion_statistics import MotionStatistics
from .options import PrimitiveOptions
from .prediction import left_out_squares
from .primitive import MovementPrimitive
from .versioned_library import VersionedLibrary

OUTLIERS = "outliers"
"""Name of the primitive that only holds the statistics of the motions that belong to no kind."""
_OUTLIERS_FILE = f"{OUTLIERS}.npz"

# Largest numbers of left-out motions of a kind, and of others in one pot with them.
_MAX_LEFT_OUT = 100


@dataclass(frozen=True, eq=False)
class LibraryContent:
    """The kinds of motions of a library, and their primitives.

    Attributes
    ----------
    statistics : MotionStatistics
        Of all motions.
    kinds : Kinds
        Their kinds.
    primitives : tuple of MovementPrimitive
        The primitive of each kind.
    errors_alone, errors_in_one_pot : array, shape (n_kinds,)
        RMS errors in path of left-out motions of each kind, predicted by the others of the kind,
        and by motions of all kinds [rad or m].
    outliers : MovementPrimitive or None
        Of the motions that belong to no kind; it only holds their statistics.
    """

    statistics: MotionStatistics
    kinds: Kinds
    primitives: tuple[MovementPrimitive, ...]
    errors_alone: FloatArray
    errors_in_one_pot: FloatArray
    outliers: MovementPrimitive | None

    @property
    def ambiguous(self) -> list[tuple[int, list[str]]]:
        """Motions that several kinds explain, by index, with the names of these."""
        found = []
        for i in np.flatnonzero(self.kinds.explained_by.sum(axis=1) > 1):
            kinds = np.flatnonzero(self.kinds.explained_by[i])
            found.append((int(i), [self.primitives[k].name for k in kinds]))
        return found

    def label_agreement(self) -> float | None:
        """Adjusted Rand index of kinds and labels (Hubert and Arabie, J. Classif. 2, 1985).

        Of the motions with a label that belong to a kind; None if these have fewer than two labels.
        """
        pairs = [
            (motion.label, int(kind))
            for motion, kind in zip(self.statistics.motions, self.kinds.assigned, strict=True)
            if motion.label and kind != OUTLIER
        ]
        if len({label for label, _ in pairs}) < 2:
            return None
        return adjusted_rand_index(*zip(*pairs, strict=True))


def adjusted_rand_index(first: Sequence[Any], second: Sequence[Any]) -> float:
    """Agreement of two partitions: 1 for equal ones, about 0 for independent ones."""

    def n_pairs(partition: Sequence[Any]) -> float:
        return sum(n * (n - 1) / 2.0 for n in Counter(partition).values())

    both = n_pairs(list(zip(first, second, strict=True)))
    ones, others, every = n_pairs(first), n_pairs(second), len(first) * (len(first) - 1) / 2.0
    expected, most = ones * others / max(every, 1.0), (ones + others) / 2.0
    return 1.0 if most == expected else (both - expected) / (most - expected)


def library_content(
    statistics: MotionStatistics,
    options: PrimitiveOptions,
    *,
    kind_options: KindOptions | None = None,
    robot: Robot | None = None,
    known: Mapping[str, MotionStatistics] | None = None,
    taken: Sequence[str] = (),
    metadata: Callable[[MotionStatistics], Mapping[str, Any]] | None = None,
) -> LibraryContent:
    """Find the kinds of motions, and learn a primitive of each.

    Parameters
    ----------
    statistics : MotionStatistics
        Of all motions, made with `options`.
    options : PrimitiveOptions
        Options of the primitives.
    kind_options : KindOptions, optional
        Options of the kinds.
    robot : Robot, optional
        Model of the joints, for names.
    known : mapping, optional
        Motions of earlier kinds by name; a kind keeps the name that most of its motions had.
    taken : sequence of str
        Names of other primitives in the library.
    metadata : callable, optional
        Further metadata of the primitive of some motions.
    """

    def learned(part: MotionStatistics, name: str) -> MovementPrimitive:
        return build_from_statistics(part, name, options, metadata(part) if metadata else None)

    kinds = find_kinds(statistics, options.n_phases, kind_options or KindOptions())
    members = [kinds.members(k) for k in range(kinds.assigned.max() + 1)]
    parts = [statistics.chosen(x) for x in members]
    names = _names(parts, robot, known or {}, taken)
    scale = options.n_phases * len(statistics.joint_names)
    errors = [_left_out_errors(statistics, x) / np.sqrt(scale) for x in members]
    left = kinds.members(OUTLIER)
    return LibraryContent(
        statistics=statistics,
        kinds=kinds,
        primitives=tuple(learned(part, name) for part, name in zip(parts, names, strict=True)),
        errors_alone=np.array([alone for alone, _ in errors]),
        errors_in_one_pot=np.array([together for _, together in errors]),
        outliers=learned(statistics.chosen(left), OUTLIERS) if left.size else None,
    )


def write_library(
    library: VersionedLibrary, content: LibraryContent, n_before: int, note: str
) -> tuple[Change, ...]:
    """Put the primitives of all kinds into use, and retire those of earlier kinds.

    Primitives without statistics, such as refined ones, stay.

    Parameters
    ----------
    library : VersionedLibrary
        The library.
    content : LibraryContent
        The kinds.
    n_before : int
        Number of changes in its history that the kinds are based on.
    note : str
        Reason of the changes.

    Raises
    ------
    PrimitiveError
        If another process has changed the library meanwhile.
    """
    names = {primitive.name for primitive in content.primitives}
    retired = sorted(known_motions(library)[0].keys() - names)
    outliers = content.outliers
    kept = {_OUTLIERS_FILE: None if outliers is None else partial(write_primitive, outliers)}
    return library.change(content.primitives, retired, kept, n_before=n_before, note=note)


def known_motions(
    library: VersionedLibrary,
) -> tuple[dict[str, MovementPrimitive], MovementPrimitive | None]:
    """Primitives in use that can be updated, by name, and the one of the outliers."""
    primitives = {name: load_primitive(library.folder / f"{name}.npz") for name in library.in_use()}
    kinds = {name: x for name, x in primitives.items() if x.statistics is not None}
    file = library.kept(_OUTLIERS_FILE)
    return kinds, load_primitive(file) if file.exists() else None


def libraries_of(folder: Path) -> dict[tuple[str, ...], Path]:
    """Libraries in a folder and in the folders in it, by the joints of their primitives."""
    found: dict[tuple[str, ...], Path] = {}
    for path in [folder, *sorted(x for x in folder.glob("*/") if not x.name.startswith("."))]:
        if path.is_dir():
            for name in VersionedLibrary(path).in_use():
                joints = load_primitive(path / f"{name}.npz").joint_names
                found.setdefault(joints, path)
                break
    return found


def _names(
    parts: Sequence[MotionStatistics],
    robot: Robot | None,
    known: Mapping[str, MotionStatistics],
    taken: Sequence[str],
) -> list[str]:
    """Names of kinds: their earlier ones where they had any."""
    earlier = {m.identity: name for name, x in known.items() for m in x.motions}
    counts = [Counter(earlier.get(m.identity) for m in part.motions) for part in parts]
    kept: dict[int, str] = {}
    every = [(n, -i, name) for i, count in enumerate(counts) for name, n in count.items() if name]
    for _, index, name in sorted(every, reverse=True):
        if -index not in kept and name not in kept.values():
            kept[-index] = name
    used = [OUTLIERS, *taken, *kept.values()]
    new = iter(kind_names([x for i, x in enumerate(parts) if i not in kept], used, robot))
    return [kept[i] if i in kept else next(new) for i in range(len(parts))]


def _left_out_errors(statistics: MotionStatistics, members: Indices) -> FloatArray:
    """Root mean square errors of left-out motions of a kind, alone and in one pot, unscaled."""
    inside = _evenly(statistics, members)
    others = np.setdiff1d(np.arange(len(statistics.durations)), members)
    outside = _evenly(statistics, others)
    errors = []
    for used in (inside, np.concatenate([inside, outside])):
        chosen = statistics.chosen(used)
        squares = left_out_squares(chosen.requests(), chosen.both_shapes())
        squares = squares + chosen.shape_remainders.sum(axis=1)
        errors.append(np.sqrt(squares[: len(inside)].mean()))
    return np.array(errors)


def _evenly(statistics: MotionStatistics, indices: Indices) -> Indices:
    """A part of the motions, whatever the order of all: evenly by their durations."""
    ordered = indices[np.argsort(statistics.durations[indices], kind="stable")]
    return ordered[:: max(1, -(-len(indices) // _MAX_LEFT_OUT))]
