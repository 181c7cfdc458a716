# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`case_study`: the paper's Section 4 from recordings, and how natural planned motions are."""

from __future__ import annotations

import argparse
import csv
import io
import json
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..evaluation.case_study import CaseStudy, study
from ..exceptions import RecordingError
from ..files import exists_already, write_whole
from ..mocap.marker_joint_states import MarkerSource, marker_source, place_markers
from ..plotting.case_study_page import case_study_page, draw_pictures
from ..plotting.case_study_tables import facts, summary, tables
from ..plotting.page import require_pages
from ..recordings.bags import write_markers
from ..recordings.load import RecordingSet, load_recordings
from ..recordings.synthetic import continuous_recording, generate_motions
from ..resources import config_file
from ..robot.model import Robot
from .common import (
    JOBS,
    CommandParser,
    count,
    make_folder,
    no_motion,
    plain,
    print_json,
    progress_bar,
    run,
)
from .terminal import DONE, say

_N_GENERATED = 60
_SEED = 11
_RATE = 100.0
_EPOCH_NS = 1_700_000_000_000_000_000
# A person who stands: amplitudes [m, rad] about each axis and angular frequencies [rad/s].
_SWAY, _SWAY_ANGLE = 0.01, 0.03
_SWAY_RATES = np.array([0.7, 1.1, 0.4])
_MARKER_NOISE = 2e-4  # of an optical system: standard deviation [m]
_PAGE = "case_study.html"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _case_study, argv)


def _parser() -> CommandParser:
    parser = CommandParser(
        "case_study",
        "The case study of the paper: components of arm motions, an arm-raising motion planned "
        "with them and with B-splines, and how near planned motions come to what people did.",
    )
    parser.add_argument(
        "--recordings",
        nargs="+",
        metavar="BAG",
        help="recordings of markers, folders of them (default: markers made up for it)",
    )
    parser.add_argument("--markers", default="/markers", metavar="TOPIC", help="their topic")
    parser.add_argument(
        "--joint-states", metavar="TOPIC", help="the recordings hold joint states on this topic"
    )
    parser.add_argument(
        "--robot", type=Path, metavar="URDF", help="model (default: human_arm.urdf)"
    )
    parser.add_argument(
        "--marker-map", type=Path, metavar="YAML", help="default: human_arm_markers.yaml"
    )
    parser.add_argument("--segments", metavar="FILE.csv", help="motions cut by hand")
    parser.add_argument("--motions", type=count, default=52, metavar="N", help="how many to study")
    parser.add_argument(
        "--arm",
        default="upper_arm,lower_arm,wrist",
        metavar="A,B,C",
        help="frames along the arm, to draw it; the last is its tip",
    )
    parser.add_argument("--jobs", type=JOBS, default=1, metavar="N", help="recordings at a time")
    parser.add_argument("--output", type=Path, default=Path("case_study_output"), metavar="DIR")
    parser.add_argument("--force", action="store_true", help="overwrite what is there")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _case_study(arguments: argparse.Namespace) -> int:
    require_pages()
    folder: Path = arguments.output
    if (folder / _PAGE).exists() and not arguments.force:
        raise exists_already(folder / _PAGE)
    make_folder(folder)
    urdf = arguments.robot or config_file("human_arm.urdf")
    frames = arguments.arm.split(",")
    Robot.from_file(urdf).attach_points(frames, np.zeros((len(frames), 3)))  # refuses unknown ones
    with progress_bar("reading", "B") as progress:
        recordings, source = _recordings(arguments, urdf, progress)
    if not recordings.demonstrations:
        raise no_motion(recordings)
    motions = recordings.demonstrations
    robot = Robot.from_file(urdf, motions[0].joint_names)
    with progress_bar("planning", "motion") as progress:
        found = study(motions, arguments.motions, robot, frames[-1], progress)
    written = _write(folder, found, robot, frames, source)
    if arguments.json:
        print_json({**facts(found, source), "files": [str(path) for path in written]})
    else:
        files = ", ".join(map(str, written))
        say(source, "", *summary(found).splitlines(), "", f"written: {files}")
    return DONE


def _recordings(
    arguments: argparse.Namespace, urdf: Path, progress: Any
) -> tuple[RecordingSet, str]:
    """The motions, and a sentence that says where they come from."""
    shared = {
        "segments_csv": arguments.segments,
        "jobs": arguments.jobs,
        "progress": progress,
    }
    if arguments.recordings is None:
        if arguments.segments is not None:
            raise RecordingError("--segments is for --recordings: the generated ones have no table")
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "generated"
            markers = marker_source(
                arguments.markers,
                config_file("human_arm.urdf"),
                config_file("human_arm_markers.yaml"),
            )
            _generate(bag, markers)
            found = load_recordings([bag], markers=markers, jobs=1, progress=progress)
        return found, (
            "Joint angles by inverse kinematics from generated markers, not those of real motions: "
            "give --recordings for those of people."
        )
    names = ", ".join(map(str, arguments.recordings))
    if arguments.joint_states is not None:
        robot = Robot.from_file(urdf)
        found = load_recordings(
            arguments.recordings,
            topic=arguments.joint_states,
            joints=robot.joint_names,
            **shared,
        )
        return found, f"Joint states recorded in {names}."
    marker_map = arguments.marker_map or config_file("human_arm_markers.yaml")
    markers = marker_source(arguments.markers, urdf, marker_map)
    found = load_recordings(arguments.recordings, markers=markers, **shared)
    return found, f"Joint angles by inverse kinematics from the markers recorded in {names}."


def _generate(bag: Path, source: MarkerSource) -> None:
    """Record markers of made-up arm-raising motions, there and back, of a chest that sways."""
    recording = continuous_recording(generate_motions(_N_GENERATED, _SEED), _RATE, seed=_SEED)
    names, positions = place_markers(recording.positions, source)
    sway = np.sin(recording.times[:, None] * _SWAY_RATES)
    turns = Rotation.from_rotvec(_SWAY_ANGLE * sway)
    swayed = turns.as_matrix()[:, None] @ positions[..., None]
    measured = swayed[..., 0] + _SWAY * sway[:, None]
    measured += np.random.default_rng(_SEED).normal(0.0, _MARKER_NOISE, measured.shape)
    stamps = _EPOCH_NS + np.round(recording.times * 1e9).astype(np.int64)
    write_markers(bag, names, stamps, measured, source.topic)


def _write(
    folder: Path, found: CaseStudy, robot: Robot, frames: Sequence[str], source: str
) -> list[Path]:
    """Write pictures, tables and figures, the page last."""
    pictures = draw_pictures(found, robot, frames)
    files = {f"{name}.png": content.getvalue() for name, content in pictures.items()}
    for name, (header, rows) in tables(found).items():
        files[f"{name}.csv"] = _csv(header, rows)
    files["case_study.json"] = (json.dumps(plain(facts(found, source)), indent=1) + "\n").encode()
    files[_PAGE] = case_study_page(found, robot, frames, source, pictures).encode()
    for name, content in files.items():
        write_whole(folder / name, content, overwrite=True)
    return [folder / name for name in files]


def _csv(header: Sequence[str], rows: Iterable[Sequence[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue().encode()
