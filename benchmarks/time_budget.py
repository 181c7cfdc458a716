# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of goals under short planning times.

A panda with the limits of MoveIt's joint_limits.yaml, and jerks of 20 times the accelerations.
Half of the goals are planned from rest; the others from a moment of a motion that is under way.
The CPU time of a plan includes the selection of primitives and the checks of motions.

    python benchmarks/time_budget.py [--goals 200] [--times 0.01 0.1 1]
"""

from __future__ import annotations

import time

import numpy as np
from scenes import scene_of
from tables import benchmark_parser, show

from mp_pca_planner.evaluation.problems import (
    held_out_problems,
    random_problems,
    robot_file,
)
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.plan import INFEASIBLE, SOLVED, STOPPED_EARLY, Plan, PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

VELOCITY = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
ACCELERATION = (3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0)
PATIENCE = 60.0
SCENE = scene_of(*robot_file("panda"), n_motions=30)


def main() -> None:
    """Print a row per time."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=200)
    parser.add_argument("--times", type=float, nargs="+", default=(0.01, 0.03, 0.1, 0.3, 1.0))
    arguments = parser.parse_args()
    planner = panda_planner()
    requests = requests_of(planner, arguments.goals)
    rows = []
    for limit in arguments.times:
        subject = Planner(
            planner.robot, planner.primitives, planner.limits, PlannerOptions(max_solve_time=limit)
        )
        plans, seconds = [], []
        for goal, start in requests:
            began = time.process_time()
            plans.append(subject.plan(goal, start))
            seconds.append(time.process_time() - began)
        worst = [f"{1e3 * x:.1f}" for x in (np.median(seconds), max(seconds))]
        rows.append([f"{limit:g}", *counts(plans), *worst])
    header = ["max_solve_time [s]", "solved", "stopped early", "refused from rest", "in motion"]
    header += ["CPU [ms], median", "worst"]
    show({"Little time": (header, rows)}, as_json=arguments.json)


def panda_planner() -> Planner:
    """A planner with a time limit."""
    overrides = {
        name: {"max_velocity": v, "max_acceleration": a, "max_jerk": 20.0 * a}
        for name, v, a in zip(SCENE.robot.joint_names, VELOCITY, ACCELERATION, strict=True)
    }
    primitive = build_primitive(SCENE.demonstrations, "panda", PrimitiveOptions("arm", 8))
    options = PlannerOptions(max_solve_time=PATIENCE)
    return Planner(SCENE.robot, [primitive], SCENE.robot.limits(overrides), options)


def requests_of(planner: Planner, n_goals: int) -> list[tuple[JointGoal, JointState]]:
    """Goals with their starts, at rest and in motion in turn."""
    draw = held_out_problems(SCENE, n_goals // 2, 2) + random_problems(SCENE, n_goals // 2, 3)
    random, names = np.random.default_rng(0), planner.robot.joint_names
    requests, moving = [], None
    for i, problem in enumerate(draw):
        goal = JointGoal(JointState(names, problem.goal))
        start = JointState(names, problem.start)
        if i % 2 and moving is not None:
            start = moving
        else:
            plan = planner.plan(goal, start)
            moment = plan.motion.duration * random.uniform(0.1, 0.9)
            moving = JointState(names, *(x[0] for x in plan.motion.evaluate(np.array([moment]))))
        requests.append((goal, start))
    return requests


def counts(plans: list[Plan]) -> list[str]:
    """Numbers of goals solved, stopped early, and rejected, from rest and in motion."""
    refused = [i % 2 for i, plan in enumerate(plans) if plan.status == INFEASIBLE]
    by_status = [sum(p.status == status for p in plans) for status in (SOLVED, STOPPED_EARLY)]
    return [str(n) for n in (*by_status, refused.count(0), refused.count(1))]


if __name__ == "__main__":
    main()
