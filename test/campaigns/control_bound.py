# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Validity and tightness of the error bounds of control laws.

Motions of the human-like arm are planned. Each is simulated many times with errors of the model and
of the start, effort limits, sampling at 1 kHz and a delay of one sample. The same for the panda,
with the same inertia of the rotor at each joint (extra example).

    python3 -m campaigns.control_bound [--motions 20] [--trials 50]
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from support.tables import options, show

from mp_pca_planner.cli.example_robots import DEMONSTRATIONS_SEED
from mp_pca_planner.control.closed_loop import ControlLoop, ErrorModel, verify
from mp_pca_planner.control.law import KINDS, ControlLaw
from mp_pca_planner.control.stability import analyse
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.examples import example_file
from mp_pca_planner.robot.model import Robot

FREQUENCY = 30.0  # natural frequency of the laws [rad/s]
ARMATURES = (0.0, 0.05, 0.1)
"""Inertias of the panda's rotors [kg·m²]."""

HEADER = ["law", "motions with bound", "simulations", "bound held", "saturated"]
HEADER += ["bound / worst error, median", "largest"]


def main() -> None:
    """Print a row per law."""
    arguments = options(__doc__, motions=20, trials=50, json=False)
    n = arguments.trials
    arm = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    wanted = generate_motions(arguments.motions, 2)
    motions = planned(arm, generate_motions(40, 1), wanted)
    rows = [bounds(kind, arm, motions, n) for kind in KINDS]
    urdf, joints = example_file("panda")
    panda = Robot.from_file(urdf, joints)
    reaches = random_reaches(panda, panda.limits(), 24, DEMONSTRATIONS_SEED)
    motions = planned(panda, reaches[4:], reaches[:4])

    def driven(size: float) -> Robot:
        return panda.with_drives({joint: {"armature": size} for joint in panda.joint_names})

    of_panda = [
        [f"{size:g}", *bounds(kind, driven(size), motions, 5)]
        for kind in KINDS
        for size in ARMATURES
    ]
    tables = {
        "Bound of the tracking error": (HEADER, rows),
        "Panda, by inertias of the rotors": (["armature [kg·m²]", *HEADER], of_panda),
    }
    show(tables, as_json=arguments.json)


def planned(
    robot: Robot, demonstrations: Sequence[Demonstration], wanted: Sequence[Demonstration]
) -> list[Trajectory]:
    """Motions between the ends of the wanted ones."""
    primitive = build_primitive(demonstrations, "bound", PrimitiveOptions(n_components=6))
    planner, names = Planner(robot, [primitive], robot.limits(), collision=False), robot.joint_names
    ends = [[JointState(names, motion.positions[k]) for k in (0, -1)] for motion in wanted]
    return [planner.plan(JointGoal(goal), start).trajectory for start, goal in ends]


def bounds(kind: str, robot: Robot, motions: Sequence[Trajectory], n_trials: int) -> list[str]:
    """Row of a law: bounds of motions, and simulations of them."""
    held = bounded = saturated = 0
    ratios = [np.full(robot.n_joints, np.nan)]
    errors, limits = ErrorModel(), robot.limits().effort
    for i, motion in enumerate(motions):
        law = ControlLaw.from_frequency(kind, robot, motion, FREQUENCY)
        loop = ControlLoop(robot, law, motion, limits)
        known = analyse(loop, errors)
        found = verify(loop, errors, known.error_bound, n_trials, seed=i)
        held += found.bound_held
        saturated += found.saturated
        bounded += known.holds
        if known.error_bound is not None:
            ratios.append(known.error_bound.max(axis=0) / found.errors.max(axis=0))
    row = [kind, f"{bounded}", f"{len(motions) * n_trials}", f"{held}", f"{saturated}"]
    if not bounded:
        return [*row, "", ""]
    return [*row, f"{np.nanmedian(ratios):.2f}", f"{np.nanmax(ratios):.2f}"]


if __name__ == "__main__":
    main()
