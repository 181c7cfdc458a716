# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Smoothness, effort and planning time of sequences.

Random sequences of the human-like arm, whose configurations are ends of motions that the
demonstrations don't contain, are joined in real time, optimised, and planned as one motion for
each segment that stops at every via, in the same total duration. Sequences of the wrist poses at
these configurations are optimised, too; each pose leaves one degree of freedom.

    python benchmarks/sequences.py [--sequences 50]
"""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
from tables import benchmark_parser, show

from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, SequenceGoal
from mp_pca_planner.planning.motion import Tables, cost_of, samples_of
from mp_pca_planner.planning.objectives import effort
from mp_pca_planner.planning.options import OPTIMAL, REAL_TIME, PlannerOptions
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot


def main() -> None:
    """Print the results for 5 segments, and the growth of the time up to 50."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--sequences", type=int, default=50)
    arguments = parser.parse_args()
    n_sequences = arguments.sequences
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = generate_motions(40, 1)
    primitive = build_primitive(motions, "sequences", PrimitiveOptions(n_components=6))
    planner = Planner(robot, [primitive], options=PlannerOptions(max_solve_time=float("inf")))
    stopping = Planner(robot, [primitive], robot.limits())
    ends = np.array([m.positions[k] for m in generate_motions(60, 2) for k in (0, -1)])
    rng = np.random.default_rng(0)
    quick, best, timed, posed, stops = [], [], [], [], []
    for _ in range(n_sequences):
        path = [JointState(JOINT_NAMES, q) for q in ends[rng.choice(len(ends), 6, replace=False)]]
        goal = SequenceGoal(tuple(path[1:]))
        single = [stopping.plan(JointGoal(b), a).motion for a, b in pairwise(path)]
        alone = [cost_of(robot, one, Tables(one.basis), [(1.0, effort)]) for one in single]
        stops.append(sum(alone))
        quick.append(planner.plan(goal, path[0], REAL_TIME))
        best.append(planner.plan(goal, path[0], OPTIMAL))
        passing = np.cumsum([motion.duration for motion in single])
        fixed = SequenceGoal(tuple(path[1:]), tuple(map(float, passing)))
        timed.append(planner.plan(fixed, path[0], OPTIMAL))
        places = robot.frame_positions(np.array([q.positions for q in path[1:]]), ["wrist"])[:, 0]
        posed.append(
            planner.plan(SequenceGoal(tuple(Pose("wrist", p) for p in places)), path[0], OPTIMAL)
        )
    rows = []
    for label, plans in (
        ("real time", quick),
        ("optimal", best),
        ("optimal, vias at the times of stopping", timed),
        ("optimal, through poses", posed),
    ):
        share = np.array([p.effort_cost for p in plans]) / np.array(stops)
        rows.append(
            [
                label,
                f"{100 * np.mean([p.is_executable for p in plans]):.0f}",
                f"{np.mean([p.mode == OPTIMAL for p in plans]) * 100:.0f}",
                f"{max(jump(p) for p in plans):.1e}",
                f"{100 * (1 - share.mean()):.1f}",
                f"{np.median([b for p in plans for b in beyond(p)]):.2f}",
                f"{np.percentile([b for p in plans for b in beyond(p)], 90):.2f}",
                f"{1e3 * np.median([p.solve_time for p in plans]):.2f}",
                f"{1e3 * np.percentile([p.solve_time for p in plans], 99):.2f}",
            ]
        )
    header = ["5 segments", "within limits [%]", "optimised [%]", "largest jump"]
    header += ["effort saved against stopping [%]", "beyond ends [rad]", "90 %"]
    header += ["time [ms]", "99 %"]
    tables = {"Sequences of five segments": (header, rows)}
    rows = []
    for n in (5, 10, 20, 50):
        path = [
            JointState(JOINT_NAMES, q) for q in ends[rng.choice(len(ends), n + 1, replace=False)]
        ]
        goal = SequenceGoal(tuple(path[1:]))
        began = time.perf_counter()
        plan = planner.plan(goal, path[0], OPTIMAL)
        taken = time.perf_counter() - began
        joined = planner.plan(goal, path[0], REAL_TIME).solve_time
        per_pass = 1e3 * plan.solve_time / plan.iterations / n
        rows.append([str(n), plan.mode, f"{1e3 * joined:.2f}", f"{plan.iterations}"])
        rows[-1] += [f"{per_pass:.2f}", f"{taken:.2f}"]
    header = ["segments", "mode", "real time [ms]", "passes", "ms per pass and segment"]
    tables["Growth with segments"] = ([*header, "with all checks [s]"], rows)
    show(tables, as_json=arguments.json)


def beyond(plan: Plan) -> list[float]:
    """Largest overshoot of a joint beyond its positions at the ends of a segment [rad]."""
    found = []
    for motion in plan.motions:
        q, _, _ = samples_of(motion, 0.01)[1]
        low, high = np.minimum(q[0], q[-1]), np.maximum(q[0], q[-1])
        found.append(float(np.maximum(low - q, q - high).max()))
    return found


def jump(plan: Plan) -> float:
    """Largest jump of q, q̇, q̈ between segments, evaluated on both sides."""
    tiny, worst = 1e-13, 0.0
    for before, after in pairwise(plan.motions):
        left = before.evaluate(np.array([before.duration * (1.0 - tiny)]))
        right = after.evaluate(np.array([after.duration * tiny]))
        worst = max(worst, *(float(np.abs(x - y).max()) for x, y in zip(left, right, strict=True)))
    return worst


if __name__ == "__main__":
    main()
