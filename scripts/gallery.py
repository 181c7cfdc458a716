#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of the gallery, from the example recording.

python3 scripts/gallery.py FOLDER           # the figures, as the documentation site does
python3 scripts/gallery.py --animation      # doc/animation.gif of the README
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mp_pca_planner as mp
from mp_pca_planner.plotting.arm import arm_figure
from mp_pca_planner.plotting.drawing import draw_motion, picture
from mp_pca_planner.plotting.primitive import PHASES, primitive_figure
from mp_pca_planner.plotting.recording import recording_figure
from mp_pca_planner.recordings.demonstration import RecordingSet

ROOT = Path(__file__).resolve().parents[1]
ARM = ("upper_arm", "lower_arm", "wrist")
GOAL = {"shoulder1": -1.9, "shoulder2": 0.1, "shoulder3": 0.7, "elbow": -0.5}
GREY, BLUE, ORANGE = "#8C8C8C", "#0072B2", "#D55E00"


@dataclass(frozen=True, eq=False)
class Example:
    """Demonstrations, what was learned from them, and where a motion starts."""

    recordings: RecordingSet
    primitive: mp.MovementPrimitive
    robot: mp.Robot
    start: np.ndarray

    def plan(self, basis: str = "pca", naturalness: float = 1.0) -> mp.Plan:
        """A plan to the goal of all figures."""
        options = mp.PlannerOptions(basis=basis, naturalness=naturalness, max_solve_time=60.0)
        return mp.Planner(self.robot, [self.primitive], options=options).plan(
            start=self.start, goal=GOAL
        )


def example(n_motions: int = 40) -> Example:
    """Demonstrations of the arm in config/human_arm.urdf."""
    urdf = mp.config_file("human_arm.urdf")
    with tempfile.TemporaryDirectory() as folder:
        bag = mp.write_example_recording(Path(folder) / "session.mcap", n_motions)
        recordings = mp.load_demonstrations(bag, robot=urdf, overviews=True)
    primitive = mp.MovementPrimitive.fit(recordings, name="raise_arm")
    robot = mp.Robot.from_file(urdf, primitive.joint_names)
    return Example(recordings, primitive, robot, recordings[0].positions[0])


def write_figures(folder: Path) -> None:
    """Draw all figures as PNGs."""
    folder.mkdir(parents=True, exist_ok=True)
    found, few = example(), example(6)
    robot, primitive = found.robot, found.primitive
    with picture(folder / "recording.png", force=True) as figure:
        recording_figure(figure, few.recordings.reports[0])
    with picture(folder / "primitive.png", force=True) as figure:
        shown = np.array([motion.time_normalised(PHASES.size) for motion in found.recordings])
        primitive_figure(figure, primitive, shown, "Demonstrations, mean shape and components")
    plan = found.plan()
    draw_motion(
        folder / "motion.png",
        plan.trajectory,
        title="A planned motion within its limits",
        limits=robot.limits(),
        force=True,
    )
    plans = {
        "like the demonstrations, ρ = 1": plan,
        "components, least effort, ρ = 0": found.plan(naturalness=0.0),
        "B-splines, least effort": found.plan("bspline", 0.0),
    }
    with picture(folder / "arm.png", force=True) as figure:
        chains = {
            f"{name}, {plan.effort_cost:.1f} N²m²s": robot.frame_positions(
                plan.trajectory.positions, ARM
            )
            for name, plan in plans.items()
        }
        arm_figure(figure, chains, "The same goal with three settings", ARM[-1])


def write_animation(path: Path) -> None:
    """Draw how motions are shown, a goal is given, and a motion is planned."""
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    found = example()
    # Motions away from the start, in the example recording every other one.
    shown = [found.recordings[k].time_normalised(24) for k in (0, 4, 8, 14)]
    trajectory = found.plan().trajectory
    times = np.linspace(0.0, trajectory.duration, 24)
    planned = np.column_stack(
        [np.interp(times, trajectory.times, q) for q in trajectory.positions.T]
    )
    figure = Figure(figsize=(5.2, 4.2), dpi=80, layout="constrained")
    axes = figure.subplots()
    writer = PillowWriter(fps=12)
    with writer.saving(figure, path, dpi=80):
        for k in range(24):
            _draw_person(axes, "1. Show some motions")
            for motion in shown:
                _draw_arm(axes, found.robot, motion[: k + 1], GREY)
            writer.grab_frame()
        for step, text in ((1, "2. Give a goal"), (24, "3. It moves like the shown motions")):
            for k in range(14 if step == 1 else 38):
                _draw_person(axes, text)
                for motion in shown:
                    _draw_arm(axes, found.robot, motion, GREY, only_path=True)
                goal = found.robot.frame_positions(planned[-1:], ARM)[0, -1]
                axes.plot(goal[0], goal[2], "*", color=ORANGE, markersize=18, zorder=3)
                _draw_arm(axes, found.robot, planned[: min(k, step - 1) + 1], BLUE)
                writer.grab_frame()


def _draw_person(axes: Any, title: str) -> None:
    """Begin a frame: the side view of a person without the right arm."""
    axes.clear()
    axes.set(xlim=(-0.45, 0.75), ylim=(-0.62, 0.62), aspect="equal", xticks=[], yticks=[])
    axes.set_title(title, fontsize=13)
    axes.plot([0.0, 0.0], [-0.38, 0.08], color="#D9D9D9", linewidth=34, solid_capstyle="round")
    axes.plot(0.01, 0.25, "o", color="#D9D9D9", markersize=38)


def _draw_arm(
    axes: Any, robot: mp.Robot, motion: np.ndarray, colour: str, *, only_path: bool = False
) -> None:
    """Draw the arm at the end of a motion, and the path of the hand up to there."""
    chain = robot.frame_positions(motion, ARM)[:, :, [0, 2]]
    axes.plot(*chain[:, -1].T, color=colour, linewidth=1.5, linestyle="--", alpha=0.7)
    if not only_path:
        axes.plot(*chain[-1].T, color=colour, linewidth=5, marker="o", solid_capstyle="round")


def main() -> None:
    """Draw what the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("folder", nargs="?", type=Path, help="where the figures are written")
    what.add_argument("--animation", action="store_true", help="write doc/animation.gif")
    arguments = parser.parse_args()
    if arguments.animation:
        write_animation(ROOT / "doc/animation.gif")
    else:
        write_figures(arguments.folder)


if __name__ == "__main__":
    main()
