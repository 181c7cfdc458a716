# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Improvement of planned motions by another solver that starts from them.

Motions are planned for least effort within all limits. SciPy's SLSQP then starts from each, on
the same basis with the same constraints and analytic gradients, and runs until it finds no
improvement. Only motions within the constraints (to 1e-6 of a limit) count.

    python3 -m campaigns.optimality [--problems 25]
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize
from support.problems import held_out_problems, scene_of
from support.tables import options, show

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.program.motion_program import MotionProgram as Program
from mp_pca_planner.planning.search import candidate
from mp_pca_planner.planning.solver import Solution, solve
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.robot.examples import example_file

ROBOTS = ("human_arm", "panda", "ur5", "kinova")
ACTIVE = 1e-4
FEASIBLE = 1e-6


def main() -> None:
    """Print a row per robot and coupling."""
    arguments = options(__doc__, problems=25, json=False)
    n_problems = arguments.problems
    rows = []
    for name in ROBOTS:
        for coupling, n_components in (("arm", 6), ("joint", 4)):
            solved = solved_programs(name, coupling, n_components, n_problems)
            rows.append([name, coupling, f"{len(solved)} of {n_problems}", *comparison(solved)])
    header = ["robot", "coupling", "converged", "weights", "at a limit"]
    header += ["better by [%], median", "worst", "above 0.1 %"]
    show({"SLSQP from the planner's motions": (header, rows)}, as_json=arguments.json)


def comparison(solved: list[tuple[Program, Solution]]) -> list[str]:
    """Number of weights, share of motions at a limit, and improvement by SLSQP."""
    if not solved:
        return ["–"] * 5
    better = [100.0 * improvement(*pair) for pair in solved]
    return [
        str(solved[0][1].unknowns.size),
        f"{np.mean([is_held(*pair) for pair in solved]):.0%}",
        f"{np.median(better):.5f}",
        f"{max(better):.5f}",
        str(sum(x > 0.1 for x in better)),
    ]


def solved_programs(
    name: str, coupling: str, n_components: int, n_problems: int
) -> list[tuple[Program, Solution]]:
    """The last program of every solved motion, and its solution."""
    scene = scene_of(name, *example_file(name), n_motions=30)
    robot, limits = scene.robot, scene.limits
    components = PrimitiveOptions(coupling, n_components)
    primitive = build_primitive(scene.demonstrations, name, components)
    chosen = PlannerOptions(naturalness=0.0, max_solve_time=60.0)
    planner = Planner(robot, [primitive], limits, chosen, collision=False)
    last: list[tuple[Program, Solution]] = []

    def keeping(program, *rest):
        solution = solve(program, *rest)
        last[:] = [(program, solution)]
        return solution

    solved = []
    candidate.solve = keeping
    for problem in held_out_problems(scene, n_problems, 2):
        goal = JointGoal(JointState(robot.joint_names, problem.goal), problem.duration)
        plan = planner.plan(goal, JointState(robot.joint_names, problem.start))
        if plan.status == SOLVED:
            solved.append(last[0])
    candidate.solve = solve
    return solved


def is_held(program: Program, solution: Solution) -> bool:
    """Whether a limit is active at a solution."""
    values = program.evaluate(solution.unknowns).inequalities
    return bool(np.minimum(program.upper - values, values - program.lower).min() < ACTIVE)


def improvement(program: Program, solution: Solution) -> float:
    """Relative reduction of the cost by SLSQP."""
    found = solution.unknowns
    at = program.evaluate(found)
    # Distant constraints would only slow SLSQP; solutions that violate them do not count.
    room = np.minimum(program.upper - at.inequalities, at.inequalities - program.lower)
    near = np.flatnonzero(room < 0.2)

    def slack(x: np.ndarray) -> np.ndarray:
        values = program.evaluate(x).inequalities[near]
        return np.concatenate([program.upper[near] - values, values - program.lower[near]])

    def slack_rows(x: np.ndarray) -> np.ndarray:
        rows = program.evaluate(x).inequality_rows(near)
        return np.concatenate([-rows, rows])

    def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
        here = program.evaluate(x)
        return here.cost / at.cost, here.gradient / at.cost

    constraints = {"type": "ineq", "fun": slack, "jac": slack_rows}
    other = minimize(
        objective,
        found,
        jac=True,
        method="SLSQP",
        constraints=constraints if near.size else (),
        options={"ftol": 1e-9, "maxiter": 100},
    )
    there = program.evaluate(other.x)
    outside = np.maximum(there.inequalities - program.upper, program.lower - there.inequalities)
    return 1.0 - there.cost / at.cost if outside.max() <= FEASIBLE else 0.0


if __name__ == "__main__":
    main()
