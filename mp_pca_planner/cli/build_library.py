# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_library`: mixed recordings → kinds of motions → one primitive each."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

from ..exceptions import PrimitiveError, RecordingError, listed, quote_names
from ..files import write_whole
from ..plotting.report import library_page
from ..plotting.text import table, unit_of
from ..primitives.kind_names import plain_name
from ..primitives.kinds import KindOptions
from ..primitives.library_building import (
    OUTLIERS,
    LibraryContent,
    known_motions,
    libraries_of,
    library_content,
    write_library,
)
from ..primitives.library_journal import require_locks
from ..primitives.motion_sources import indices_of
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.primitive import MovementPrimitive
from ..primitives.versioned_library import VersionedLibrary
from ..recordings.recording_set import RecordingSet
from ..robot.model import Robot
from .build_primitives import load, options_like, origin, primitive_options, repairs_of
from .common import check_output, report
from .terminal import DONE, complain

Joints = tuple[str, ...]


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    require_locks()
    check_output(arguments.report, ".html", force=arguments.force)
    folders = libraries_of(arguments.output)
    _check(arguments, folders)
    n_before = {folder: len(VersionedLibrary(folder).history()) for folder in folders.values()}
    old = [known_motions(VersionedLibrary(folder)) for folder in folders.values()]
    known = [x for kinds, outliers in old for x in (*kinds.values(), outliers) if x is not None]
    options = primitive_options(arguments)
    if known:
        options = options_like(known[0], options)
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    recordings = RecordingSet()
    if arguments.bags:
        joints = arguments.joints if robot is None else robot.joint_names
        motions = [x.statistics for x in known if x.statistics is not None]
        recordings = load(arguments, options, joints, 0, motions, robot)
        recordings.require_motion()
    repairs = {name: x for one in known for name, x in one.metadata.get("repairs", {}).items()}
    prismatic = {name for x in known for name in x.metadata.get("prismatic_joints", [])}
    repairs |= repairs_of(recordings)
    build = partial(
        library_content,
        options=options,
        kind_options=KindOptions(min_motions=arguments.min_kind),
        robot=robot,
        metadata=partial(origin, repairs=repairs, robot=robot, prismatic=prismatic),
    )
    contents = _contents(build, recordings, known, folders, arguments.remove)
    places = _places(arguments.output, contents, folders)
    page = library_page(places, recordings.refused) if arguments.report else ""
    for folder, content in places.items():
        write_library(VersionedLibrary(folder), content, n_before.get(folder, 0), "build_library")
    if arguments.report is not None:
        write_whole(arguments.report, page.encode(), overwrite=arguments.force)
    _print(arguments, recordings, places)
    return DONE


def _check(arguments: argparse.Namespace, folders: Mapping[Joints, Path]) -> None:
    """Reject options that don't fit together or to the folder."""
    if not arguments.bags and not arguments.update:
        raise RecordingError("give at least one recording, or --update")
    if arguments.remove and not arguments.update:
        raise RecordingError("--remove removes recordings from a library: also pass --update")
    if arguments.update and not folders:
        raise PrimitiveError(f"there is no library '{arguments.output}' to update")
    if folders and not arguments.update:
        raise PrimitiveError(
            f"'{arguments.output}' holds a library: give --update to add the recordings to it, or "
            "another folder"
        )


def _contents(
    build: Any,
    recordings: RecordingSet,
    known: Sequence[MovementPrimitive],
    folders: Mapping[Joints, Path],
    removed: Sequence[str],
) -> dict[Joints, LibraryContent]:
    """The library of each set of joints: of old and of new motions."""
    orders = {frozenset(joints): joints for joints in folders}
    old: dict[Joints, list[MotionStatistics]] = {}
    new: dict[Joints, Iterable[MotionStatistics]] = {}
    for primitive in known:
        if primitive.statistics is not None:
            old.setdefault(primitive.joint_names, []).append(primitive.statistics)
    for part in recordings.summaries:
        joints = orders.setdefault(frozenset(part.joint_names), part.joint_names)
        new[joints] = _Ordered(recordings.summaries, joints)
    contents, missing = {}, set(removed)
    for joints in sorted({*old, *new}):
        parts = [MotionStatistics.merged(x) for x in (old.get(joints), new.get(joints)) if x]
        statistics = parts[0].added(parts[1]) if len(parts) > 1 else parts[0]
        here = [name for name in removed if indices_of(name, statistics.motions)]
        statistics = statistics.without(here) if here else statistics
        missing -= set(here)
        kinds = {
            x.name: x.statistics
            for x in known
            if x.joint_names == joints and x.statistics and x.name != OUTLIERS
        }
        taken = [] if joints not in folders else [*VersionedLibrary(folders[joints]).in_use()]
        others = [name for name in taken if name not in kinds]
        contents[joints] = build(statistics, known=kinds, taken=others)
    if missing:
        raise PrimitiveError(f"the library holds no recordings called {quote_names(missing)}")
    return contents


@dataclass(frozen=True)
class _Ordered:
    """Those of some statistics that have the same joints, with these in one order."""

    parts: Sequence[MotionStatistics]
    joints: Joints

    def __iter__(self) -> Iterator[MotionStatistics]:
        same = (x for x in self.parts if set(x.joint_names) == set(self.joints))
        return (part.ordered(self.joints) for part in same)


def _places(
    output: Path, contents: Mapping[Joints, LibraryContent], folders: Mapping[Joints, Path]
) -> dict[Path, LibraryContent]:
    """The folder of each library: that of --output itself, if it is the only one."""
    if not folders and len(contents) == 1:
        return dict(zip([output], contents.values(), strict=True))
    places: dict[Path, LibraryContent] = {}
    for joints, content in contents.items():
        name = plain_name(f"{len(joints)} joints to {joints[-1]}")
        names = (output / (f"{name}_{i}" if i > 1 else name) for i in count(1))
        free = (path for path in names if path not in {*places, *folders.values()})
        places[folders.get(joints) or next(free)] = content
    return places


def _print(
    arguments: argparse.Namespace, recordings: RecordingSet, places: Mapping[Path, LibraryContent]
) -> None:
    facts: dict[str, Any] = {
        "n_recordings": len(recordings.reports),
        "refused": [asdict(refusal) for refusal in recordings.refused],
        "libraries": [_facts(folder, content) for folder, content in places.items()],
    }
    lines = [f"recordings  {facts['n_recordings']} read, {len(recordings.refused)} refused"]
    for library, content in zip(facts["libraries"], places.values(), strict=True):
        lines += ["", *_text(library, content)]
    report(arguments, facts, *lines)
    for refusal in recordings.refused:
        complain(f"refused {refusal.recording}: {refusal.reason}")


def _facts(folder: Path, content: LibraryContent) -> dict[str, Any]:
    motions = content.statistics.motions
    outliers = () if content.outliers is None else content.outliers.metadata["demonstrations"]
    return {
        "output": str(folder),
        "joint_names": list(content.statistics.joint_names),
        "n_motions": len(motions),
        "kinds": [
            {
                "name": primitive.name,
                "n_motions": len(primitive.durations),
                "labels": Counter(d["label"] for d in primitive.metadata["demonstrations"]),
                "n_components": primitive.n_components,
                "left_out_error": alone,
                "left_out_error_in_one_pot": together,
            }
            for primitive, alone, together in zip(
                content.primitives, content.errors_alone, content.errors_in_one_pot, strict=True
            )
        ],
        "outliers": list(outliers),
        "ambiguous": [
            {"recording": motions[i].recording, "start_time_s": motions[i].start_time, "kinds": x}
            for i, x in content.ambiguous
        ],
        "adjusted_rand_index": content.label_agreement(),
    }


def _text(facts: dict[str, Any], content: LibraryContent) -> list[str]:
    unit = unit_of(facts["joint_names"], content.primitives[0].metadata["prismatic_joints"])
    rows = [
        [
            kind["name"],
            str(kind["n_motions"]),
            str(kind["n_components"]),
            unit.number(kind["left_out_error"]),
            unit.number(kind["left_out_error_in_one_pot"]),
        ]
        for kind in facts["kinds"]
    ]
    header = ["kind", "motions", "components", f"left out [{unit.name}]", "pooled"]
    agreement = facts["adjusted_rand_index"]
    return [
        f"motions     {facts['n_motions']} of {len(facts['joint_names'])} joints, of "
        f"{len(rows)} {'kind' if len(rows) == 1 else 'kinds'}",
        *table(rows, header=header).splitlines(),
        *_listed("outliers", [_place(d) for d in facts["outliers"]]),
        *_listed("several", [f"{_place(d)} ({', '.join(d['kinds'])})" for d in facts["ambiguous"]]),
        *([] if agreement is None else [f"labels      adjusted Rand index {agreement:.2f}"]),
        f"written to  {facts['output']}",
    ]


def _place(motion: Mapping[str, Any]) -> str:
    return f"{motion['recording']} {motion['start_time_s']:.2f} s"


def _listed(what: str, motions: Sequence[str], most: int = 3) -> list[str]:
    """A line with the number of motions and at most so many of them, if there are any."""
    if not motions:
        return []
    return [f"{what:<12}{len(motions)}: {listed(motions, most, '; ')}"]
