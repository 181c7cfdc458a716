# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How often another start finds a better motion than the first.

Motions are planned for least effort within all limits, from one start and from all: the expected
weights, the mean shape, and the nearest demonstrations', the cheapest first. Better: by more than
0.5 % of the effort.

    python benchmarks/starts.py [--problems 50]
"""

from __future__ import annotations

import argparse

import numpy as np

from mp_pca_planner.benchmarking.problems import (
    Problem,
    held_out_problems,
    random_problems,
    robot_file,
    scene_of,
)
from mp_pca_planner.cli.common import table
from mp_pca_planner.goal import JointGoal, JointState
from mp_pca_planner.planning.planner import SOLVED, Planner, PlannerOptions
from mp_pca_planner.planning.starts import MOST_STARTS
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

ROBOTS = ("human_arm", "panda", "ur5", "kinova")
BETTER = 0.005


def main() -> None:
    """Print a row per robot, coupling and kind of problems."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=50, help="of each kind and robot")
    n_problems = parser.parse_args().problems
    rows = []
    for name in ROBOTS:
        scene = scene_of(*robot_file(name), n_motions=30)
        for coupling, n_components in (("arm", 8), ("joint", 4)):
            options = PrimitiveOptions(coupling, n_components)
            primitive = build_primitive(scene.demonstrations, name, options)
            planners = [
                Planner(
                    scene.robot,
                    [primitive],
                    scene.limits,
                    PlannerOptions(naturalness=0.0, n_starts=n),
                )
                for n in (1, MOST_STARTS)
            ]
            for kind, draw in (("held out", held_out_problems), ("anywhere", random_problems)):
                gains, times = compared(planners, draw(scene, n_problems, 2))
                rows.append(
                    [
                        name,
                        coupling,
                        kind,
                        str(gains.size),
                        f"{np.mean(gains > BETTER):.0%}",
                        f"{100.0 * np.mean(gains):.2f}",
                        f"{100.0 * gains.max(initial=0.0):.1f}",
                        f"{np.median(times):.1f}",
                    ]
                )
    header = ["robot", "coupling", "problems", "solved", "better by > 0.5 %"]
    header += ["by [%], mean", "most", "time of all over one"]
    print(table(rows, header=header))


def compared(planners: list[Planner], problems: list[Problem]) -> tuple[np.ndarray, np.ndarray]:
    """By which share of the effort all starts are better than one, and the ratio of the times."""
    gains, times = [], []
    names = planners[0].robot.joint_names
    for problem in problems:
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        one, all_of_them = (p.plan(goal, JointState(names, problem.start)) for p in planners)
        if one.status == all_of_them.status == SOLVED:
            gains.append(1.0 - all_of_them.solution.cost / one.solution.cost)
            times.append(all_of_them.solve_time / one.solve_time)
    return np.array(gains), np.array(times)


if __name__ == "__main__":
    main()
