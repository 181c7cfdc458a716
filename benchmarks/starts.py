# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Benefit and time of several starts of the optimisation.

Motions are planned for least effort within all limits, from the cheapest start and from all starts.
The starts are the expected weights, the mean shape, and the weights of the nearest demonstrations.
"Better" and "worse" mean a difference of more than 0.5 % of the effort.

    python benchmarks/starts.py [--problems 50]
"""

from __future__ import annotations

import numpy as np
from scenes import scene_of
from tables import benchmark_parser, show

from mp_pca_planner.evaluation.problems import (
    Problem,
    Scene,
    held_out_problems,
    random_problems,
    robot_file,
)
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.options import MOST_STARTS
from mp_pca_planner.planning.plan import SOLVED, PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive

ROBOTS = ("human_arm", "panda", "ur5", "kinova")
BETTER = 0.005


def main() -> None:
    """Print a row per robot, coupling and kind of problems."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=50, help="of each kind and robot")
    arguments = parser.parse_args()
    n_problems = arguments.problems
    rows = []
    for name in ROBOTS:
        scene = scene_of(*robot_file(name), n_motions=30)
        for coupling, n_components in (("arm", 8), ("joint", 4)):
            options = PrimitiveOptions(coupling, n_components)
            primitive = build_primitive(scene.demonstrations, name, options)
            planners = planners_of(scene, primitive)
            for kind, draw in (("held out", held_out_problems), ("anywhere", random_problems)):
                found = compared(list(planners.values()), draw(scene, n_problems, 2))
                for label, (gains, times) in zip(planners, found, strict=True):
                    rows.append(
                        [
                            name,
                            coupling,
                            kind,
                            str(gains.size),
                            label,
                            f"{np.mean(gains > BETTER):.0%}",
                            f"{np.mean(gains < -BETTER):.0%}",
                            f"{100.0 * np.mean(gains):.2f}",
                            f"{100.0 * gains.max(initial=0.0):.1f}",
                            f"{np.median(times):.2f}",
                        ]
                    )
    header = ["robot", "coupling", "problems", "solved", "starts", "better", "worse"]
    header += ["by [%], mean", "most", "time over one start's"]
    show({"Several starts against one": (header, rows)}, as_json=arguments.json)


def planners_of(scene: Scene, primitive: MovementPrimitive) -> dict[str, Planner]:
    """Planners that differ in their starts, the one with a single start first."""
    planners = {}
    for n in (1, MOST_STARTS):
        options = PlannerOptions(naturalness=0.0, n_starts=n)
        planners[str(n)] = Planner(scene.robot, [primitive], scene.limits, options)
    return planners


def compared(
    planners: list[Planner], problems: list[Problem]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Relative effort reduction of each planner against the first, and the ratio of times."""
    costs, times = [], []
    names = planners[0].robot.joint_names
    for problem in problems:
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        plans = [planner.plan(goal, JointState(names, problem.start)) for planner in planners]
        if all(plan.status == SOLVED for plan in plans):
            costs.append([plan.solution.cost for plan in plans])
            times.append([plan.solve_time for plan in plans])
    gains, ratios = (np.array(x) / np.array(x)[:, :1] for x in (costs, times))
    return list(zip(1.0 - gains.T, ratios.T, strict=True))


if __name__ == "__main__":
    main()
