# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time and quality of the selection among many primitives.

Each primitive is learned from ten random motions of the human-like arm. The planner with all
primitives is compared with the cheapest plan of planners with one primitive each: over the
primitives that pass the in-span filter of the selection, and over all of them. Costs are the
planner's objective.

    python benchmarks/selection.py [--goals 200] [--primitives 100]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from tables import benchmark_parser, show

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.selection import Selector, is_near
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.resources import config_file
from mp_pca_planner.robot.model import Robot


def main() -> None:
    """Print a row per size of the library, then the quality of the choices."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=200)
    parser.add_argument("--primitives", type=int, default=100)
    arguments = parser.parse_args()
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    motions = [motion.as_demonstration() for motion in generate_motions(200, 1)]
    rng = np.random.default_rng(0)
    options = PrimitiveOptions(n_components=4)
    primitives = []
    for i in range(arguments.primitives):
        chosen = rng.choice(len(motions), 10, replace=False)
        primitives.append(build_primitive([motions[k] for k in chosen], f"p{i}", options))
    requests = [(m.positions[0], m.positions[-1]) for m in generate_motions(arguments.goals, 2)]
    rows = []
    for size in (1, 10, 100, 1000):
        library = [primitives[i % len(primitives)] for i in range(size)]
        choosing = times(Selector(robot, library).choose, requests)
        planning = "-"
        if size <= len(primitives):
            planner = Planner(robot, library, robot.limits())
            planning = f"{times(partial(plan, planner), requests):.1f}"
        rows.append([str(size), f"{choosing:.2f}", planning])
    tables = {"Time of the choice": (["primitives", "choice [ms]", "whole plan [ms]"], rows)}

    planner = Planner(robot, primitives, robot.limits())
    single = [Planner(robot, [p], robot.limits()) for p in primitives]
    ratios, counts = [], []
    for start, goal in requests:
        winner = plan(planner, start, goal)
        plans = [plan(one, start, goal) for one in single]
        costs = np.array([p.solution.cost if p.is_executable else np.inf for p in plans])
        scores = np.array([p.in_span_score for p in plans])
        in_span = is_near(scores)
        ratios.append(winner.solution.cost / np.array([costs[in_span].min(), costs.min()]))
        counts.append([winner.considered, np.count_nonzero(in_span)])
    considered, in_span = np.mean(counts, axis=0)
    title = (
        f"Choice: in span {in_span:.1f} of {len(primitives)} in the mean, compiled {considered:.1f}"
    )
    rows = [
        [what, f"{100 * np.mean(r <= 1.01):.1f}", f"{np.median(r):.4f}", f"{np.max(r):.4f}"]
        for what, r in zip(("those in span", "all"), np.transpose(ratios), strict=True)
    ]
    header = ["cheapest of", f"within 1 % [% of {len(requests)} goals]", "median ratio", "largest"]
    tables[title] = (header, rows)
    show(tables, as_json=arguments.json)


def plan(planner: Planner, start: np.ndarray, goal: np.ndarray) -> Plan:
    """Plan from rest to rest."""
    request = JointGoal(JointState(JOINT_NAMES, goal))
    return planner.plan(request, JointState(JOINT_NAMES, start))


def times(action: Callable[..., object], requests: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Median time for a request [ms], after two to warm up."""
    taken = []
    for ends in requests[:2] + requests:
        began = time.perf_counter()
        action(*ends)
        taken.append(time.perf_counter() - began)
    return 1e3 * float(np.median(taken[2:]))


if __name__ == "__main__":
    main()
