# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives`: bags → one primitive file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import RecordingError
from ..files import write_whole
from ..mocap.marker_joint_states import MarkerSource, marker_source
from ..plotting.report import N_SAMPLES, report_page
from ..primitives.build import PrimitiveOptions, build_from_statistics, options_to_update
from ..primitives.file import save_primitive
from ..primitives.foreign import foreign_recordings
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.primitive import COUPLINGS, MovementPrimitive
from ..primitives.timing import ALIGNMENTS
from ..recordings.bags import find_recordings
from ..recordings.cutting import segments_table
from ..recordings.load import load_recordings, position_limits
from ..recordings.recording_set import RecordingSet
from ..recordings.segmentation import SegmentationOptions
from ..robot.model import Robot
from .common import check_output, make_folder, print_json, progress_bar, show
from .options import add_bag_topic, add_report, name_list, seconds, whole
from .terminal import DONE, complain

_HIDDEN = ("repairs", "thresholds", "durations", "foreign", "refused")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = "Learn a movement primitive from recorded bags and write it to a file."
    parser.add_argument(
        "bags",
        metavar="BAG",
        nargs="+",
        help="ROS 1 .bag, rosbag2 folder, .db3, .mcap; .csv; LeRobot dataset; globs and folders "
        "of these",
    )
    _add_input(parser)
    _add_primitive(parser)
    parser.add_argument(
        "--output",
        metavar="FILE.npz",
        type=Path,
        required=True,
        help="file to write; a folder with --by",
    )
    parser.add_argument(
        "--by",
        choices=["label", "folder"],
        help="write a primitive for each label of the table of --segments, or for each folder of "
        "recordings",
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
    primitive.add_argument(
        "--align",
        choices=ALIGNMENTS,
        default="arc_length",
        help="align motions by time, or by path length (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, force = arguments.output, arguments.force
    if arguments.by is None:
        check_output(output, ".npz", force=force)
    elif arguments.report is not None or arguments.write_segments is not None or arguments.name:
        raise RecordingError("--by excludes --name, --report and --write-segments")
    else:
        make_folder(output)
    check_output(arguments.report, ".html", force=force)
    check_output(arguments.write_segments, ".csv", force=force)
    options = primitive_options(arguments)
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    samples = N_SAMPLES if arguments.report else 0
    built: list[tuple[RecordingSet, MovementPrimitive, Path]] = []
    for folder, bags in _bags_by_folder(arguments).items():
        recordings = load(arguments, bags, options, samples, robot)
        recordings.require_motion()
        everything = MotionStatistics.merged(recordings.summaries)
        for label, statistics in _by_label(arguments, everything).items():
            name = arguments.name or output.stem
            if arguments.by is not None:
                name = label or folder
            file = output if arguments.by is None else _file_of(output, name)
            check_output(file, ".npz", force=force)
            metadata = _origin(recordings, statistics, robot)
            primitive = build_from_statistics(statistics, name, options, metadata)
            built.append((recordings, primitive, file))
    for _, primitive, file in built:
        save_primitive(primitive, file, overwrite=force)
    if arguments.report is not None:
        page = report_page(recordings, primitive, options)
        write_whole(arguments.report, page.encode(), overwrite=force)
    if arguments.write_segments is not None:
        table = segments_table(
            (one.recording, one.start_time, one.end_time, one.label) for one in everything.motions
        )
        write_whole(arguments.write_segments, table, overwrite=force)
    _print(arguments, built)
    return DONE


def _bags_by_folder(arguments: argparse.Namespace) -> dict[str, list[str]]:
    """The recordings of each primitive: all of them, or those of each folder."""
    if arguments.by != "folder":
        return {"": arguments.bags}
    found: dict[str, list[str]] = {}
    for path in find_recordings(arguments.bags):
        found.setdefault(path.absolute().parent.name, []).append(str(path))
    return found


def _by_label(
    arguments: argparse.Namespace, statistics: MotionStatistics
) -> dict[str, MotionStatistics]:
    """The motions of each primitive: all of them, or those of each label."""
    if arguments.by != "label":
        return {"": statistics}
    labels = statistics.labels()
    if not all(labels):
        raise RecordingError("--by label needs a label for each motion in the table of --segments")
    chosen = {name: [i for i, x in enumerate(labels) if x == name] for name in sorted({*labels})}
    return {name: statistics.chosen(which) for name, which in chosen.items()}


def _file_of(folder: Path, name: str) -> Path:
    if Path(name).name != name:
        raise RecordingError(f"'{name}' can't be the name of a file: choose a label without '/'")
    return folder / f"{name}.npz"


def primitive_options(arguments: argparse.Namespace) -> PrimitiveOptions:
    """The options of primitives that were given."""
    return PrimitiveOptions(
        coupling=arguments.coupling,
        n_components=arguments.components,
        variance=arguments.variance,
        align=arguments.align,
    )


def _origin(
    recordings: RecordingSet, statistics: MotionStatistics, robot: Robot | None
) -> dict[str, Any]:
    """Metadata: the repairs of the recordings that are in, and the prismatic joints."""
    used = {motion.recording for motion in statistics.motions}
    prismatic = robot.prismatic_joints if robot else ()
    repairs = {report.name: report.repairs for report in recordings.reports}
    return {
        "repairs": {name: counts for name, counts in repairs.items() if name in used},
        "prismatic_joints": [x for x in statistics.joint_names if x in prismatic],
    }


def load(
    arguments: argparse.Namespace,
    bags: Sequence[str],
    options: PrimitiveOptions,
    samples: int,
    robot: Robot | None,
) -> RecordingSet:
    """Read the recordings of a primitive, with samples of at most so many motions."""
    segmentation, markers = _segmentation(arguments), _marker_source(arguments)
    joints = arguments.joints if robot is None else robot.joint_names
    with progress_bar("reading", "B") as progress:
        return load_recordings(
            bags,
            topic=arguments.topic,
            joints=joints,
            degrees=arguments.degrees,
            moving_only=robot is not None and not arguments.joints,
            segment=arguments.segment,
            segments_csv=arguments.segments,
            segmentation=segmentation,
            labels=arguments.label,
            overviews=samples > 0,
            summarise=partial(MotionStatistics.of, options=options),
            most_samples=samples,
            jobs=arguments.jobs,
            dask=arguments.dask,
            same_joints=True,
            markers=markers,
            state_field=arguments.field,
            max_gap=arguments.max_gap,
            position_limits=position_limits(robot),
            salvage=arguments.recover,
            progress=progress,
        )


def _print(
    arguments: argparse.Namespace, built: Sequence[tuple[RecordingSet, MovementPrimitive, Path]]
) -> None:
    facts = [_facts(*one) for one in built]
    if arguments.json and arguments.by is not None:
        print_json({"primitives": facts})
    else:
        for each in facts:
            show(arguments, each, hidden=_HIDDEN)
    refused = {one.recording: one.reason for recordings, *_ in built for one in recordings.refused}
    for recording, reason in refused.items():
        complain(f"rejected {recording}: {reason}")
    for each in facts:
        for one in each["foreign"]:
            complain(
                f"warning: {one['recording']}: {one['reason']}; look at it, and leave it out if it "
                "is wrong"
            )
    for _, primitive, _ in built:
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
        "output": output,
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
        "foreign": [{"recording": name, "reason": why} for name, why in _foreign(primitive)],
    }


def _foreign(primitive: MovementPrimitive) -> list[tuple[str, str]]:
    """Recordings whose motions are far from those of the others, and why."""
    assert primitive.statistics is not None
    return foreign_recordings(primitive.statistics, options_to_update(primitive).n_phases)
