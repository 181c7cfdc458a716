#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of the gallery, from the example recording.

python3 scripts/gallery.py doc/gallery
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import mp_pca_planner as mp
from mp_pca_planner.plotting.motion import plan_figure
from mp_pca_planner.plotting.primitive import PHASES, primitive_figure
from mp_pca_planner.plotting.report import recording_figure
from mp_pca_planner.plotting.style import picture
from mp_pca_planner.recordings.recording_set import RecordingSet

GOAL = {"shoulder1": -1.9, "shoulder2": 0.1, "shoulder3": 0.7, "elbow": -0.5}


@dataclass(frozen=True, eq=False)
class Example:
    """Demonstrations, what was learned from them, and where a motion starts."""

    recordings: RecordingSet
    primitive: mp.MovementPrimitive
    robot: mp.Robot
    start: np.ndarray

    def planner(self) -> mp.Planner:
        """A planner with much time."""
        options = mp.PlannerOptions(max_solve_time=60.0)
        return mp.Planner(self.robot, [self.primitive], options=options)

    def plan(self) -> mp.Plan:
        """A plan to the goal of the figure."""
        return self.planner().plan(start=self.start, goal=GOAL)


def example(n_motions: int = 40) -> Example:
    """Demonstrations of the arm in config/human_arm.urdf."""
    urdf = mp.config_file("human_arm.urdf")
    with tempfile.TemporaryDirectory() as folder:
        bag = mp.write_example_recording(Path(folder) / "session.mcap", n_motions)
        recordings = mp.load_demonstrations(bag, robot=urdf)
    primitive = mp.MovementPrimitive.fit(recordings, name="raise_arm")
    robot = mp.Robot.from_file(urdf, primitive.joint_names)
    return Example(recordings, primitive, robot, recordings[0].positions[0])


def write_figures(folder: Path) -> None:
    """Draw all figures as PNGs."""
    folder.mkdir(parents=True, exist_ok=True)
    found, few = example(), example(6)
    with picture(folder / "recording.png", force=True) as figure:
        recording_figure(figure, few.recordings.reports[0])
    with picture(folder / "primitive.png", force=True) as figure:
        shown = np.array([motion.time_normalised(PHASES.size) for motion in found.recordings])
        title = "Demonstrations and components"
        primitive_figure(figure, found.primitive, shown, title)
    with picture(folder / "motion.png", force=True) as figure:
        plan_figure(figure, found.plan(), found.planner())
    for file in (
        folder / f"{name}.png" for name in ("recording", "primitive", "motion")
    ):  # a few colours make small files
        Image.open(file).convert("RGB").quantize(64).save(file, optimize=True)


def main() -> None:
    """Draw what the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the figures are written")
    write_figures(parser.parse_args().folder)


if __name__ == "__main__":
    main()
