# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`build_primitives`: bags → one primitive file."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import RecordingError
from ..files import write_whole
from ..mocap.marker_joint_states import MarkerSource, marker_source
from ..plotting.drawing import require_matplotlib
from ..plotting.report import REPORT_SAMPLES, report_page
from ..plotting.units import prismatic_joints, unit_of
from ..plotting.variance import variance_report
from ..primitives.alignment import ALIGNMENTS
from ..primitives.build import build_from_statistics
from ..primitives.file import save_primitive
from ..primitives.motion_statistics import MotionStatistics
from ..primitives.options import PrimitiveOptions
from ..primitives.primitive import COUPLINGS, MovementPrimitive
from ..recordings.load import RecordingSet, load_recordings
from ..recordings.repair import RepairOptions
from ..recordings.segmentation import SegmentationOptions
from ..recordings.segments_file import segments_table
from ..robot.model import Robot
from .common import (
    JOBS,
    CommandParser,
    check_output,
    joint_list,
    no_motion,
    print_json,
    progress_bar,
    run,
    seconds,
)
from .terminal import DONE, complain, say

MAX_NAMES = 5
"""Further recordings that are named behind a note."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _build, argv)


def _parser() -> CommandParser:
    parser = CommandParser(
        "build_primitives", "Learn a movement primitive from recorded bags and write it to a file."
    )
    parser.add_argument(
        "bags",
        nargs="+",
        metavar="BAG",
        help="ROS 1 .bag, rosbag2 folder, .db3 or .mcap; globs and folders of bags too",
    )
    _add_input(parser.add_argument_group("input"))
    _add_cutting(parser.add_argument_group("cutting recordings into motions"))
    _add_primitive(parser.add_argument_group("primitive"))
    _add_output(parser.add_argument_group("output"))
    return parser


def _add_input(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--topic", help="JointState topic (default: the only one)")
    group.add_argument(
        "--field", metavar="a.b", help="field of the topic's messages that is a JointState"
    )
    group.add_argument("--joints", type=joint_list, metavar="a,b,c", help="joints, in this order")
    group.add_argument(
        "--robot", type=Path, metavar="URDF", help="take its joints, or check those of --joints"
    )
    group.add_argument(
        "--markers",
        metavar="TOPIC",
        help="find the joint angles from markers on this topic; needs --robot and --marker-map",
    )
    group.add_argument(
        "--marker-map",
        type=Path,
        metavar="FILE.yaml",
        help="where the markers sit on the robot's links",
    )
    group.add_argument(
        "--max-gap",
        type=seconds,
        metavar="S",
        help=f"cut where no message comes for longer [s] (default: {RepairOptions.gap_time}, or "
        f"{RepairOptions.gap_periods} usual periods)",
    )
    group.add_argument(
        "--salvage", action="store_true", help="of a damaged bag, take what is before the damage"
    )
    workers = group.add_mutually_exclusive_group()
    workers.add_argument(
        "--jobs", type=JOBS, default=1, metavar="N", help="recordings to read at the same time"
    )
    workers.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="have the workers of this Dask cluster read the recordings, whose paths they must "
        "see: tcp://HOST:PORT of its scheduler",
    )


def _add_cutting(group: argparse._ArgumentGroup) -> None:
    defaults = SegmentationOptions()
    group.add_argument(
        "--segment", choices=("auto", "none"), default="auto", help="cut at rests, or don't"
    )
    group.add_argument(
        "--min-rest",
        type=seconds,
        metavar="S",
        help=f"shorter rests don't cut [s] (default: {defaults.min_rest})",
    )
    group.add_argument(
        "--min-motion",
        type=seconds,
        metavar="S",
        help=f"no motion is shorter [s] (default: {defaults.min_duration})",
    )
    group.add_argument(
        "--segments",
        type=Path,
        metavar="FILE.csv",
        help="cut where this table says: recording,start_time_s,end_time_s[,label]",
    )
    group.add_argument(
        "--label",
        type=joint_list,
        metavar="a,b,c",
        help="only the motions that the table of --segments labels so",
    )


def _add_primitive(group: argparse._ArgumentGroup) -> None:
    defaults = PrimitiveOptions()
    group.add_argument("--name", help="name of the primitive (default: that of the file)")
    group.add_argument("--coupling", choices=COUPLINGS, default=defaults.coupling, help="a PCA")
    size = group.add_mutually_exclusive_group()
    size.add_argument("--components", type=int, metavar="K", help="how many to keep")
    size.add_argument(
        "--variance", type=float, default=defaults.variance, help="share that those kept explain"
    )
    group.add_argument("--phases", type=int, default=defaults.n_phases, help="samples per motion")
    group.add_argument(
        "--degree", type=int, default=defaults.degree, help="degree of the polynomials"
    )
    group.add_argument(
        "--align",
        choices=ALIGNMENTS,
        default=defaults.align,
        help="motions by their time, by their way, or to the mean shape, for which all samples are "
        "kept in memory (default: %(default)s)",
    )


def _add_output(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--output", required=True, type=Path, metavar="FILE", help="file to write")
    group.add_argument(
        "--report", type=Path, metavar="FILE.html", help="a page that shows what was found"
    )
    group.add_argument(
        "--write-segments",
        type=Path,
        metavar="FILE.csv",
        help="the motions as a table for --segments, to be edited",
    )
    group.add_argument("--force", action="store_true", help="overwrite the outputs")
    group.add_argument("--json", action="store_true", help="print one JSON object")


def _build(arguments: argparse.Namespace) -> int:
    output = arguments.output
    check_output(output, ".npz", force=arguments.force)
    check_output(arguments.report, ".html", force=arguments.force)
    check_output(arguments.write_segments, ".csv", force=arguments.force)
    if arguments.report is not None:
        require_matplotlib()
    options = PrimitiveOptions(
        coupling=arguments.coupling,
        n_components=arguments.components,
        variance=arguments.variance,
        n_phases=arguments.phases,
        degree=arguments.degree,
        align=arguments.align,
    )
    robot = None
    if arguments.robot is not None:
        robot = Robot.from_file(arguments.robot, arguments.joints)
    markers = _marker_source(arguments)
    # Dynamic time warping needs all motions at once.
    summarise = None if options.align == "dtw" else partial(MotionStatistics.of, options=options)
    with progress_bar("reading", "B") as progress:
        recordings = load_recordings(
            arguments.bags,
            topic=arguments.topic,
            joints=arguments.joints if robot is None else robot.joint_names,
            segment=arguments.segment,
            segments_csv=arguments.segments,
            segmentation=_segmentation(arguments),
            labels=arguments.label,
            overviews=arguments.report is not None,
            summarise=summarise,
            most_samples=_most_samples(arguments),
            jobs=arguments.jobs,
            dask=arguments.dask,
            markers=markers,
            state_field=arguments.field,
            repair=RepairOptions(max_gap=arguments.max_gap),
            salvage=arguments.salvage,
            progress=progress,
        )
    if not recordings.reports:
        raise no_motion(recordings)
    statistics = (
        MotionStatistics.of(recordings.demonstrations, options)
        if summarise is None
        else MotionStatistics.merged(recordings.summaries)
    )
    primitive = build_from_statistics(
        statistics,
        arguments.name or output.stem,
        options,
        {
            "repairs": {report.name: report.repairs for report in recordings.reports},
            "prismatic_joints": [] if robot is None else list(robot.prismatic_joints),
        },
    )
    page = None if arguments.report is None else report_page(recordings, primitive, options)
    save_primitive(primitive, output, overwrite=arguments.force)
    if page is not None:
        write_whole(arguments.report, page.encode(), overwrite=arguments.force)
    if arguments.write_segments is not None:
        content = segments_table(statistics.motions)
        write_whole(arguments.write_segments, content, overwrite=arguments.force)
    facts = _facts(recordings, primitive, output)
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(facts, primitive))
    for refusal in recordings.refused:
        complain(f"refused {refusal.recording}: {refusal.reason}")
    if not primitive.n_components:
        complain(_without_components(primitive))
    return DONE


def _without_components(primitive: MovementPrimitive) -> str:
    n = len(primitive.durations)
    why = "it was learned from one motion" if n == 1 else f"its {n} motions have the same shape"
    return (
        f"warning: '{primitive.name}' has no components, for {why}: every plan will have this "
        "shape, and nothing is left to optimise; record motions that differ"
    )


def _segmentation(arguments: argparse.Namespace) -> SegmentationOptions:
    chosen = {"min_rest": arguments.min_rest, "min_duration": arguments.min_motion}
    given = {name: value for name, value in chosen.items() if value is not None}
    if given and (arguments.segments is not None or arguments.segment != "auto"):
        raise RecordingError(
            "--min-rest and --min-motion are for --segment auto: leave them out with --segments "
            "and with --segment none"
        )
    return SegmentationOptions(**given)


def _most_samples(arguments: argparse.Namespace) -> int | None:
    """Samples to keep of each motion: only dynamic time warping and the report look at them."""
    if arguments.align == "dtw":
        return None
    return 0 if arguments.report is None else REPORT_SAMPLES


def _marker_source(arguments: argparse.Namespace) -> MarkerSource | None:
    files = (arguments.robot, arguments.marker_map)
    if arguments.markers is None:
        if arguments.marker_map is not None:
            raise RecordingError("--marker-map is for recordings of markers: give --markers too")
        return None
    if None in files:
        raise RecordingError("--markers needs --robot and --marker-map")
    if arguments.topic is not None or arguments.field is not None:
        raise RecordingError("--markers goes without --topic and --field")
    return marker_source(arguments.markers, *files, arguments.joints)


def _facts(recordings: RecordingSet, primitive: MovementPrimitive, output: Path) -> dict[str, Any]:
    ratio = primitive.explained_variance_ratio
    return {
        "output": str(output),
        "name": primitive.name,
        "n_recordings": len(recordings.reports),
        "n_motions": len(primitive.durations),
        "refused": [{"recording": r.recording, "reason": r.reason} for r in recordings.refused],
        "repairs": {report.name: report.repairs for report in recordings.reports},
        "notes": {report.name: list(report.notes) for report in recordings.reports},
        "thresholds": {report.name: asdict(report.thresholds) for report in recordings.reports},
        "joint_names": list(primitive.joint_names),
        "coupling": primitive.coupling,
        "n_components": primitive.n_components,
        "explained_variance_ratio": ratio if primitive.coupling == "joint" else ratio["arm"],
        "angle_variance_ratio": primitive.metadata["angle_variance_ratio"],
        "fit_residual_rms": float(np.sqrt(np.mean(primitive.fit_residual**2))),
        "durations": primitive.durations,
        "marker_residuals": {
            report.name: {name: asdict(r) for name, r in report.marker_residuals.items()}
            for report in recordings.reports
            if report.marker_residuals
        },
    }


def _text(facts: dict[str, Any], primitive: MovementPrimitive) -> list[str]:
    repairs = Counter[str]()
    for counts in facts["repairs"].values():
        repairs.update({kind: count for kind, count in counts.items() if count})
    repaired = ", ".join(f"{count} {kind}" for kind, count in sorted(repairs.items())) or "none"
    durations = primitive.durations
    unit = unit_of(primitive.joint_names, prismatic_joints(primitive))
    return [
        f"recordings  {facts['n_recordings']} used, {len(facts['refused'])} refused",
        f"repairs     {repaired}",
        *_note_lines(facts["notes"]),
        *_marker_lines(facts["marker_residuals"]),
        f"motions     {facts['n_motions']} of {primitive.n_joints} joints, "
        f"{durations.min():.2f} to {durations.max():.2f} s",
        f"components  {primitive.n_components}, coupling '{primitive.coupling}', which "
        f"reproduce the motions to {unit.number(facts['fit_residual_rms'])} {unit.name} RMS",
        "",
        *variance_report(primitive),
        "",
        f"written to  {facts['output']}",
    ]


def _note_lines(notes: dict[str, list[str]]) -> list[str]:
    """What is worth knowing about recordings; notes that differ in numbers only are said once."""
    alike: dict[str, list[tuple[str, str]]] = {}
    for name, own in notes.items():
        for note in own:
            alike.setdefault(re.sub(r"\d+", "", note), []).append((name, note))
    lines = []
    for (first, note), *others in alike.values():
        names = ", ".join(name for name, _ in others[:MAX_NAMES])
        more = f" and {len(others) - MAX_NAMES} more" if others[MAX_NAMES:] else ""
        lines.append(f"note        {first}: {note}" + (f"; so {names}{more}" if others else ""))
    return lines


def _marker_lines(residuals: dict[str, dict[str, dict[str, float]]]) -> list[str]:
    """How well the markers were met, the worst of all recordings."""
    if not residuals:
        return []
    lines = []
    for key, how in (("median", "the median"), ("percentile_95", "95 % of its frames")):
        residual, marker, name = max(
            (values[key], marker, name)
            for name, found in residuals.items()
            for marker, values in found.items()
            if values["n_frames"]
        )
        lines.append(
            f"markers     the worst, '{marker}' of '{name}', is met to {1000 * residual:.2f} mm in "
            f"{how}"
        )
    return lines
