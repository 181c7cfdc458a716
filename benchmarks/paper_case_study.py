#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The case study of [P], Section 4: Tables 2 and 3, and Figures 2 to 4.

By default with generated motions of the human-like arm, else with recorded markers or joint states.

    python3 benchmarks/paper_case_study.py [--recordings BAG... [--segments FILE.csv]]
        [--joint-states TOPIC] [--motions 52] [--starts 100] [--output DIR] [--json]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from paper_figures import draw_pictures
from paper_method import study
from paper_tables import notes, tables
from support.tables import benchmark_parser, show

from mp_pca_planner.cli.common import progress_bar
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import config_file
from mp_pca_planner.mocap.marker_joint_states import marker_source
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import write_example_recording
from mp_pca_planner.robot.model import Robot

FRAMES = ("upper_arm", "lower_arm", "wrist")
"""Frames along the arm, to its tip."""


def main() -> int:
    """Run the case study; returns the exit status."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--recordings", nargs="+", metavar="BAG", help="default: generated motions")
    parser.add_argument("--markers", default="/markers", metavar="TOPIC")
    parser.add_argument("--joint-states", metavar="TOPIC", help="instead of markers")
    parser.add_argument("--segments", metavar="FILE.csv", help="motions that were cut by hand")
    parser.add_argument("--motions", type=int, default=52, help="number of motions to study")
    parser.add_argument("--starts", type=int, default=100, help="of each search, at least")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder of the figures")
    arguments = parser.parse_args()
    try:
        motions, source = motions_of(arguments)
        robot = Robot.from_file(config_file("human_arm.urdf"), motions[0].joint_names)
        n, n_starts = arguments.motions, arguments.starts
        with progress_bar("planning", "motion") as progress:
            found = study(motions, n, robot, FRAMES[-1], progress, n_starts=n_starts)
    except PlannerError as error:
        parser.error(str(error))
    if arguments.output is not None:
        arguments.output.mkdir(parents=True, exist_ok=True)
        draw_pictures(found, robot, FRAMES, arguments.output)
    show(
        tables(found),
        as_json=arguments.json,
        notes=[source, *notes(found)],
    )
    return 0


def motions_of(arguments: argparse.Namespace) -> tuple[list[Demonstration], str]:
    """The motions, and a sentence on their source."""
    if arguments.recordings is None:
        with tempfile.TemporaryDirectory() as folder:
            bag = write_example_recording(Path(folder) / "generated.mcap", 60)
            return load_recordings([bag]).demonstrations, "Joint angles of generated motions."
    urdf = config_file("human_arm.urdf")
    names, segments = ", ".join(arguments.recordings), arguments.segments
    if arguments.joint_states is not None:
        topic, joints = arguments.joint_states, Robot.from_file(urdf).joint_names
        found = load_recordings(
            arguments.recordings, segments_csv=segments, topic=topic, joints=joints
        )
        sentence = f"Joint states recorded in {names}."
    else:
        source = marker_source(arguments.markers, urdf, config_file("human_arm_markers.yaml"))
        found = load_recordings(arguments.recordings, segments_csv=segments, markers=source)
        sentence = f"Joint angles by inverse kinematics from the markers recorded in {names}."
    found.require_motion()
    return found.demonstrations, sentence


if __name__ == "__main__":
    sys.exit(main())
