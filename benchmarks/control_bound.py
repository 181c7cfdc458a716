# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Validity and tightness of the error bounds of control laws.

Motions of the human-like arm are planned. Each is simulated many times with errors of the model and
of the start, effort limits, sampling at 1 kHz and a delay of one sample.

    python benchmarks/control_bound.py [--motions 20] [--trials 50]
"""

from __future__ import annotations

import numpy as np
from tables import benchmark_parser, show

from mp_pca_planner.control.closed_loop import ControlLoop, ErrorModel, verify
from mp_pca_planner.control.law import KINDS, ControlLaw
from mp_pca_planner.control.stability import analyse
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.resources import config_file
from mp_pca_planner.robot.model import Robot


def main() -> None:
    """Print a row per law."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--trials", type=int, default=50, help="per motion")
    parser.add_argument("--natural-frequency", type=float, default=30.0)
    arguments = parser.parse_args()
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = generate_motions(40, 1)
    primitive = build_primitive(motions, "bound", PrimitiveOptions(n_components=6))
    planner = Planner(robot, [primitive], robot.limits())
    errors, limits = ErrorModel(), robot.limits().effort
    rows = []
    for kind in KINDS:
        held = bounded = trials = saturated = 0
        ratios = []
        for i, wanted in enumerate(generate_motions(arguments.motions, 2)):
            start, goal = (JointState(JOINT_NAMES, wanted.positions[k]) for k in (0, -1))
            motion = planner.plan(JointGoal(goal), start).trajectory
            law = ControlLaw.from_frequency(kind, robot, motion, arguments.natural_frequency)
            loop = ControlLoop(robot, law, motion, limits)
            known = analyse(loop, errors)
            found = verify(loop, errors, known.error_bound, arguments.trials, seed=i)
            trials += arguments.trials
            held += found.bound_held
            saturated += found.saturated
            bounded += known.holds
            if known.error_bound is not None:
                ratios.append(known.error_bound.max(axis=0) / found.errors.max(axis=0))
        worst, median = np.max(ratios), np.median(ratios)
        rows.append([kind, f"{bounded}", f"{trials}", f"{held}", f"{saturated}"])
        rows[-1] += [f"{median:.2f}", f"{worst:.2f}"]
    header = ["law", "motions with bound", "simulations", "bound held", "saturated"]
    header += ["bound / worst error, median", "largest"]
    show({"Bound of the tracking error": (header, rows)}, as_json=arguments.json)


if __name__ == "__main__":
    main()
