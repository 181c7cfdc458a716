# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Gains of the learning block: off-line refinement, trials, and new primitives.

Off-line: motions of the human-like arm between random end points like the demonstrations',
planned once and then refined with the same duration. Trials: the planner's model has the true
limits, but each mass and inertia tensor is wrong by up to 30 %. The cost of a trial is its effort
on the true robot, without noise and with 10 %. The optimum is that of an off-line refinement with
the true model. Primitives:
goals near refined motions, planned with the old primitive and with the new one.

    python3 benchmarks/learning.py [--problems 100] [--seeds 10] [--trials 60]
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import trapezoid
from support.tables import benchmark_parser, show

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.files import config_file
from mp_pca_planner.learning.refined_motion import primitive_around
from mp_pca_planner.learning.refinement import refine
from mp_pca_planner.learning.trials import improve_by_trials
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot

MODEL_ERROR = 0.3
NOISE = 0.1
N_NEIGHBOURS = 5
NEIGHBOURHOOD = 0.1


def main() -> None:
    """Print the three parts."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--trials", type=int, default=60)
    arguments = parser.parse_args()
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = generate_motions(40, 1)
    primitive = build_primitive(motions, "one_shot", PrimitiveOptions(n_components=6))
    planner = Planner(robot, [primitive], robot.limits(), collision=False)
    plans = [
        plan
        for m in generate_motions(arguments.problems, 2)
        if (plan := plan_between(planner, m.positions[0], m.positions[-1])).is_executable
    ]
    found = {
        "effort saved by refining [%]": refine_all(planner, plans),
        **learn_by_trials(planner, plans[0], arguments.seeds, arguments.trials),
        "effort of a new primitive's plan over the old one's": plan_around(
            planner, plans[: max(arguments.problems // 5, 1)]
        ),
    }
    found = {name: x for name, x in found.items() if x}
    rows = [
        [name, str(len(x)), *(f"{y:.3g}" for y in (np.median(x), min(x), max(x)))]
        for name, x in found.items()
    ]
    header = ["", "number", "median", "least", "most"]
    show({"Learning": (header, rows)}, as_json=arguments.json)


def plan_between(planner: Planner, start: FloatArray, goal: FloatArray) -> Plan:
    """A motion from rest to rest."""
    return planner.plan(JointGoal(JointState(JOINT_NAMES, goal)), JointState(JOINT_NAMES, start))


def refine_all(planner: Planner, plans: list[Plan]) -> list[float]:
    """Effort saved by off-line refinement with the same duration [%]."""
    gains = []
    for plan in plans:
        found = refine([plan.motion], planner.robot, planner.limits)
        gains.append(100.0 * found.gain)
        if check_limits(found.trajectory, planner.robot, planner.limits).violations:
            raise SystemExit("a refined motion breaks limits")
    return gains


def learn_by_trials(
    planner: Planner, plan: Plan, n_seeds: int, n_trials: int
) -> dict[str, list[float]]:
    """Effort above the optimum before and after trials on robots unlike the model [%]."""
    found: dict[str, list[float]] = {}
    known = refine([plan.motion], planner.robot, planner.limits).trajectory
    for seed in range(n_seeds):
        robot = perturbed_robot(planner.robot, seed)
        optimum = refine([plan.motion], robot, planner.limits).effort

        def effort(trajectory: Trajectory, robot: Robot = robot) -> float:
            if check_limits(trajectory, planner.robot, planner.limits).violations:
                raise SystemExit("a trial breaks limits")
            squares = np.sum(robot.inverse_dynamics(*trajectory.states) ** 2, axis=1)
            return 0.5 * float(trapezoid(squares, trajectory.times))

        motions = {"planned": plan.trajectory, "refined by the wrong model": known}
        for noise in (0.0, NOISE):
            rng = np.random.default_rng(seed)

            def run(
                trajectory: Trajectory,
                noise: float = noise,
                rng: np.random.Generator = rng,
                effort: Callable[[Trajectory], float] = effort,
            ) -> float:
                return effort(trajectory) * (1.0 + noise * float(rng.normal()))

            best = improve_by_trials(planner, plan, run, n_trials, seed)
            motions[f"after {n_trials} trials with noise of {noise:.0%}"] = best.trajectory
        for name, motion in motions.items():
            above = 100.0 * (effort(motion) / optimum - 1.0)
            found.setdefault(f"{name}: above the optimum [%]", []).append(above)
    return found


def perturbed_robot(robot: Robot, seed: int) -> Robot:
    """The arm with other masses and moments of inertia than its model says."""
    n_links = len(robot.link_inertias)
    factors = 1.0 + MODEL_ERROR * np.random.default_rng(seed).uniform(-1.0, 1.0, (n_links, 1))
    return robot.with_link_inertias(np.repeat(factors, 4, axis=1))


def plan_around(planner: Planner, plans: list[Plan]) -> list[float]:
    """Effort of plans to goals around refined motions, by the new over the old primitive."""
    rng = np.random.default_rng(3)
    ratios = []
    for plan in plans:
        refined = refine([plan.motion], planner.robot, planner.limits).motion
        family = primitive_around(planner.primitives[0], refined, "refined", {})
        new = Planner(planner.robot, [family], planner.limits, collision=False)
        for _ in range(N_NEIGHBOURS):
            ends = [
                state.positions + NEIGHBOURHOOD * rng.uniform(-1.0, 1.0, state.positions.size)
                for state in (plan.motion.start, plan.motion.goal)
            ]
            start, goal = (np.clip(q, planner.limits.lower, planner.limits.upper) for q in ends)
            before = plan_between(planner, start, goal)
            after = plan_between(new, start, goal)
            if before.is_executable:
                cost = after.solution.effort_cost if after.is_executable else np.inf
                ratios.append(cost / before.solution.effort_cost)
    return ratios


if __name__ == "__main__":
    main()
