# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives`: recordings → one primitive file, or one for each label or folder."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import RecordingError
from ..files import write_whole
from ..mocap.marker_joint_states import MarkerSource, marker_source
from ..plotting.report import report_page
from ..primitives.build import PrimitiveOptions, build_from_statistics
from ..primitives.file import save_primitive
from ..primitives.foreign import foreign_recordings
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.primitive import COUPLINGS, MovementPrimitive
from ..primitives.timing import ALIGNMENTS
from ..recordings.cutting import segments_table
from ..recordings.demonstration import Demonstration
from ..recordings.load import facts_of_robot, load_recordings
from ..recordings.options import CUTS, MIN_REST
from ..recordings.recording_set import RecordingSet
from ..robot.model import Robot
from .common import check_output, make_folder, primitive_lines, print_json, progress_bar
from .options import (
    add_bag_topic,
    add_file,
    add_report,
    add_units,
    name_list,
    number,
    reading_options,
    seconds,
)
from .terminal import DONE, complain, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.usage = "%(prog)s PATH… --output FILE.npz [OPTION …]"
    parser.description = "Learn a movement primitive from recordings and write it to a file."
    help_text = ".bag, .db3, .mcap, .csv, LeRobot dataset; globs and folders of these"
    parser.add_argument("bags", metavar="PATH", nargs="+", help=help_text)
    help_text = "file to write; with --by the folder"
    output: dict[str, Any] = {"metavar": "FILE|FOLDER", "type": Path, "required": True}
    parser.add_argument("--output", **output, help=help_text)
    help_text = "a primitive for each label of --segments, or folder of recordings"
    parser.add_argument("--by", choices=["label", "folder"], help=help_text)
    add_file(parser, "--report", "FILE.html", "page of recordings, cuts and components to write")
    add_report(parser)
    _add_recordings(parser.add_argument_group("recordings"))
    _add_joints(parser.add_argument_group("joints"))
    _add_cutting(parser.add_argument_group("cutting recordings into motions"))
    _add_primitive(parser.add_argument_group("primitive"))


def _add_recordings(group: argparse._ArgumentGroup) -> None:
    add_bag_topic(group)
    help_text = "topic of markers to compute joint angles of --robot from"
    group.add_argument("--markers", metavar="TOPIC", help=help_text)
    add_file(group, "--marker-map", "FILE.yaml", "positions of the markers on the links")
    help_text = "longest gap that doesn't cut [s] (default: 0.5, or 5 usual periods)"
    group.add_argument("--max-gap", metavar="S", type=seconds, help=help_text)
    workers = group.add_mutually_exclusive_group()
    help_text = "number of recordings to read at the same time"
    workers.add_argument(
        "--jobs", metavar="N", type=number(1, 1024, kind=int), default=1, help=help_text
    )
    help_text = "scheduler tcp://HOST:PORT of a Dask cluster that reads them"
    workers.add_argument("--dask", metavar="ADDRESS", help=help_text)


def _add_joints(group: argparse._ArgumentGroup) -> None:
    help_text = "joints to use, in this order (default: those that move)"
    group.add_argument("--joints", metavar="a,b,c", type=name_list, help=help_text)
    add_file(group, "--robot", "URDF", "robot of the recordings, whose joints are used")
    add_units(group)


def _add_cutting(group: argparse._ArgumentGroup) -> None:
    help_text = "cut at rests (auto, the default), or don't cut"
    group.add_argument("--segment", choices=["auto", "none"], default="auto", help=help_text)
    help_text = "at rests, or at valleys of the speed, too (default; episodes stay whole)"
    group.add_argument("--cut", choices=CUTS, help=help_text)
    help_text = f"shortest rest that cuts, in episodes, too [s] (default: {MIN_REST})"
    group.add_argument("--min-rest", metavar="S", type=seconds, help=help_text)
    add_file(group, "--segments", "FILE.csv", "table recording,start_time_s,end_time_s[,label]")
    add_file(group, "--write-segments", "FILE.csv", "table of the motions to write")


def _add_primitive(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--name", help="name of the primitive (default: that of the file)")
    help_text = "a PCA of each joint, or of the whole arm (default: %(default)s)"
    group.add_argument("--coupling", choices=COUPLINGS, default="arm", help=help_text)
    size = group.add_mutually_exclusive_group()
    size.add_argument("--components", metavar="K", type=int, help="number of components")
    help_text = "share that the components explain (default: %(default)g)"
    size.add_argument("--variance", metavar="X", type=float, default=0.99, help=help_text)
    help_text = "align motions by time, or by path length (default: %(default)s)"
    group.add_argument("--align", choices=ALIGNMENTS, default="arc_length", help=help_text)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, force = arguments.output, arguments.force
    check_output(arguments.report, ".html", force=force)
    check_output(arguments.write_segments, ".csv", force=force)
    if arguments.by is None:
        check_output(output, ".npz", force=force)
    elif arguments.report is not None or arguments.name is not None:
        raise RecordingError("--report and --name are for one primitive: remove them or --by")
    options = PrimitiveOptions(
        coupling=arguments.coupling,
        n_components=arguments.components,
        variance=arguments.variance,
        align=arguments.align,
    )
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    recordings = _load(arguments, robot)
    recordings.require_motion()
    if arguments.by is None:
        groups = {output: list(recordings.demonstrations)}
    else:
        make_folder(output)
        found = _groups(recordings, arguments.by)
        groups = {output / f"{name}.npz": motions for name, motions in found.items()}
        for file in groups:
            check_output(file, ".npz", force=force)
    built: dict[Path, MovementPrimitive] = {}
    foreign: list[tuple[str, str]] = []
    for file, motions in groups.items():
        origin = _origin(recordings, motions, robot)
        statistics = MotionStatistics.of(motions, options)
        name = arguments.name or file.stem
        built[file] = build_from_statistics(statistics, name, options, origin)
        foreign += foreign_recordings(statistics, options.n_phases)
    page = report_page(recordings, built[output], foreign) if arguments.report else ""
    for file, primitive in built.items():
        save_primitive(primitive, file, overwrite=force)
    if page:
        write_whole(arguments.report, page.encode(), overwrite=force)
    if arguments.write_segments is not None:
        table = segments_table(
            (x.recording, x.start_time, x.end_time, x.label) for x in recordings.demonstrations
        )
        write_whole(arguments.write_segments, table, overwrite=force)
    _print(arguments, recordings, built, foreign)
    return DONE


def _load(arguments: argparse.Namespace, robot: Robot | None) -> RecordingSet:
    with progress_bar("reading", "B") as progress:
        return load_recordings(
            arguments.bags,
            joints=arguments.joints if robot is None else robot.joint_names,
            moving_only=robot is not None and not arguments.joints,
            segment=arguments.segment,
            segments_csv=arguments.segments,
            cut=arguments.cut,
            min_rest=arguments.min_rest,
            jobs=arguments.jobs,
            dask=arguments.dask,
            same_joints=True,
            markers=_marker_source(arguments),
            max_gap=arguments.max_gap,
            progress=progress,
            **reading_options(arguments),
            **facts_of_robot(robot),
        )


def _groups(recordings: RecordingSet, by: str) -> dict[str, list[Demonstration]]:
    """The motions of each label, or of each folder.

    Raises
    ------
    RecordingError
        If a motion has no label, a label can't be the name of a file, or two folders have the same
        name.
    """
    folders = {report.name: Path(report.path).absolute().parent for report in recordings.reports}
    groups: dict[str, list[Demonstration]] = {}
    places: dict[str, Path] = {}
    for motion in recordings.demonstrations:
        folder = folders[motion.recording]
        name = motion.label if by == "label" else folder.name
        if not name:
            raise RecordingError(
                f"a motion of '{motion.recording}' has no label: --by label needs a table of "
                "segments (--segments) in which all motions have one"
            )
        if "/" in name or name.startswith("."):
            raise RecordingError(f"the label '{name}' can't be the name of a file: change it")
        if by == "folder" and places.setdefault(name, folder) != folder:
            raise RecordingError(
                f"two folders are called '{name}', '{places[name]}' and '{folder}': rename one"
            )
        groups.setdefault(name, []).append(motion)
    return groups


def _origin(
    recordings: RecordingSet, motions: Sequence[Demonstration], robot: Robot | None
) -> dict[str, Any]:
    """Metadata: the repairs of the recordings that are in, and the prismatic joints."""
    used = {motion.recording for motion in motions}
    prismatic = robot.prismatic_joints if robot else ()
    return {
        "repairs": {one.name: one.repairs for one in recordings.reports if one.name in used},
        "prismatic_joints": [x for x in motions[0].joint_names if x in prismatic],
    }


def _print(
    arguments: argparse.Namespace,
    recordings: RecordingSet,
    built: Mapping[Path, MovementPrimitive],
    foreign: Sequence[tuple[str, str]],
) -> None:
    if arguments.json:
        facts = [_facts(primitive, file) for file, primitive in built.items()]
        of_recordings = {
            "n_recordings": len(recordings.reports),
            "refused": [asdict(refusal) for refusal in recordings.refused],
            "repairs": {report.name: report.repairs for report in recordings.reports},
            "notes": {report.name: list(report.notes) for report in recordings.reports},
            "foreign": [{"recording": name, "reason": why} for name, why in foreign],
            "marker_residuals": {
                report.name: {name: asdict(r) for name, r in report.marker_residuals.items()}
                for report in recordings.reports
                if report.marker_residuals
            },
        }
        of_primitives = facts[0] if arguments.by is None else {"primitives": facts}
        print_json(of_primitives | of_recordings)
    else:
        for file, primitive in built.items():
            say(*primitive_lines(file, primitive))
        say("", *recordings.report.splitlines())
    for recording, reason in foreign:
        complain(f"warning: {recording}: {reason}; look at it, and leave it out if it is wrong")
    for primitive in built.values():
        if not primitive.n_components:
            complain(
                f"warning: '{primitive.name}' has no components, as its motions have one shape: "
                "every plan has it, and nothing can be optimised; record motions that differ"
            )


def _marker_source(arguments: argparse.Namespace) -> MarkerSource | None:
    if arguments.markers is None and arguments.marker_map is None:
        return None
    needed = arguments.markers, arguments.robot, arguments.marker_map
    if None in needed or arguments.topic or arguments.field:
        needs = "--markers needs --robot and --marker-map, and excludes --topic and --field"
        raise RecordingError(needs)
    return marker_source(*needed, arguments.joints)


def _facts(primitive: MovementPrimitive, output: Path) -> dict[str, Any]:
    ratio = primitive.explained_variance_ratio
    return {
        "output": str(output),
        "name": primitive.name,
        "n_motions": len(primitive.durations),
        "joint_names": list(primitive.joint_names),
        "coupling": primitive.coupling,
        "n_components": primitive.n_components,
        "explained_variance_ratio": ratio if primitive.coupling == "joint" else ratio["arm"],
        "angle_variance_ratio": primitive.metadata["angle_variance_ratio"],
        "fit_residual_rms": float(np.sqrt(np.mean(primitive.fit_residual**2))),
        "left_out_error": primitive.summary()["left_out_error"],
        "durations": primitive.durations,
    }
