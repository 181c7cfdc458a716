# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How fast motions of the human-like arm are found, and how good the quadrature is.

Every row is the median over different goals, planned in one run. The last columns relate the
solve time to what the dynamics alone cost: the time of one `computeRNEADerivatives` call from
Python, measured in the same run between the plans, times the number of quadrature nodes.

    python benchmarks/planning_speed.py [--goals 200]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio as pin

from mp_pca_planner.cli.common import table
from mp_pca_planner.goal import JointGoal, JointState
from mp_pca_planner.planning.compiler import MotionProgram, QuadratureTables
from mp_pca_planner.planning.planner import Plan, Planner, PlannerOptions
from mp_pca_planner.primitives.basis import Basis, BSplineBasis
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.resources import config_file
from mp_pca_planner.robot import Robot

N_MANY_NODES = 200
CALLS_PER_PLAN = 20


def main() -> None:
    """Print a row per basis."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", type=int, default=200)
    n_goals = parser.parse_args().goals
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = [motion.as_demonstration() for motion in generate_motions(40, 1)]
    requests = [(m.positions[0], m.positions[-1]) for m in generate_motions(n_goals, 2)]
    rows = []
    for label, coupling, components, basis_name, naturalness in (
        ("components, arm", "arm", 6, "pca", 1.0),
        ("components, arm", "arm", 6, "pca", 0.0),
        ("components, joint", "joint", 4, "pca", 1.0),
        ("components, joint", "joint", 4, "pca", 0.0),
        ("B-splines", "arm", 6, "bspline", 0.0),
    ):
        options = PrimitiveOptions(coupling=coupling, n_components=components)
        primitive = build_primitive(motions, "speed", options)
        planner = Planner(
            robot,
            [primitive],
            robot.limits(),
            PlannerOptions(basis=basis_name, naturalness=naturalness),
        )
        basis: Basis = primitive.basis if basis_name == "pca" else BSplineBasis(robot.n_joints)
        plans, call = timed_plans(planner, requests)
        nodes = QuadratureTables(basis).n_nodes
        solve = np.array([plan.solve_time for plan in plans])
        rows.append(
            [
                label,
                f"{naturalness:g}",
                str(basis.n_weights),
                str(nodes),
                f"{1e3 * np.median(solve):.2f}",
                f"{1e3 * np.percentile(solve, 99):.2f}",
                f"{np.median([plan.solution.iterations for plan in plans]):g}",
                f"{100 * np.mean([plan.is_executable for plan in plans]):.0f}",
                f"{1e6 * call:.2f}",
                f"{np.median(solve) / (call * nodes):.1f}",
                f"{100 * max(quadrature_error(robot, basis, plan) for plan in plans):.4f}",
            ]
        )
    header = ["basis", "ρ", "weights", "nodes", "solve [ms]", "99 %", "passes", "within limits [%]"]
    header += ["call [µs]", "solve/(nodes·call)", "quadrature error [%]"]
    print(table(rows, header=header))


def timed_plans(
    planner: Planner, requests: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[list[Plan], float]:
    """Plans of all requests, and the median time of one call between them [s]."""
    model = pin.buildModelFromUrdf(str(config_file("human_arm.urdf")))
    data, calls, plans = model.createData(), [], []
    q = v = a = np.full(model.nv, 0.1)
    for start, goal in requests:
        request = JointGoal(JointState(JOINT_NAMES, goal))
        plans.append(planner.plan(request, JointState(JOINT_NAMES, start)))
        began = time.perf_counter()
        for _ in range(CALLS_PER_PLAN):
            pin.computeRNEADerivatives(model, data, q, v, a)
        calls.append((time.perf_counter() - began) / CALLS_PER_PLAN)
    return plans, float(np.median(calls))


def quadrature_error(robot: Robot, basis: Basis, plan: Plan) -> float:
    """Relative difference of the effort with the chosen nodes and with many."""
    motion, costs = plan.motion, []
    for tables in (QuadratureTables(basis), QuadratureTables(basis, N_MANY_NODES)):
        program = MotionProgram(robot, tables, motion.boundary, motion.duration, motion.weights)
        costs.append(program.effort_costs((motion.weights / program.scales)[None])[0])
    return abs(costs[0] / costs[1] - 1.0)


if __name__ == "__main__":
    main()
