# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of solvers on the quadratic programs of planning.

Motions of several arms are planned, and their quadratic programs are stored. Every installed solver
solves each of them. Times are medians of three calls, conversion to the solver's format included.
The error is the largest violation of the constraints and the optimality conditions, relative to the
size of the gradient.

    python benchmarks/quadratic_programs.py [--programs 200]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from scenes import scene_of

from mp_pca_planner.arrays import text_table
from mp_pca_planner.evaluation.problems import held_out_problems, robot_file
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning import solver
from mp_pca_planner.planning.plan import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.solver import cholesky, solve_quadratic
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

ROBOTS = ("human_arm", "panda", "ur5", "kinova")
N_PROBLEMS = 20
N_REPEATS = 3
TOLERANCE = 1e-9

Program = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Answer = tuple[np.ndarray, np.ndarray]


def main() -> None:
    """Print a row per solver."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--programs", type=int, default=200)
    n_programs = parser.parse_args().programs
    programs = occurring_programs(n_programs)
    sizes = [len(program[1]) for program in programs]
    constraints = [len(program[3]) for program in programs]
    print(
        f"{len(programs)} programs of {min(sizes)} to {max(sizes)} unknowns and "
        f"{min(constraints)} to {max(constraints)} constraints"
    )
    solvers = {name: make() for name, make in SOLVERS.items()}
    rows = []
    for name, solve in solvers.items():
        if solve is None:
            rows.append([name, *["not installed"] * 4])
            continue
        times, errors = zip(*(timed(solve, program) for program in programs), strict=True)
        found = np.array([error for error in errors if error is not None])
        rows.append(
            [
                name,
                f"{1e6 * np.median(times):.0f}",
                f"{1e6 * np.percentile(times, 99):.0f}",
                f"{np.median(found):.0e}",
                f"{np.mean(found < 1e-6) * found.size / len(programs):.1%}",
            ]
        )
    header = ["solver", "time [µs]", "99 %", "error", "solved to 1e-6"]
    print(text_table(rows, header=header))


def occurring_programs(n_programs: int) -> list[Program]:
    """Quadratic programs of planning, an evenly spread sample."""
    kept: list[Program] = []

    def keeping(factor: np.ndarray, *rest: np.ndarray) -> object:
        answer = solve_quadratic(factor, *rest)
        if answer is not None:
            lower = np.tril(factor)
            kept.append((lower @ lower.T, *(x.copy() for x in rest)))
        return answer

    solver.solve_quadratic = keeping
    try:
        for name in ROBOTS:
            plan_motions(name)
    finally:
        solver.solve_quadratic = solve_quadratic
    chosen = np.unique(np.linspace(0, len(kept) - 1, n_programs).astype(int))
    return [kept[i] for i in chosen]


def plan_motions(name: str) -> None:
    """Plan with few and with many weights, with ρ = 0 and with a small naturalness ρ."""
    scene = scene_of(*robot_file(name), n_motions=30)
    robot, limits = scene.robot, scene.limits
    problems = held_out_problems(scene, N_PROBLEMS, 2)
    for coupling, n_components in (("arm", 6), ("joint", 4)):
        options = PrimitiveOptions(coupling, n_components)
        primitive = build_primitive(scene.demonstrations, name, options)
        for naturalness in (0.003, 0.0):
            planner = Planner(robot, [primitive], limits, PlannerOptions(naturalness=naturalness))
            for problem in problems:
                goal = JointGoal(JointState(robot.joint_names, problem.goal), problem.duration)
                planner.plan(goal, JointState(robot.joint_names, problem.start))


def timed(solve: Callable[..., Answer | None], program: Program) -> tuple[float, float | None]:
    """Median time of a solver [s], and its error; None if it found no solution."""
    times, answer = [], None
    for _ in range(N_REPEATS):
        began = time.perf_counter()
        answer = solve(*program)
        times.append(time.perf_counter() - began)
    return float(np.median(times)), None if answer is None else error(program, *answer)


def error(program: Program, step: np.ndarray, multipliers: np.ndarray) -> float:
    """Largest violation of the optimality conditions, relative to their size."""
    hessian, gradient, rows, bounds = program
    stationary = hessian @ step + gradient + rows.T @ multipliers
    size = np.abs(gradient).max() + np.abs(hessian @ step).max()
    outside = np.maximum(rows @ step - bounds, 0.0)
    scale = 1.0 + np.abs(bounds)
    return float(max(np.abs(stationary).max() / size, (outside / scale).max()))


def _ours() -> Callable[..., Answer | None]:
    def solve(hessian: np.ndarray, *rest: np.ndarray) -> Answer | None:
        return solve_quadratic(cholesky(hessian), *rest)

    return solve


def _proxqp() -> Callable[..., Answer | None] | None:
    try:
        from proxsuite import proxqp
    except ImportError:
        return None

    def solve(hessian, gradient, rows, bounds) -> Answer | None:
        qp = proxqp.dense.QP(len(gradient), 0, len(bounds))
        qp.settings.eps_abs = TOLERANCE
        qp.init(hessian, gradient, None, None, rows, np.full(len(bounds), -1e20), bounds)
        qp.solve()
        return qp.results.x, qp.results.z

    return solve


def _piqp() -> Callable[..., Answer | None] | None:
    try:
        import piqp
    except ImportError:
        return None

    def solve(hessian, gradient, rows, bounds) -> Answer | None:
        qp = piqp.DenseSolver()
        qp.settings.eps_abs = qp.settings.eps_rel = TOLERANCE
        qp.setup(P=hessian, c=gradient, G=rows, h_u=bounds)
        qp.solve()
        return qp.result.x, qp.result.z_u

    return solve


def _daqp() -> Callable[..., Answer | None] | None:
    try:
        import daqp
    except ImportError:
        return None

    def solve(hessian, gradient, rows, bounds) -> Answer | None:
        sense = np.zeros(len(bounds), dtype=np.int32)
        below = np.full(len(bounds), -1e30)
        rows = np.ascontiguousarray(rows)
        x, _, flag, info = daqp.solve(hessian, gradient, rows, bounds, below, sense)
        return (x, info["lam"]) if flag > 0 else None

    return solve


def _quadprog() -> Callable[..., Answer | None] | None:
    try:
        import quadprog
    except ImportError:
        return None

    def solve(hessian, gradient, rows, bounds) -> Answer | None:
        try:
            found = quadprog.solve_qp(hessian, -gradient, -rows.T, -bounds)
        except ValueError:
            return None
        return found[0], found[4]

    return solve


SOLVERS = {
    "NNLS (SciPy), as planned with": _ours,
    "ProxQP, dense": _proxqp,
    "PIQP, dense": _piqp,
    "DAQP": _daqp,
    "quadprog": _quadprog,
}


if __name__ == "__main__":
    main()
