# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_library`: mixed recordings → kinds of motions → one primitive each."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..arrays import text_table
from ..exceptions import PrimitiveError, RecordingError, listed
from ..files import write_whole
from ..plotting.report import library_page
from ..plotting.text import kinds_words, unit_of
from ..primitives.build_library import ExistingLibraries, LibraryContent, build_library
from ..primitives.kinds import KindOptions
from ..primitives.library import require_locks
from ..recordings.recording_set import RecordingSet
from ..robot.model import Robot
from .build_primitives import load, options_like, primitive_options, repairs_of
from .common import check_output, report
from .terminal import DONE, complain


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    require_locks()
    check_output(arguments.report, ".html", force=arguments.force)
    existing = ExistingLibraries.read(arguments.output)
    _check(arguments, existing)
    options = primitive_options(arguments)
    if existing.primitives:
        options = options_like(existing.primitives[0], options)
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    recordings = RecordingSet()
    if arguments.bags:
        joints = arguments.joints if robot is None else robot.joint_names
        recordings = load(arguments, options, joints, 0, existing.statistics, robot)
        recordings.require_motion()
    places = build_library(
        recordings.summaries,
        arguments.output,
        options=options,
        kind_options=KindOptions(min_motions=arguments.min_kind),
        robot=robot,
        existing=existing,
        removed=arguments.remove,
        repairs=repairs_of(recordings),
    )
    if arguments.report is not None:
        page = library_page(places, recordings.refused)
        write_whole(arguments.report, page.encode(), overwrite=arguments.force)
    _print(arguments, recordings, places)
    return DONE


def _check(arguments: argparse.Namespace, existing: ExistingLibraries) -> None:
    """Reject options that don't fit together or to the folder."""
    if not arguments.bags and not arguments.update:
        raise RecordingError("give at least one recording, or --update")
    if arguments.remove and not arguments.update:
        raise RecordingError("--remove removes recordings from a library: also pass --update")
    if arguments.update and not existing.folders:
        raise PrimitiveError(f"there is no library '{arguments.output}' to update")
    if existing.folders and not arguments.update:
        raise PrimitiveError(
            f"'{arguments.output}' holds a library: give --update to add the recordings to it, or "
            "another folder"
        )


def _print(
    arguments: argparse.Namespace, recordings: RecordingSet, places: Mapping[Path, LibraryContent]
) -> None:
    facts: dict[str, Any] = {
        "n_recordings": len(recordings.reports),
        "refused": [asdict(refusal) for refusal in recordings.refused],
        "libraries": [_facts(folder, content) for folder, content in places.items()],
    }
    lines = [f"recordings  {facts['n_recordings']} read, {len(recordings.refused)} rejected"]
    for library, content in zip(facts["libraries"], places.values(), strict=True):
        lines += ["", *_text(library, content)]
    report(arguments, facts, *lines)
    for refusal in recordings.refused:
        complain(f"rejected {refusal.recording}: {refusal.reason}")


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
                "left_out_error_pooled": pooled,
            }
            for primitive, alone, pooled in zip(
                content.primitives, content.errors_alone, content.errors_pooled, strict=True
            )
        ],
        "outliers": list(outliers),
        "ambiguous": [
            {"recording": motions[i].recording, "start_time_s": motions[i].start_time, "kinds": x}
            for i, x in content.ambiguous
        ],
        "kinds_left_out": None if content.left_out is None else asdict(content.left_out),
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
            unit.number(kind["left_out_error_pooled"]),
        ]
        for kind in facts["kinds"]
    ]
    header = ["kind", "motions", "components", f"left out [{unit.name}]", "pooled"]
    agreement, judged = facts["adjusted_rand_index"], content.left_out
    return [
        f"motions     {facts['n_motions']} of {len(facts['joint_names'])} joints, of "
        f"{len(rows)} {'kind' if len(rows) == 1 else 'kinds'}",
        *text_table(rows, header=header).splitlines(),
        *([] if judged is None else [f"left out    {kinds_words(judged, unit)}"]),
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
