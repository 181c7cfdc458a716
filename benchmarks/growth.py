# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Growth of the planning time with the numbers of quadrature nodes and of weights.

Motions of arms of 4, 7 and 14 joints are planned for least effort within all limits, with
components that move all joints together. Times are medians over the problems, of a whole plan and
of one solver iteration with its pass over the nodes. Every problem is solved with each number in
turn. The exponent is that of a power law fitted to the times: 1 is linear growth.

    python benchmarks/growth.py [--problems 20]
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from example_robot_data.robots_loader import getModelPath
from scenes import scene_of
from tables import benchmark_parser, show

from mp_pca_planner.evaluation.problems import (
    Problem,
    Scene,
    held_out_problems,
    robot_file,
)
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.motion import N_NODES
from mp_pca_planner.planning.plan import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

NODES = (28, 56, 112, 224)
WEIGHTS = (4, 8, 16, 32)
N_WEIGHTS = 8
BAXTER = "baxter_description/urdf/baxter.urdf"


@dataclass(frozen=True)
class Measured:
    """Median times of a whole plan and of one pass [s], and passes."""

    plan: float
    one_pass: float
    passes: float


def main() -> None:
    """Print both tables."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=20, help="for each robot")
    arguments = parser.parse_args()
    n_problems = arguments.problems
    by_nodes, by_weights = [], []
    for scene in scenes():
        problems = held_out_problems(scene, n_problems, 2)
        few = planner(scene, N_WEIGHTS, N_NODES)
        by_nodes += rows(scene, NODES, [planner(scene, N_WEIGHTS, n, few) for n in NODES], problems)
        by_weights += rows(scene, WEIGHTS, [planner(scene, n, N_NODES) for n in WEIGHTS], problems)
    columns = ["passes", "a plan [ms]", "a pass [ms]"]
    tables = {
        f"Growth with nodes, {N_WEIGHTS} weights": (
            ["robot", "joints", "nodes", *columns],
            by_nodes,
        ),
        "Growth with weights": (["robot", "joints", "weights", *columns], by_weights),
    }
    show(tables, as_json=arguments.json)


def scenes() -> list[Scene]:
    """The human-like arm, one arm, and two arms."""
    baxter = Path(getModelPath(BAXTER)) / BAXTER
    arms = tuple(
        f"{side}_{name}"
        for side in ("left", "right")
        for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
    )
    robots = (robot_file("human_arm"), robot_file("panda"), ("two arms of baxter", baxter, arms))
    return [scene_of(*robot, n_motions=60) for robot in robots]


def planner(scene: Scene, n_weights: int, n_nodes: int, like: Planner | None = None) -> Planner:
    """A planner for least effort, with the primitive of another planner if one is given."""
    options = PrimitiveOptions("arm", n_weights)
    primitives = (
        like.primitives
        if like is not None
        else [build_primitive(scene.demonstrations, scene.name, options)]
    )
    options = PlannerOptions(naturalness=0.0, n_nodes=n_nodes, max_solve_time=60.0)
    return Planner(scene.robot, primitives, scene.limits, options)


def rows(
    scene: Scene, numbers: tuple[int, ...], planners: list[Planner], problems: list[Problem]
) -> list[list[str]]:
    """A row per number, and one with the exponents."""
    measured = [Measured(*x) for x in np.median(timed(planners, problems), axis=1)]
    start = [scene.name, str(scene.robot.n_joints)]
    found = [
        [*start, str(n), f"{m.passes:g}", f"{1e3 * m.plan:.2f}", f"{1e3 * m.one_pass:.3f}"]
        for n, m in zip(numbers, measured, strict=True)
    ]
    exponents = [
        float(np.polyfit(np.log(numbers), np.log(times), 1)[0])
        for times in ([m.plan for m in measured], [m.one_pass for m in measured])
    ]
    return [*found, [*start, "exponent", "", *(f"{x:.2f}" for x in exponents)]]


def timed(planners: list[Planner], problems: list[Problem]) -> np.ndarray:
    """Times of a plan and of a pass [s], and passes, shape (n_planners, n_problems, 3)."""
    found = np.empty((len(planners), len(problems), 3))
    for i, problem in enumerate(problems):
        for k, one in enumerate(planners):
            names = one.robot.joint_names
            goal = JointGoal(JointState(names, problem.goal), problem.duration)
            plan = one.plan(goal, JointState(names, problem.start))
            passes = plan.solution.iterations
            found[k, i] = plan.solve_time, plan.solve_time / passes, passes
    return found


if __name__ == "__main__":
    main()
