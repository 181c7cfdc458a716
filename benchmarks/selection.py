# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time and quality of the selection among many primitives.

Libraries of the human-like arm: primitives of ten similar motions each, moved to other start and
goal configurations ("alike": by a tenth as much). The choice is compared with the choice by the
scores of all, and with a k-d tree (SciPy) of the mean requests. Times are medians of processor time
for a goal. Plans over the ten primitives that are nearest to the goal and over the whole library
are made in turns.

--files N writes a library of N files, and reads it in another process, which prints the processor
time until the first plan, the growth of its memory by then and after the goals, and the time of
plans.

--quality compares the planner with 100 primitives of ten random motions with the cheapest plan of
planners with one primitive each: over the primitives that pass the in-span filter of the selection,
and over all of them. Costs are the planner's objective.

    python benchmarks/selection.py [--goals 200] [--counts 1,10,1000,10000] [--files N] [--quality]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from tables import Table, benchmark_parser, show

from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.options import SelectionOptions
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.selection import Selector, is_near
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import primitive_bytes
from mp_pca_planner.primitives.library import PrimitiveLibrary, load_primitives
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot

N_BASE = 100
N_FOUND = 1024  # by the tree
Ends = tuple[np.ndarray, np.ndarray]


def main() -> None:
    """Print the tables."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=200)
    parser.add_argument("--counts", default="1,10,1000,10000")
    parser.add_argument("--files", type=int, default=0)
    parser.add_argument("--quality", action="store_true")
    parser.add_argument("--read", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.read:
        read(Path(arguments.read), arguments.goals)
        return
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    tables = choose_and_plan(robot, [int(n) for n in arguments.counts.split(",")], arguments.goals)
    if arguments.quality:
        tables |= quality(robot, arguments.goals)
    show(tables, as_json=arguments.json)
    if arguments.files and not arguments.json:
        in_files(arguments.files, arguments.goals)


def choose_and_plan(robot: Robot, counts: Sequence[int], n_goals: int) -> dict[str, Table]:
    """A row per size of the library, and the ratio of planning times."""
    rows = []
    for count, spread in [*((count, 1.0) for count in counts), (max(counts), 0.1)]:
        library = moved_library(count, spread)
        requests = requests_of(library, robot, n_goals)
        selector = Selector(robot, library)
        choices = [name_of_first(selector, ends) for ends in requests]
        by_all = [chosen_of_all(robot, library, selector, ends) for ends in requests]
        same = np.mean([a == b for a, b in zip(choices, by_all, strict=True)])
        scale = np.sqrt(np.median(np.diagonal(library.precisions, axis1=1, axis2=2), axis=0))[:-1]
        tree = cKDTree(library.means[:, :-1] * scale)
        found = [tree.query(np.concatenate(e) * scale, k=min(N_FOUND, count))[1] for e in requests]
        names = list(library.names)
        in_tree = np.mean(
            [a in {names[i] for i in np.ravel(f)} for a, f in zip(by_all, found, strict=True)]
        )
        rows.append(
            [
                f"{count:,}{', alike' if spread < 1.0 else ''}",
                f"{times(selector.choose, requests):.2f}",
                f"{times(selector.least_score, requests):.2f}",
                f"{times(selector.scores, requests):.2f}",
                f"{100 * same:.1f}",
                f"{times(partial(in_order_of_tree, tree, scale), requests):.2f}",
                f"{100 * in_tree:.1f}",
            ]
        )
    header = ["primitives", "choice [ms]", "least score [ms]", "all scores [ms]", "same choice [%]"]
    tree_header = [f"tree, {N_FOUND} [ms]", "chosen one in it [%]"]
    choice = (header + tree_header, rows)
    library = moved_library(max(counts))
    requests, selector = requests_of(library, robot, n_goals), Selector(robot, library)
    planner, taken = Planner(robot, library), []
    for ends in requests:
        nearest = np.argsort(selector.scores(*ends))[:10]
        planners = (Planner(robot, [library[i] for i in nearest]), planner)
        taken.append([times(partial(plan, one), [ends]) for one in planners])
    few, many = np.median(taken, axis=0)
    columns = ["10 nearest primitives [ms]", f"{len(library):,} [ms]", "ratio"]
    row = [f"{few:.1f}", f"{many:.1f}", f"{many / few:.2f}"]
    return {"Time of the choice": choice, "Time of a plan": (columns, [row])}


def chosen_of_all(robot: Robot, library: PrimitiveLibrary, selector: Selector, ends: Ends) -> str:
    """Name of the primitive that is chosen after the scores of all."""
    scores = selector.scores(*ends)
    nearest = np.argsort(scores, kind="stable")[: SelectionOptions.max_considered]
    near = [library[i] for i in nearest[is_near(scores[nearest])]]
    return name_of_first(Selector(robot, near), ends)


def name_of_first(selector: Selector, ends: Ends) -> str:
    """Name of the primitive with the least expected cost."""
    (first, *_), _ = selector.choose(*ends)
    return first.name


def in_order_of_tree(tree: cKDTree, scale: np.ndarray, *ends: np.ndarray) -> object:
    """The primitives whose mean requests are nearest."""
    return tree.query(np.concatenate(ends) * scale, k=min(N_FOUND, tree.n))


@lru_cache(1)
def base() -> list[MovementPrimitive]:
    """Primitives of similar motions."""
    motions = generate_motions(1000, 1)
    ends = np.array([motion.positions[[0, -1]].ravel() for motion in motions])
    options = PrimitiveOptions(n_components=4)
    found = []
    for i in range(N_BASE):
        near = np.argsort(np.linalg.norm(ends - ends[i], axis=1))[:30:3]
        found.append(build_primitive([motions[k] for k in near], f"p{i}", options))
    return found


def moved_library(count: int, spread: float = 1.0) -> PrimitiveLibrary:
    """That many primitives."""
    rng = np.random.default_rng(0)
    n = len(JOINT_NAMES)
    shifts = np.zeros((count, 2 * n + 1))
    shifts[:, : 2 * n] = np.tile(rng.uniform(-0.6, 0.6, (count, n)), 2)
    shifts = spread * (shifts + rng.uniform(-0.2, 0.2, shifts.shape))
    kinds = [base()[i % N_BASE] for i in range(count)]
    pairs = zip(kinds, shifts, strict=True)
    return PrimitiveLibrary([moved(kind, f"p{i}", x) for i, (kind, x) in enumerate(pairs)])


def moved(primitive: MovementPrimitive, name: str, shift: np.ndarray) -> MovementPrimitive:
    """The same primitive for other starts, goals and durations."""
    n = primitive.n_joints
    states = primitive.boundary_states.copy()
    states[:, 0] += shift[:n]
    states[:, 3] += shift[n : 2 * n]
    model = replace(primitive.model, requests=primitive.model.requests + shift)
    return replace(primitive, name=name, boundary_states=states, model=model)


def requests_of(library: PrimitiveLibrary, robot: Robot, n_goals: int) -> list[Ends]:
    """Starts and goals near those of demonstrations, within the limits."""
    rng = np.random.default_rng(1)
    limits, n = robot.limits(), robot.n_joints
    found = []
    for i in rng.integers(len(library), size=n_goals):
        mean = library.means[i, : 2 * n].reshape(2, n)
        ends = np.clip(mean + rng.normal(0.0, 0.1, mean.shape), limits.lower, limits.upper)
        found.append((ends[0], ends[1]))
    return found


def in_files(count: int, n_goals: int) -> None:
    """Write a library of files, and read it in another process."""
    library = moved_library(count)
    with tempfile.TemporaryDirectory() as folder:
        for i in range(count):
            Path(folder, f"p{i:06d}.npz").write_bytes(primitive_bytes(library[i]))
        size = sum(entry.stat().st_size for entry in os.scandir(folder))
        print(f"{count:,} files of {size / 1e6:.0f} MB:")
        command = [sys.executable, __file__, "--read", folder, "--goals", str(n_goals)]
        subprocess.run(command, check=True)


def read(folder: Path, n_goals: int) -> None:
    """Plan with a library of files; print times and memory."""
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    small = Planner(robot, base()[:10])
    plan(small, *requests_of(small.primitives, robot, 1)[0])  # warm-up
    before, began = memory(), time.process_time()
    planner = Planner(robot, load_primitives([folder]))
    requests = requests_of(planner.primitives, robot, n_goals)
    plan(planner, *requests[0])
    started, first = time.process_time() - began, memory() - before
    cold = times(partial(plan, planner), requests, 0)
    warm = times(partial(plan, planner), requests, 0)
    print(
        f"first plan after {started:.1f} s of processor time; memory +{first:.0f} MB, after "
        f"{n_goals} goals +{memory() - before:.0f} MB; a plan takes {cold:.1f} ms, the same again "
        f"{warm:.1f} ms"
    )


def memory() -> float:
    """Memory of this process [MB]."""
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024


def quality(robot: Robot, n_goals: int) -> dict[str, Table]:
    """Print how near the plans are to the cheapest ones."""
    motions = generate_motions(200, 1)
    rng = np.random.default_rng(0)
    options = PrimitiveOptions(n_components=4)
    primitives = []
    for i in range(N_BASE):
        chosen = rng.choice(len(motions), 10, replace=False)
        primitives.append(build_primitive([motions[k] for k in chosen], f"p{i}", options))
    requests = [(m.positions[0], m.positions[-1]) for m in generate_motions(n_goals, 2)]
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
    of = f"of {len(primitives)} in the mean"
    title = f"Quality: in span {in_span:.1f} {of}, compiled {considered:.1f}"
    rows = [
        [what, f"{100 * np.mean(r <= 1.01):.1f}", f"{np.median(r):.4f}", f"{np.max(r):.4f}"]
        for what, r in zip(("those in span", "all"), np.transpose(ratios), strict=True)
    ]
    header = ["cheapest of", f"within 1 % [% of {len(requests)} goals]", "median ratio", "largest"]
    return {title: (header, rows)}


def plan(planner: Planner, start: np.ndarray, goal: np.ndarray) -> Plan:
    """Plan from rest to rest."""
    request = JointGoal(JointState(JOINT_NAMES, goal))
    return planner.plan(request, JointState(JOINT_NAMES, start))


def times(action: Callable[..., object], requests: list[Ends], n_warm_up: int = 2) -> float:
    """Median processor time for a request [ms]."""
    taken = []
    for ends in [*requests[:1] * n_warm_up, *requests]:
        began = time.process_time()
        action(*ends)
        taken.append(time.process_time() - began)
    return 1e3 * float(np.median(taken[n_warm_up:]))


if __name__ == "__main__":
    main()
