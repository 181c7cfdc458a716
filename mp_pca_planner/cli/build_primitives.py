# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives`: bags → one primitive file."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from heapq import nlargest
from pathlib import Path
from typing import Any

import numpy as np

from ..control.law import with_gains_only
from ..exceptions import PrimitiveError, RecordingError, listed, quote_names
from ..files import write_whole
from ..mocap.marker_joint_states import MarkerSource, marker_source
from ..plotting.report import N_SAMPLES, report_page
from ..plotting.text import (
    components_words,
    kinds_words,
    prediction_words,
    prismatic_joints,
    unit_of,
    variance_report,
)
from ..primitives.build import PrimitiveOptions, build_from_statistics, options_to_update
from ..primitives.build_library import origin
from ..primitives.file import load_primitive, save_primitive
from ..primitives.foreign import foreign_recordings
from ..primitives.kinds import KindErrors, KindOptions, choose_kinds
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.primitive import COUPLINGS, MovementPrimitive
from ..primitives.timing import ALIGNMENTS
from ..recordings.cutting import segments_table
from ..recordings.load import load_recordings, position_limits
from ..recordings.recording_set import RecordingSet
from ..recordings.segmentation import SegmentationOptions
from ..robot.model import Robot
from .common import check_output, print_json, progress_bar
from .options import add_bag_topic, add_report, name_list, seconds, whole
from .terminal import DONE, complain, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = "Learn a movement primitive from recorded bags and write it to a file."
    parser.add_argument(
        "bags",
        metavar="BAG",
        nargs="*",
        help="ROS 1 .bag, rosbag2 folder, .db3, .mcap; .csv; LeRobot dataset; globs and folders "
        "of these",
    )
    _add_input(parser)
    _add_primitive(parser)
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="file to write (default: that of --update)"
    )
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        type=Path,
        help="page to write that shows recordings, cuts and components",
    )
    parser.add_argument(
        "--write-segments",
        metavar="FILE.csv",
        type=Path,
        help="table of the motions to write; edit it for --segments",
    )
    parser.add_argument("--update", metavar="FILE", type=Path, help="primitive file to add to")
    parser.add_argument("--remove", type=name_list, default=[], help="recordings to remove")
    add_report(parser)


def _add_input(parser: argparse.ArgumentParser) -> None:
    add_bag_topic(parser)
    parser.add_argument(
        "--joints", metavar="a,b,c", type=name_list, help="joints to use, in this order"
    )
    parser.add_argument(
        "--robot",
        metavar="URDF",
        type=Path,
        help="robot of the recordings; without --joints, its joints that move in them are used",
    )
    parser.add_argument(
        "--degrees",
        action="store_true",
        help="recorded positions are in degrees, not in radians",
    )
    parser.add_argument(
        "--markers", metavar="TOPIC", help="topic of markers to compute joint angles from"
    )
    parser.add_argument(
        "--marker-map",
        metavar="FILE.yaml",
        type=Path,
        help="positions of the markers on the robot's links",
    )
    parser.add_argument(
        "--max-gap",
        metavar="S",
        type=seconds,
        help="longest gap that doesn't cut a recording [s] (default: 0.5, or 5 usual periods)",
    )
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        "--jobs",
        metavar="N",
        type=whole(1, 1024),
        default=1,
        help="number of recordings to read at the same time",
    )
    workers.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="scheduler (tcp://HOST:PORT) of a Dask cluster that reads the recordings",
    )
    cutting = parser.add_argument_group("cutting recordings into motions")
    cutting.add_argument(
        "--segment",
        choices=["auto", "none"],
        default="auto",
        help="cut recordings at rests (auto), or don't cut them",
    )
    cutting.add_argument(
        "--min-rest",
        metavar="S",
        type=seconds,
        help="shortest rest that cuts a recording [s] (default: 0.6)",
    )
    cutting.add_argument(
        "--min-motion", metavar="S", type=seconds, help="shortest motion [s] (default: 0.25)"
    )
    cutting.add_argument(
        "--segments",
        metavar="FILE.csv",
        type=Path,
        help="table of motions: recording,start_time_s,end_time_s[,label]",
    )
    cutting.add_argument(
        "--label",
        metavar="a,b,c",
        type=name_list,
        help="use only motions with these labels in the table of --segments",
    )


def _add_primitive(parser: argparse.ArgumentParser) -> None:
    primitive = parser.add_argument_group("primitive")
    primitive.add_argument("--name", help="name of the primitive (default: the name of the file)")
    primitive.add_argument(
        "--coupling",
        choices=COUPLINGS,
        default="arm",
        help="make a PCA of each joint, or of the whole arm (default: %(default)s)",
    )
    size = primitive.add_mutually_exclusive_group()
    size.add_argument("--components", metavar="K", type=int, help="number of components")
    size.add_argument(
        "--variance",
        type=float,
        default=0.99,
        help="share of the variance that the components explain (default: %(default)g)",
    )
    primitive.add_argument("--phases", type=int, default=101, help="number of samples per motion")
    primitive.add_argument("--degree", type=int, default=15, help="degree of the polynomials")
    primitive.add_argument(
        "--align",
        choices=ALIGNMENTS,
        default="arc_length",
        help="align motions by time, or by path length (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    old = _primitive_to_update(arguments)
    output, force = arguments.output or arguments.update, arguments.force
    check_output(output, ".npz", force=force or output == arguments.update)
    check_output(arguments.report, ".html", force=force)
    check_output(arguments.write_segments, ".csv", force=force)
    options = primitive_options(arguments)
    if old is not None:
        options = options_like(old, options)
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    recordings = RecordingSet()
    if arguments.bags:
        like = old or robot
        joints = arguments.joints if like is None else like.joint_names
        known = [old.statistics] if old and old.statistics else []
        samples = N_SAMPLES if arguments.report else 0
        recordings = load(arguments, options, joints, samples, known, robot, same_joints=True)
        recordings.require_motion()
    statistics = _statistics(recordings, old, arguments.remove)
    robot = robot and robot.with_joints(statistics.joint_names)
    name = arguments.name or (old.name if old else output.stem)
    metadata = _origin(recordings, statistics, robot, old)
    primitive = build_from_statistics(statistics, name, options, metadata)
    page = report_page(recordings, primitive, options) if arguments.report else ""
    save_primitive(primitive, output, overwrite=force or output == arguments.update)
    if arguments.report is not None:
        write_whole(arguments.report, page.encode(), overwrite=force)
    if arguments.write_segments is not None:
        table = segments_table(
            (one.recording, one.start_time, one.end_time, one.label) for one in statistics.motions
        )
        write_whole(arguments.write_segments, table, overwrite=force)
    _print(arguments, recordings, primitive, output)
    return DONE


def primitive_options(arguments: argparse.Namespace) -> PrimitiveOptions:
    """The options of primitives that were given."""
    return PrimitiveOptions(
        coupling=arguments.coupling,
        n_components=arguments.components,
        variance=arguments.variance,
        n_phases=arguments.phases,
        degree=arguments.degree,
        align=arguments.align,
    )


def _primitive_to_update(arguments: argparse.Namespace) -> MovementPrimitive | None:
    """The primitive of --update, once the options fit together."""
    if arguments.update is None:
        if arguments.remove:
            raise RecordingError("--remove removes recordings from a primitive: also pass --update")
        missing = {"at least one recording": arguments.bags, "--output FILE.npz": arguments.output}
        if lacking := [name for name, value in missing.items() if not value]:
            raise RecordingError(f"give {' and '.join(lacking)}, or --update FILE.npz")
        return None
    if arguments.report is not None:
        raise RecordingError(
            "--report needs the samples of all motions: remove --report or --update"
        )
    old = load_primitive(arguments.update)
    if arguments.joints and tuple(arguments.joints) != old.joint_names:
        raise RecordingError(f"'{old.name}' moves {quote_names(old.joint_names)}: remove --joints")
    return old


def options_like(old: MovementPrimitive, given: PrimitiveOptions) -> PrimitiveOptions:
    """The options of a primitive, changed where others than the defaults are given."""
    default, kept = asdict(PrimitiveOptions()), options_to_update(old)
    changed = {key: x for key, x in asdict(given).items() if x != default[key]}
    for key in ("n_phases", "degree", "align"):
        if key in changed and changed[key] != getattr(kept, key):
            raise PrimitiveError(
                f"'{old.name}' was built with {key.removeprefix('n_')} {getattr(kept, key)}: "
                "build it again from the recordings to change that"
            )
    return replace(kept, **changed)


def _statistics(
    recordings: RecordingSet, old: MovementPrimitive | None, removed: Sequence[str]
) -> MotionStatistics:
    """Statistics of the old motions and of the new ones."""
    new = recordings.summaries
    if old is None or old.statistics is None:
        return MotionStatistics.merged(new)
    statistics = old.statistics.added(MotionStatistics.merged(new)) if new else old.statistics
    return statistics.without(removed) if removed else statistics


def _origin(
    recordings: RecordingSet,
    statistics: MotionStatistics,
    robot: Robot | None,
    old: MovementPrimitive | None,
) -> dict[str, Any]:
    """Metadata on the recordings, and what is kept of an earlier version."""
    kept: dict[str, Any] = {}
    if old is not None:
        built = ("options", "angle_variance_ratio", "demonstrations")
        gains = with_gains_only(old.metadata)
        kept = {key: value for key, value in gains.items() if key not in built}
    repairs = kept.get("repairs", {}) | repairs_of(recordings)
    return kept | origin(statistics, repairs, robot, kept.get("prismatic_joints", []))


def repairs_of(recordings: RecordingSet) -> dict[str, Any]:
    """Repairs of each recording, by name; equal ones take memory once."""
    known: dict[str, Any] = {}
    return {r.name: known.setdefault(str(r.repairs), r.repairs) for r in recordings.reports}


def load(
    arguments: argparse.Namespace,
    options: PrimitiveOptions,
    joints: Sequence[str] | None,
    samples: int,
    known: Sequence[MotionStatistics] = (),
    robot: Robot | None = None,
    *,
    same_joints: bool = False,
) -> RecordingSet:
    """Read the recordings of a set that known motions belong to, too."""
    segmentation, markers = _segmentation(arguments), _marker_source(arguments)
    with progress_bar("reading", "B") as progress:
        return load_recordings(
            arguments.bags,
            topic=arguments.topic,
            joints=joints,
            degrees=arguments.degrees,
            moving_only=robot is not None and joints == robot.joint_names and not arguments.joints,
            known_extents=[extent for part in known for extent in part.extents.tolist()],
            segment=arguments.segment,
            segments_csv=arguments.segments,
            segmentation=segmentation,
            labels=arguments.label,
            overviews=samples > 0,
            summarise=partial(MotionStatistics.of, options=options),
            most_samples=samples,
            jobs=arguments.jobs,
            dask=arguments.dask,
            same_joints=same_joints,
            markers=markers,
            state_field=arguments.field,
            max_gap=arguments.max_gap,
            position_limits=position_limits(robot),
            salvage=arguments.recover,
            progress=progress,
        )


def _print(
    arguments: argparse.Namespace,
    recordings: RecordingSet,
    primitive: MovementPrimitive,
    output: Path,
) -> None:
    foreign, kinds = _foreign(primitive), _kinds(primitive)
    if arguments.json:
        further = {
            "foreign": [{"recording": name, "reason": why} for name, why in foreign],
            "kinds_left_out": None if kinds is None else asdict(kinds),
        }
        print_json({**_facts(recordings, primitive, output), **further})
    else:
        say(*_text(recordings, primitive, kinds, output))
    for refusal in recordings.refused:
        complain(f"rejected {refusal.recording}: {refusal.reason}")
    for recording, reason in foreign:
        complain(f"warning: {recording}: {reason}; look at it, and leave it out if it is wrong")
    if not primitive.n_components:
        complain(_without_components(primitive))


def _without_components(primitive: MovementPrimitive) -> str:
    n = len(primitive.durations)
    why = "it was learned from one motion" if n == 1 else f"its {n} motions have the same shape"
    return (
        f"warning: '{primitive.name}' has no components, because {why}: every plan has this "
        "shape, and nothing can be optimised; record motions that differ"
    )


def _segmentation(arguments: argparse.Namespace) -> SegmentationOptions:
    chosen = {"min_rest": arguments.min_rest, "min_duration": arguments.min_motion}
    given = {name: value for name, value in chosen.items() if value is not None}
    if given and (arguments.segments is not None or arguments.segment != "auto"):
        raise RecordingError(
            "--min-rest and --min-motion are for --segment auto: remove them with --segments "
            "and with --segment none"
        )
    return SegmentationOptions(**given)


def _marker_source(arguments: argparse.Namespace) -> MarkerSource | None:
    files = (arguments.robot, arguments.marker_map)
    if arguments.markers is None:
        if arguments.marker_map is not None:
            raise RecordingError("--marker-map is for recordings of markers: also pass --markers")
        return None
    if None in files:
        raise RecordingError("--markers needs --robot and --marker-map")
    if arguments.topic is not None or arguments.field is not None:
        raise RecordingError("--markers excludes --topic and --field")
    return marker_source(arguments.markers, *files, arguments.joints)


def _facts(recordings: RecordingSet, primitive: MovementPrimitive, output: Path) -> dict[str, Any]:
    ratio = primitive.explained_variance_ratio
    return {
        "output": str(output),
        "name": primitive.name,
        "n_recordings": len(recordings.reports),
        "n_motions": len(primitive.durations),
        "refused": [asdict(refusal) for refusal in recordings.refused],
        "repairs": {report.name: report.repairs for report in recordings.reports},
        "notes": {report.name: list(report.notes) for report in recordings.reports},
        "thresholds": {report.name: asdict(report.thresholds) for report in recordings.reports},
        "joint_names": list(primitive.joint_names),
        "coupling": primitive.coupling,
        "n_components": primitive.n_components,
        "explained_variance_ratio": ratio if primitive.coupling == "joint" else ratio["arm"],
        "angle_variance_ratio": primitive.metadata["angle_variance_ratio"],
        "fit_residual_rms": float(np.sqrt(np.mean(primitive.fit_residual**2))),
        "left_out_error": primitive.summary()["left_out_error"],
        "durations": primitive.durations,
        "marker_residuals": {
            report.name: {name: asdict(r) for name, r in report.marker_residuals.items()}
            for report in recordings.reports
            if report.marker_residuals
        },
    }


def _text(
    recordings: RecordingSet,
    primitive: MovementPrimitive,
    kinds: KindErrors | None,
    output: Path,
) -> list[str]:
    repaired = [f"{count} {kind}" for kind, count in recordings.repairs.items()]
    durations = primitive.durations
    unit = unit_of(primitive.joint_names, prismatic_joints(primitive))
    fit_residual = unit.number(np.sqrt(np.mean(primitive.fit_residual**2)))
    return [
        *_slowest_line(recordings),
        f"recordings  {len(recordings.reports)} used, {len(recordings.refused)} rejected",
        f"repairs     {', '.join(repaired) or 'none'}",
        *_note_lines(recordings),
        f"motions     {len(durations)} of {primitive.n_joints} joints, "
        f"{durations.min():.2f} to {durations.max():.2f} s",
        f"components  {components_words(primitive)}, which reproduce the motions to "
        f"{fit_residual} {unit.name} RMS",
        f"prediction  {prediction_words(primitive)}",
        *([] if kinds is None else [f"kinds       {kinds_words(kinds, unit)}"]),
        "",
        *variance_report(primitive),
        "",
        f"written to  {output}",
    ]


def _foreign(primitive: MovementPrimitive) -> list[tuple[str, str]]:
    """Recordings whose motions are far from those of the others, and why."""
    assert primitive.statistics is not None
    return foreign_recordings(primitive.statistics, options_to_update(primitive).n_phases)


def _kinds(primitive: MovementPrimitive) -> KindErrors | None:
    """Errors with primitives of several kinds, from at most 200 motions."""
    assert primitive.statistics is not None
    n_phases = options_to_update(primitive).n_phases
    return choose_kinds(primitive.statistics.thinned(), n_phases, KindOptions())[1]


def _slowest_line(recordings: RecordingSet, many: int = 10) -> list[str]:
    """The recordings that took most time, if there are many."""
    if len(recordings.reports) < many:
        return []
    order = nlargest(3, recordings.reports, key=lambda report: report.seconds)
    return ["slowest     " + ", ".join(f"{one.name} {one.seconds:.2g} s" for one in order)]


def _note_lines(recordings: RecordingSet, most: int = 5) -> list[str]:
    """Notes; those that differ in numbers only are one line, with at most so many names."""
    alike: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for report in recordings.reports:
        for note in report.notes:
            kind = re.sub(r"\d+", "", note)
            first.setdefault(kind, f"note        {report.name}: {note}")
            alike.setdefault(kind, []).append(report.name)
    return [
        line + (f"; so {listed(names[1:], most)}" if names[1:] else "")
        for line, names in zip(first.values(), alike.values(), strict=True)
    ]
