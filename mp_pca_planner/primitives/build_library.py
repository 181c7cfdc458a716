# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries of one primitive for each kind of motion in mixed recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, as_list
from ..exceptions import PrimitiveError, quote_names, shown
from ..recordings.demonstration import Demonstration
from ..recordings.recording_set import RecordingSet
from ..robot.model import Robot
from .build import PrimitiveOptions, build_from_statistics
from .file import load_primitive, write_primitive
from .kinds import (
    OUTLIER,
    Indices,
    KindErrors,
    KindOptions,
    Kinds,
    choose_kinds,
    kind_names,
    plain_name,
)
from .library import Change, VersionedLibrary, require_locks
from .motion_statistics import MotionStatistics, indices_of
from .prediction import left_out_squares
from .primitive import MovementPrimitive

Joints = tuple[str, ...]

OUTLIERS = "outliers"
"""Name of the primitive that only holds the statistics of the motions that belong to no kind."""
_OUTLIERS_FILE = f"{OUTLIERS}.npz"

# Largest numbers of left-out motions of a kind, and of others that are pooled with them.
_MAX_LEFT_OUT = 200


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
    errors_alone, errors_pooled : array, shape (n_kinds,)
        RMS errors in path of left-out motions of each kind, predicted by the others of the kind,
        and by motions of all kinds [rad or m].
    left_out : KindErrors or None
        Errors of left-out motions with the kinds that were found, and with one primitive; None if
        all motions are of one kind.
    outliers : MovementPrimitive or None
        Of the motions that belong to no kind; it only holds their statistics.
    """

    statistics: MotionStatistics
    kinds: Kinds
    primitives: tuple[MovementPrimitive, ...]
    errors_alone: FloatArray
    errors_pooled: FloatArray
    left_out: KindErrors | None
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


@dataclass(frozen=True, eq=False)
class ExistingLibraries:
    """The libraries in a folder as they were when they were read.

    Attributes
    ----------
    folders : dict
        Folder of each, by the joints of its primitives.
    primitives : tuple of MovementPrimitive
        Their primitives that can be updated, and those that hold outliers.
    n_changes : dict
        Number of changes in the history of each, by folder.
    """

    folders: dict[Joints, Path]
    primitives: tuple[MovementPrimitive, ...]
    n_changes: dict[Path, int]

    @classmethod
    def read(cls, folder: Path) -> ExistingLibraries:
        """Read those in a folder and in the folders in it; none if it does not exist."""
        folders = libraries_of(folder)
        n_changes = {path: len(VersionedLibrary(path).history()) for path in folders.values()}
        pairs = [known_motions(VersionedLibrary(path)) for path in folders.values()]
        every = (x for kinds, outliers in pairs for x in (*kinds.values(), outliers))
        return cls(folders, tuple(x for x in every if x is not None), n_changes)

    @property
    def statistics(self) -> list[MotionStatistics]:
        """Statistics of all motions."""
        return [x.statistics for x in self.primitives if x.statistics is not None]


def build_library(
    motions: Sequence[Demonstration] | RecordingSet | Sequence[MotionStatistics],
    folder: str | Path,
    *,
    options: PrimitiveOptions | None = None,
    kind_options: KindOptions | None = None,
    robot: Robot | None = None,
    existing: ExistingLibraries | None = None,
    removed: Sequence[str] = (),
    repairs: Mapping[str, Any] | None = None,
) -> dict[Path, LibraryContent]:
    """Find the kinds of motions, and put a primitive of each into a versioned library.

    Kinds are kept if left-out motions are then predicted better than by one primitive of all
    motions, with the primitive that a planner chooses.

    Parameters
    ----------
    motions :
        Demonstrations, a value that holds `demonstrations`, or their statistics, made with
        `options`. Motions of different joints go to libraries of their own.
    folder : str or Path
        The library, or the folder of several libraries; made at the first change.
    options : PrimitiveOptions, optional
        Options of the primitives.
    kind_options : KindOptions, optional
        Options of the kinds.
    robot : Robot, optional
        Model of the joints, for names.
    existing : ExistingLibraries, optional
        Libraries in the folder, which the motions are added to; read if not given.
    removed : sequence of str
        Recordings whose motions are removed from the libraries.
    repairs : mapping, optional
        Repairs of each recording, by name, for the metadata.

    Returns
    -------
    contents : dict
        What each library holds, by its folder.

    Raises
    ------
    PrimitiveError
        If there is no motion, a name of a recording to remove is unknown, or another process has
        changed a library meanwhile.

    Examples
    --------
    >>> import tempfile
    >>> import mp_pca_planner as mp
    >>> motions = mp.load_demonstrations(mp.write_example_recording("mixed.mcap", 6))
    >>> found = mp.build_library(motions, tempfile.mkdtemp())
    >>> [primitive.n_joints for content in found.values() for primitive in content.primitives]
    [4]
    """
    require_locks()
    folder, options = Path(folder), options or PrimitiveOptions()
    existing = existing or ExistingLibraries.read(folder)
    earlier = [x.metadata for x in existing.primitives]
    repairs = {k: v for x in earlier for k, v in x.get("repairs", {}).items()} | dict(repairs or {})
    prismatic = {name for x in earlier for name in x.get("prismatic_joints", [])}
    merged = _merged(_statistics_of(motions, options), existing)
    if not merged:
        raise PrimitiveError("a library is built of motions, got none")
    kept = {joints: _without(statistics, removed) for joints, statistics in merged.items()}
    missing = set(removed).difference(*(gone for _, gone in kept.values()))
    if missing:
        raise PrimitiveError(f"the library holds no recordings called {quote_names(missing)}")
    contents: dict[Joints, LibraryContent] = {}
    for joints, (statistics, _) in kept.items():
        known = {
            x.name: x.statistics
            for x in existing.primitives
            if x.joint_names == joints and x.statistics and x.name != OUTLIERS
        }
        at = existing.folders.get(joints)
        taken = [] if at is None else [x for x in VersionedLibrary(at).in_use() if x not in known]
        contents[joints] = library_content(
            statistics,
            options,
            kind_options=kind_options,
            robot=robot,
            known=known,
            taken=taken,
            metadata=partial(origin, repairs=repairs, robot=robot, prismatic=prismatic),
        )
    places = _places(folder, contents, existing.folders)
    for path, content in places.items():
        n_before = existing.n_changes.get(path, 0)
        write_library(VersionedLibrary(path), content, n_before, "build_library")
    return places


def origin(
    statistics: MotionStatistics,
    repairs: Mapping[str, Any],
    robot: Robot | None,
    prismatic: Collection[str] = (),
) -> dict[str, Any]:
    """Metadata: the repairs of the recordings that are in, and the prismatic joints."""
    used = {motion.recording for motion in statistics.motions}
    moved = robot.prismatic_joints if robot else prismatic
    return {
        "repairs": {name: counts for name, counts in repairs.items() if name in used},
        "prismatic_joints": [x for x in statistics.joint_names if x in moved],
    }


def _statistics_of(motions: Any, options: PrimitiveOptions) -> Sequence[MotionStatistics]:
    """Statistics of demonstrations; those of each set of joints together."""
    found = getattr(motions, "demonstrations", motions)
    if not isinstance(found, Sequence):
        found = as_list(found, "a library is built of demonstrations", PrimitiveError)
    if isinstance(next(iter(found), None), MotionStatistics):
        return found  # type: ignore[no-any-return]
    by_joints: dict[Joints, list[Demonstration]] = {}
    for motion in found:
        if not isinstance(motion, Demonstration):
            raise PrimitiveError(
                f"{shown(motion)} is not a demonstration; load_demonstrations reads recordings"
            )
        by_joints.setdefault(motion.joint_names, []).append(motion)
    return [MotionStatistics.of(some, options) for some in by_joints.values()]


def _merged(
    motions: Sequence[MotionStatistics], existing: ExistingLibraries
) -> dict[Joints, MotionStatistics]:
    """Statistics of old and new motions by their joints, in one order of these."""
    orders = {frozenset(joints): joints for joints in existing.folders}
    old: dict[Joints, list[MotionStatistics]] = {}
    for part in existing.statistics:
        old.setdefault(part.joint_names, []).append(part)
    new: dict[Joints, _Ordered] = {}
    for part in motions:
        joints = orders.setdefault(frozenset(part.joint_names), part.joint_names)
        new[joints] = _Ordered(motions, joints)
    merged = {}
    for joints in sorted({*old, *new}):
        parts = [MotionStatistics.merged(x) for x in (old.get(joints), new.get(joints)) if x]
        merged[joints] = parts[0].added(parts[1]) if len(parts) > 1 else parts[0]
    return merged


@dataclass(frozen=True)
class _Ordered:
    """Those of some statistics that have the same joints, with these in one order."""

    parts: Sequence[MotionStatistics]
    joints: Joints

    def __iter__(self) -> Iterator[MotionStatistics]:
        same = (x for x in self.parts if set(x.joint_names) == set(self.joints))
        return (part.ordered(self.joints) for part in same)


def _without(
    statistics: MotionStatistics, removed: Sequence[str]
) -> tuple[MotionStatistics, list[str]]:
    """Statistics without the motions of recordings, and the names that were found."""
    here = [name for name in removed if indices_of(name, statistics.motions)]
    return (statistics.without(here) if here else statistics), here


def _places(
    output: Path, contents: Mapping[Joints, LibraryContent], folders: Mapping[Joints, Path]
) -> dict[Path, LibraryContent]:
    """The folder of each library: that of the output itself, if it is the only one."""
    if not folders and len(contents) == 1:
        return dict(zip([output], contents.values(), strict=True))
    places: dict[Path, LibraryContent] = {}
    for joints, content in contents.items():
        name = plain_name(f"{len(joints)} joints to {joints[-1]}")
        names = (output / (f"{name}_{i}" if i > 1 else name) for i in count(1))
        free = (path for path in names if path not in {*places, *folders.values()})
        places[folders.get(joints) or next(free)] = content
    return places


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

    kinds, left_out = choose_kinds(statistics, options.n_phases, kind_options or KindOptions())
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
        errors_pooled=np.array([together for _, together in errors]),
        left_out=left_out,
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
    """Root mean square errors of left-out motions of a kind, alone and pooled, unscaled."""
    inside = _evenly(statistics, members)
    others = np.setdiff1d(np.arange(len(statistics.durations)), members)
    outside = _evenly(statistics, others)
    errors = []
    for used in (inside, np.concatenate([inside, outside])):
        chosen = statistics.chosen(used)
        requests, shapes = chosen.requests(), chosen.both_shapes()
        squares = left_out_squares(requests, shapes, labels=chosen.labels())
        squares = squares + chosen.shape_remainders.sum(axis=1)
        errors.append(np.sqrt(squares[: len(inside)].mean()))
    return np.array(errors)


def _evenly(statistics: MotionStatistics, indices: Indices) -> Indices:
    """A part of the motions, whatever the order of all: evenly by their durations."""
    ordered = indices[np.argsort(statistics.durations[indices], kind="stable")]
    return ordered[:: max(1, -(-len(indices) // _MAX_LEFT_OUT))]
