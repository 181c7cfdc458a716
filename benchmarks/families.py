# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Success of each motion basis, and the effect of fewer components.

First, problems of fixed duration are planned. Their ends are those of held-out motions, random ones
within the limits, or those of held-out motions with tight velocity and acceleration limits, which
demonstrated shapes would violate. The table counts the basis that solved each problem: components,
components with B-splines, or B-splines. It also counts rejected problems that B-splines alone
solve.

Then held-out motions are planned with the first components, and with all and several naturalness
weights ρ. The table has the effort as a multiple of the first column's, and the RMS distance from
the demonstration (medians). Fewer components and a larger ρ both bring motions nearer to the
demonstrations at a higher effort.

    python benchmarks/families.py [--problems 50]
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

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
from mp_pca_planner.planning.plan import Plan, PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.robot.limits import JointLimits

ROBOTS = ("human_arm", "panda", "ur5", "kinova")
COMPONENTS = {"arm": 8, "joint": 4}
# Limits as shares of the peaks of the minimum-jerk motion. The peaks are these factors times D / T
# and D / T². Joints that hardly move get the least limits [rad/s, rad/s²].
PEAKS = {"max_velocity": 1.875, "max_acceleration": 5.7735}
DRAWN_IN = {"max_velocity": (0.65, 1.0), "max_acceleration": (0.8, 1.4)}
LEAST = 0.05
# Numbers of components and naturalness weights ρ; the first ones give the least effort.
SETTINGS = ((8, 0.0), (4, 0.0), (2, 0.0), (1, 0.0), (8, 1e-3), (8, 1e-2), (8, 1.0), (1, 1.0))


def main() -> None:
    """Print both tables."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=50, help="of each kind and robot")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    arguments = parser.parse_args()
    families, trade_off = [], []
    for name in arguments.robots:
        scene = scene_of(*robot_file(name), n_motions=30)
        for coupling, n_components in COMPONENTS.items():
            primitive = primitive_of(scene, coupling, n_components)
            for kind, problems in problems_of(scene, arguments.problems).items():
                for naturalness in (0.0, 1.0):
                    outcomes = [both_ways(scene, primitive, *one, naturalness) for one in problems]
                    families.append([name, coupling, kind, f"{naturalness:g}", *shares(outcomes)])
        trade_off.append(traded_off(scene, held_out_problems(scene, arguments.problems, 2)))
    columns = ["robot", "coupling", "problems", "ρ", "components", "both", "splines", "refused"]
    columns += ["B-splines solve", "refused of these", "ms", "worst"]
    header = ["robot", *(f"{n}, ρ = {rho:g}" for n, rho in SETTINGS)]
    tables = {"What solves": (columns, families), "Components and ρ": (header, trade_off)}
    show(tables, as_json=arguments.json)


@dataclass(frozen=True)
class Outcome:
    """One problem: the planner's result, and that of B-splines alone."""

    plan: Plan
    spline: Plan

    @property
    def family(self) -> str:
        """The basis that the plan uses."""
        if not self.plan.is_executable:
            return "refused"
        if self.plan.n_components_used == 0:
            return "splines"
        return "both" if self.plan.correction > 0.0 else "components"


def primitive_of(scene: Scene, coupling: str, n_components: int) -> MovementPrimitive:
    """The primitive learned from the demonstrations."""
    options = PrimitiveOptions(coupling, n_components)
    return build_primitive(scene.demonstrations, scene.name, options)


def problems_of(scene: Scene, n_problems: int) -> dict[str, list[tuple[Problem, JointLimits]]]:
    """Problems of all kinds, with their limits."""
    held_out, rng = held_out_problems(scene, n_problems, 2), np.random.default_rng(3)
    return {
        "held out": [(problem, scene.limits) for problem in held_out],
        "anywhere": [(problem, scene.limits) for problem in random_problems(scene, n_problems, 2)],
        "drawn in": [(problem, drawn_in(scene, problem, rng)) for problem in held_out],
    }


def drawn_in(scene: Scene, problem: Problem, rng: np.random.Generator) -> JointLimits:
    """Random limits near the peaks of the problem's minimum-jerk motion."""
    way, names = np.abs(problem.goal - problem.start), scene.robot.joint_names
    overrides: dict[str, dict[str, float]] = {name: {} for name in names}
    for order, (key, share) in enumerate(DRAWN_IN.items(), start=1):
        peaks = PEAKS[key] * way / problem.duration**order
        within = scene.limits.velocity if order == 1 else scene.limits.acceleration
        for name, limit in zip(
            names, np.minimum(np.maximum(rng.uniform(*share) * peaks, LEAST), within), strict=True
        ):
            overrides[name][key] = float(limit)
    return scene.robot.limits(overrides)


def planned(
    scene: Scene,
    primitive: MovementPrimitive,
    problem: Problem,
    limits: JointLimits,
    options: PlannerOptions,
) -> Plan:
    """Plan one problem."""
    names = scene.robot.joint_names
    goal = JointGoal(JointState(names, problem.goal), problem.duration)
    planner = Planner(scene.robot, [primitive], limits, options)
    return planner.plan(goal, JointState(names, problem.start))


def both_ways(
    scene: Scene,
    primitive: MovementPrimitive,
    problem: Problem,
    limits: JointLimits,
    naturalness: float,
) -> Outcome:
    """Plan one problem with all bases, and with B-splines alone."""
    own = PlannerOptions(naturalness=naturalness)
    splines = PlannerOptions(basis="bspline", naturalness=0.0)
    return Outcome(*(planned(scene, primitive, problem, limits, one) for one in (own, splines)))


def shares(outcomes: list[Outcome]) -> list[str]:
    """Number of problems that each basis solved, and planning times."""
    families = Counter(one.family for one in outcomes)
    by_splines = [one for one in outcomes if one.spline.is_executable]
    times = [1e3 * one.plan.solve_time for one in outcomes]
    return [
        *(str(families[family]) for family in ("components", "both", "splines", "refused")),
        str(len(by_splines)),
        str(sum(one.family == "refused" for one in by_splines)),
        f"{np.median(times):.1f}",
        f"{max(times):.0f}",
    ]


def traded_off(scene: Scene, problems: list[Problem]) -> list[str]:
    """Median effort and distance from demonstrations, with each of `SETTINGS`."""
    row, least = [scene.name], np.zeros(0)
    for n_components, naturalness in SETTINGS:
        primitive = primitive_of(scene, "arm", n_components)
        options = PlannerOptions(naturalness=naturalness)
        plans = [planned(scene, primitive, one, scene.limits, options) for one in problems]
        efforts = np.array([plan.solution.effort_cost for plan in plans])
        least = least if least.size else efforts
        away = [distance(*pair) for pair in zip(plans, problems, strict=True)]
        solved = sum(plan.is_executable for plan in plans)
        cell = f"{np.median(efforts / least):.2f}, {np.degrees(np.median(away)):.1f}°"
        row.append(cell if solved == len(plans) else f"{cell} ({solved} solved)")
    return row


def distance(plan: Plan, problem: Problem) -> float:
    """RMS difference from the motion that was held out [rad or m]."""
    shown = problem.demonstration
    assert shown is not None
    q, _, _ = plan.motion.evaluate(shown.times - shown.times[0])
    return float(np.sqrt(np.mean((q - shown.positions) ** 2)))


if __name__ == "__main__":
    main()
