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

from ..arrays import read_values
from ..exceptions import PrimitiveError, RecordingError
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
from ..recordings.reading import scale_of_calibration
from ..recordings.recording_set import RecordingSet
from ..recordings.segmentation import CUTS, SegmentationOptions
from ..renaming import read_rename
from ..robot.model import Robot
from .common import check_output, make_folder, primitive_lines, print_json, progress_bar
from .options import add_bag_topic, add_report, name_list, seconds, whole
from .terminal import DONE, complain, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.usage = "%(prog)s PATH… --output FILE.npz [OPTION …]"
    parser.description = "Learn a movement primitive from recorded bags and write it to a file."
    parser.add_argument(
        "bags",
        metavar="PATH",
        nargs="+",
        help="ROS 1 .bag, rosbag2 folder, .db3, .mcap; .csv; LeRobot dataset; globs and folders "
        "of these",
    )
    _add_input(parser)
    _add_markers(parser)
    _add_cutting(parser)
    _add_primitive(parser)
    parser.add_argument(
        "--output",
        metavar="FILE|FOLDER",
        type=Path,
        required=True,
        help="file to write; with --by the folder",
    )
    parser.add_argument(
        "--by",
        choices=["label", "folder"],
        help="write one primitive for each label of --segments, or for each folder of recordings",
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
        "--rename",
        metavar="OLD=NEW",
        action="append",
        default=[],
        help="new name of recorded joints, * for any text (left_*=* strips a prefix)",
    )
    parser.add_argument(
        "--scale",
        metavar="JOINT=FACTOR",
        action="append",
        default=[],
        help="factor from recorded values to rad or m; or LeRobot's calibration FILE.json",
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


def _add_markers(parser: argparse.ArgumentParser) -> None:
    markers = parser.add_argument_group("recordings of markers, with --robot")
    markers.add_argument(
        "--markers", metavar="TOPIC", help="topic of markers to compute joint angles from"
    )
    markers.add_argument(
        "--marker-map",
        metavar="FILE.yaml",
        type=Path,
        help="positions of the markers on the robot's links",
    )


def _add_cutting(parser: argparse.ArgumentParser) -> None:
    cutting = parser.add_argument_group("cutting recordings into motions")
    cutting.add_argument(
        "--segment",
        choices=["auto", "none"],
        default="auto",
        help="cut recordings at rests (auto), or don't cut them",
    )
    cutting.add_argument(
        "--cut",
        choices=CUTS,
        help="cut at rests alone, or at valleys of the speed, too (default: valleys)",
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
    primitive.add_argument(
        "--align",
        choices=ALIGNMENTS,
        default="arc_length",
        help="align motions by time, or by path length (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    _check_outputs(arguments)
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
        name = arguments.name or arguments.output.stem
        groups = {name: list(recordings.demonstrations)}
        outputs = {name: arguments.output}
    else:
        groups = _groups(recordings, arguments.by)
        outputs = {name: arguments.output / f"{name}.npz" for name in groups}
        for output in outputs.values():
            check_output(output, ".npz", force=arguments.force)
    built: dict[str, MovementPrimitive] = {}
    failed: dict[str, str] = {}
    foreign: list[tuple[str, str]] = []
    for name, motions in groups.items():
        try:
            origin = _origin(recordings, motions, robot)
            statistics = MotionStatistics.of(motions, options)
            built[name] = build_from_statistics(statistics, name, options, origin)
            foreign += foreign_recordings(statistics, options.n_phases)
        except PrimitiveError as error:
            if arguments.by is None:
                raise
            failed[name] = str(error)
    if not built:
        raise PrimitiveError("; ".join(failed.values()))
    pages = [report_page(recordings, x, foreign) for x in built.values() if arguments.report]
    for name, primitive in built.items():
        save_primitive(primitive, outputs[name], overwrite=arguments.force)
    for page in pages:
        write_whole(arguments.report, page.encode(), overwrite=arguments.force)
    if arguments.write_segments is not None:
        table = segments_table(
            (x.recording, x.start_time, x.end_time, x.label) for x in recordings.demonstrations
        )
        write_whole(arguments.write_segments, table, overwrite=arguments.force)
    _print(arguments, recordings, built, outputs, failed, foreign)
    return DONE


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Reject outputs that can't be written, before any computation."""
    if arguments.by is None:
        check_output(arguments.output, ".npz", force=arguments.force)
    else:
        if arguments.report is not None or arguments.name is not None:
            raise RecordingError("--report and --name are for one primitive: remove them or --by")
        make_folder(arguments.output)
    check_output(arguments.report, ".html", force=arguments.force)
    check_output(arguments.write_segments, ".csv", force=arguments.force)


def _load(arguments: argparse.Namespace, robot: Robot | None) -> RecordingSet:
    with progress_bar("reading", "B") as progress:
        return load_recordings(
            arguments.bags,
            topic=arguments.topic,
            joints=arguments.joints if robot is None else robot.joint_names,
            degrees=arguments.degrees,
            rename=read_rename(arguments.rename),
            scale=_scale(arguments.scale),
            moving_only=robot is not None and not arguments.joints,
            segment=arguments.segment,
            segments_csv=arguments.segments,
            segmentation=_segmentation(arguments),
            labels=arguments.label,
            overviews=arguments.report is not None,
            jobs=arguments.jobs,
            dask=arguments.dask,
            same_joints=True,
            markers=_marker_source(arguments),
            state_field=arguments.field,
            max_gap=arguments.max_gap,
            salvage=arguments.recover,
            progress=progress,
            **facts_of_robot(robot),
        )


def _groups(recordings: RecordingSet, by: str) -> dict[str, list[Demonstration]]:
    """The motions of each label, or of each folder.

    Raises
    ------
    RecordingError
        If a motion has no label, or a label can't be the name of a file.
    """
    folders = {report.name: Path(report.path).absolute().parent for report in recordings.reports}
    groups: dict[str, list[Demonstration]] = {}
    places: dict[str, Path] = {}
    for motion in recordings.demonstrations:
        name = motion.label
        if by == "folder":
            folder = folders[motion.recording]
            name = folder.name
            if places.setdefault(name, folder) != folder:
                raise RecordingError(
                    f"two folders are called '{name}', '{places[name]}' and '{folder}': rename one"
                )
        elif not name:
            raise RecordingError(
                f"a motion of '{motion.recording}' has no label: --by label needs a table of "
                "segments (--segments) in which all motions have one"
            )
        if name.startswith(".") or "/" in name or "\0" in name:
            raise RecordingError(f"the label '{name}' can't be the name of a file: change it")
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
    built: Mapping[str, MovementPrimitive],
    outputs: Mapping[str, Path],
    failed: Mapping[str, str],
    foreign: Sequence[tuple[str, str]],
) -> None:
    facts = [_facts(primitive, outputs[name]) for name, primitive in built.items()]
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
    if not arguments.json:
        for name, primitive in built.items():
            say(*primitive_lines(outputs[name], primitive))
        say("", *recordings.report.splitlines())
    else:
        several = {"primitives": facts, "failed": dict(failed)}
        print_json({**(facts[0] if arguments.by is None else several), **of_recordings})
        for note in recordings.notes:
            complain(note)
        for refusal in recordings.refused:
            complain(f"rejected {refusal.recording}: {refusal.reason}")
    for name, reason in failed.items():
        complain(f"no primitive of '{name}': {reason}")
    for recording, reason in foreign:
        complain(f"warning: {recording}: {reason}; look at it, and leave it out if it is wrong")
    for primitive in built.values():
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
    chosen = {
        "min_rest": arguments.min_rest,
        "min_duration": arguments.min_motion,
        "cut": arguments.cut,
    }
    given = {name: value for name, value in chosen.items() if value is not None}
    if given and (arguments.segments is not None or arguments.segment != "auto"):
        raise RecordingError(
            "--cut, --min-rest and --min-motion are for --segment auto: remove them with "
            "--segments and with --segment none"
        )
    return SegmentationOptions(**given)


def _scale(texts: Sequence[str]) -> dict[str, float]:
    """Factors of joints; a name alone is that of a calibration file."""
    factors: dict[str, float] = {}
    for text in texts:
        if "=" in text:
            factors |= read_values(text, "--scale", "joint")
        else:
            factors |= scale_of_calibration(text)
    return factors


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
