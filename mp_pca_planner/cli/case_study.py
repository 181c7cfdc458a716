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

from ..evaluation.case_study import CaseStudy, study
from ..evaluation.case_study_page import case_study_page, draw_pictures, facts, summary, tables
from ..exceptions import RecordingError
from ..files import config_file, exists_already, write_whole
from ..mocap.marker_joint_states import marker_source
from ..plotting.style import require_pages
from ..recordings.load import load_recordings
from ..recordings.recording_set import RecordingSet
from ..recordings.synthetic import write_example_recording
from ..robot.model import Robot
from .common import Progress, make_folder, plain, progress_bar, report
from .terminal import DONE

_PAGE = "case_study.html"


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
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
    recordings.require_motion()
    motions = recordings.demonstrations
    robot = Robot.from_file(urdf, motions[0].joint_names)
    with progress_bar("planning", "motion") as progress:
        n, n_starts = arguments.motions, arguments.starts
        found = study(motions, n, robot, frames[-1], progress, n_starts=n_starts)
    written = _write(folder, found, robot, frames, source)
    files = [str(path) for path in written]
    lines = [source, "", *summary(found).splitlines(), "", f"written: {', '.join(files)}"]
    report(arguments, {**facts(found, source), "files": files}, *lines)
    return DONE


def _recordings(
    arguments: argparse.Namespace, urdf: Path, progress: Progress
) -> tuple[RecordingSet, str]:
    """The motions, and a sentence on their source."""
    if arguments.recordings is None:
        return _generated(arguments, progress), (
            "Joint angles of generated motions. Pass --recordings to use recordings of people."
        )
    names = ", ".join(map(str, arguments.recordings))
    source: dict[str, Any]
    if arguments.joint_states is not None:
        source = {"topic": arguments.joint_states, "joints": Robot.from_file(urdf).joint_names}
        sentence = f"Joint states recorded in {names}."
    else:
        marker_map = arguments.marker_map or config_file("human_arm_markers.yaml")
        source = {"markers": marker_source(arguments.markers, urdf, marker_map)}
        sentence = f"Joint angles by inverse kinematics from the markers recorded in {names}."
    segments, jobs = arguments.segments, arguments.jobs
    found = load_recordings(
        arguments.recordings, segments_csv=segments, jobs=jobs, progress=progress, **source
    )
    return found, sentence


def _generated(arguments: argparse.Namespace, progress: Progress) -> RecordingSet:
    if arguments.segments is not None:
        raise RecordingError("--segments is for --recordings: generated motions have no table")
    with tempfile.TemporaryDirectory() as folder:
        bag = write_example_recording(Path(folder) / "generated.mcap", 60)
        return load_recordings([bag], progress=progress)


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
