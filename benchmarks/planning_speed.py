# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning times for two arms, and accuracy of the quadrature.

Every row is the median over different goals, planned in one run within all limits. The floor is
the time of ten passes of the dynamics alone: the time of one `computeRNEADerivatives` call from
Python, measured in the same run between the plans, times the number of nodes, times ten.

    python benchmarks/planning_speed.py [--goals 200] [--json]
"""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
from problems import Problem, Scene, held_out_problems, scene_of
from referee import RigidArm
from tables import benchmark_parser, show

from mp_pca_planner.cli.example_robots import robot_file
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.motion import Tables
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.program.segment import SegmentProgram, Unknowns
from mp_pca_planner.primitives.basis import Basis, BSplineBasis
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.robot.model import Robot

ROBOTS = ("human_arm", "panda")
N_MANY_NODES = 200
CALLS_PER_PLAN = 20
FLOOR_PASSES = 10


def main() -> None:
    """Print a row per robot and basis."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=200)
    arguments = parser.parse_args()
    n_goals = arguments.goals
    rows = []
    for name in ROBOTS:
        scene = scene_of(*robot_file(name), n_motions=40)
        rows += rows_of(scene, held_out_problems(scene, n_goals, 2))
    header = ["robot", "basis", "ρ", "weights", "nodes", "solve [ms]", "99 %", "passes"]
    header += ["within limits [%]", "call [µs]", "solve / floor", "quadrature error [%]"]
    show({"Planning times, medians over goals": (header, rows)}, as_json=arguments.json)


def rows_of(scene: Scene, problems: list[Problem]) -> list[list[str]]:
    """A row per basis."""
    rows = []
    for label, coupling, components, basis_name, naturalness in (
        ("components, arm", "arm", 8, "pca", 1.0),
        ("components, arm", "arm", 8, "pca", 0.0),
        ("components, joint", "joint", 4, "pca", 1.0),
        ("components, joint", "joint", 4, "pca", 0.0),
        ("B-splines", "arm", 8, "bspline", 0.0),
    ):
        options = PrimitiveOptions(coupling=coupling, n_components=components)
        primitive = build_primitive(scene.demonstrations, "speed", options)
        planner = Planner(
            scene.robot,
            [primitive],
            scene.limits,
            PlannerOptions(basis=basis_name, naturalness=naturalness),
        )
        plans, call = timed_plans(planner, scene, problems)
        splines = BSplineBasis(scene.robot.n_joints)
        basis: Basis = primitive.basis if basis_name == "pca" else splines
        nodes = Tables(basis).n_nodes
        solve = np.array([plan.solve_time for plan in plans])
        floor = FLOOR_PASSES * nodes * call
        rows.append(
            [
                scene.name,
                label,
                f"{naturalness:g}",
                str(basis.n_weights),
                str(nodes),
                f"{1e3 * np.median(solve):.2f}",
                f"{1e3 * np.percentile(solve, 99):.2f}",
                f"{np.median([plan.solution.iterations for plan in plans]):g}",
                f"{100 * np.mean([plan.is_executable for plan in plans]):.0f}",
                f"{1e6 * call:.2f}",
                f"{np.median(solve) / floor:.1f}",
                f"{100 * max(quadrature_error(scene.robot, plan) for plan in plans):.4f}",
            ]
        )
    return rows


def timed_plans(
    planner: Planner, scene: Scene, problems: list[Problem]
) -> tuple[list[Plan], float]:
    """Plans of all problems, and the median time of one call of the dynamics between them [s]."""
    names = scene.robot.joint_names
    model = RigidArm(scene.urdf, names).model
    data, calls, plans = model.createData(), [], []
    q, v = pin.neutral(model), np.full(model.nv, 0.1)
    for problem in problems:
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        plans.append(planner.plan(goal, JointState(names, problem.start)))
        began = time.perf_counter()
        for _ in range(CALLS_PER_PLAN):
            pin.computeRNEADerivatives(model, data, q, v, v)
        calls.append((time.perf_counter() - began) / CALLS_PER_PLAN)
    return plans, float(np.median(calls))


def quadrature_error(robot: Robot, plan: Plan) -> float:
    """Relative difference of the effort between the chosen number of nodes and many nodes."""
    motion, costs = plan.motion, []
    for tables in (Tables(motion.basis), Tables(motion.basis, N_MANY_NODES)):
        unknowns = Unknowns(tables.basis.scales, motion.boundary, motion.duration)
        program = SegmentProgram(robot, tables, unknowns, motion.weights)
        costs.append(program.costs((motion.weights / unknowns.scales)[None])[0])
    return abs(costs[0] / costs[1] - 1.0)


if __name__ == "__main__":
    main()
