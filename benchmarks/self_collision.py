# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Frequency of self-collisions, and cost of the detours that avoid them.

Held-out motions and ends anywhere within the limits are planned with and without self-collision
avoidance. Problems whose ends are in collision are left out.

    python benchmarks/self_collision.py [--problems 50]
"""

from __future__ import annotations

import time

import numpy as np
from scenes import scene_of
from tables import benchmark_parser, show

from mp_pca_planner.evaluation.problems import (
    Problem,
    held_out_problems,
    random_problems,
    robot_file,
)
from mp_pca_planner.motion.collision import CollisionModel, package_folders
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.planner import Planner, PlannerOptions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

ROBOTS = ("human_arm", "panda", "ur5", "kinova")


def main() -> None:
    """Print a row per robot, kind of problems and naturalness."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=50, help="of each kind and robot")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    arguments = parser.parse_args()
    rows = []
    for name in arguments.robots:
        scene = scene_of(*robot_file(name), n_motions=30)
        folders = package_folders([], scene.urdf)
        collision = CollisionModel(scene.robot, package_dirs=folders)
        options = PrimitiveOptions("arm", 8)
        primitive = build_primitive(scene.demonstrations, name, options)
        for kind, draw in (("held out", held_out_problems), ("anywhere", random_problems)):
            problems = draw(scene, arguments.problems, 2)
            for naturalness in (0.0, 1.0):
                bare, careful = (
                    Planner(
                        scene.robot,
                        [primitive],
                        scene.limits,
                        PlannerOptions(naturalness=naturalness, max_solve_time=20.0),
                        one,
                    )
                    for one in (None, collision)
                )
                found = compared(bare, careful, collision, problems)
                rows.append([name, kind, f"{naturalness:g}", *found])
    header = ["robot", "problems", "ρ", "free at the ends", "hit", "solved", "effort", "worst"]
    header += ["check [ms]", "plan [ms]", "detour [ms]"]
    show({"Self-collision": (header, rows)}, as_json=arguments.json)


def compared(
    bare: Planner, careful: Planner, collision: CollisionModel, problems: list[Problem]
) -> list[str]:
    """Counts, effort ratios of motions with a detour, and times."""
    names = bare.robot.joint_names
    n_free, n_hits, n_solved = 0, 0, 0
    efforts: list[float] = []
    checks, usual, around = [], [], []
    for problem in problems:
        start = JointState(names, problem.start)
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        first, _ = timed(lambda goal=goal, start=start: bare.plan(goal, start))
        hits, taken = timed(lambda first=first: collision.collisions(first.trajectory))
        end = first.motion.duration
        if any(one.first_time == 0.0 or one.last_time >= end for one in hits):
            continue
        n_free += 1
        n_hits += bool(hits)
        plan, whole = timed(lambda goal=goal, start=start: careful.plan(goal, start))
        (around if hits else usual).append(whole)
        if hits:
            assert not (plan.is_executable and collision.collisions(plan.trajectory))
            n_solved += plan.is_executable
            if plan.is_executable:
                efforts.append(plan.solution.effort_cost / first.solution.effort_cost)
        else:
            checks.append(taken)
    return [
        str(n_free),
        str(n_hits),
        str(n_solved),
        f"{np.median(efforts):.3f}" if efforts else "",
        f"{max(efforts):.2f}" if efforts else "",
        *(f"{1e3 * np.median(times):.0f}" if times else "" for times in (checks, usual, around)),
    ]


def timed(function):
    """The result of a function and its computing time [s]."""
    began = time.perf_counter()
    found = function()
    return found, time.perf_counter() - began


if __name__ == "__main__":
    main()
