# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Random plans: the same answer for the same call, the time kept, and the limits kept.

    python3 -m campaigns.plans repeats [--number 200] [--times 5] [--burners 4]
    python3 -m campaigns.plans limits [--number 500] [--seed 0]

repeats: joint goals, poses, sequences, goals among obstacles and shortest motions of two robots,
planned again and again, alone and then beside processes that compute. Plans of one call are equal
to the bit, unless time ran out (`stopped_early`).
limits: goals of six robots, a third of them among obstacles. Planning takes at most 10 ms of
processor time more than `max_solve_time`. On a grid of 0.25 ms, no limit is exceeded by more than
1e-4. The budget is told the processor time instead of the time of day, so that the load of the
machine does not shorten the search.

Exits with 1 otherwise, and prints the calls.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from unittest import mock

import numpy as np
from support.motion_referee import RigidArm, judge
from support.problems import Problem, Scene, held_out_problems, random_problems, scene_of
from support.tables import Table, options, show

import mp_pca_planner as mp
from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import config_file
from mp_pca_planner.planning import context
from mp_pca_planner.planning.plan import SOLVED, STOPPED_EARLY
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.robot.examples import example_file

HANDS = {"human_arm": "wrist", "panda": "panda_hand"}
ROBOTS = ("human_arm", "panda", "ur5", "kinova", "xarm7", "z1")
KINDS = ("joint", "pose", "sequence", "scene", "shortest")
TIMINGS = ("auto", "shortest", "free")
MAX_SOLVE_TIME, MORE = 0.2, 0.01  # [s]
PERIOD, TOLERANCE = 2.5e-4, 1e-4  # of the referee [s], and the share of a limit
CREEP = 0.02  # speed over which friction changes its sign [rad/s]

Call = Callable[[], mp.Plan]


def planner_of(scene: Scene, world: mp.World | None = None, **chosen: object) -> mp.Planner:
    """A planner with one primitive of 8 components."""
    primitive = build_primitive(scene.demonstrations, "reach", PrimitiveOptions("arm", 8))
    how = mp.PlannerOptions(**chosen)
    return mp.Planner(scene.robot, [primitive], scene.limits, how, world=world)


def repeats(arguments: argparse.Namespace) -> tuple[Table, list[str]]:
    """A row for each kind of call."""
    calls = dict(zip(range(arguments.number or 200), _calls(), strict=False))
    answers: dict[int, list[tuple[object, ...]]] = defaultdict(list)
    for n_burners in (0, arguments.burners):
        with burners(n_burners):
            for _ in range(arguments.times):
                for k, (_, call) in calls.items():
                    answers[k].append(answer(call))
    counts, problems = Counter[tuple[str, str]](), []
    for k, (name, _) in calls.items():
        finished = {one for one in answers[k] if one[0] != STOPPED_EARLY}
        counts.update((name.split()[1], str(one[0])) for one in answers[k])
        if len(finished) > 1:
            problems.append(f"call {k}, {name}: {len(finished)} different plans")
    states = sorted({state for _, state in counts})
    rows = [[kind, *(str(counts[kind, state]) for state in states)] for kind in KINDS]
    return (["calls", *states], rows), problems


def _calls() -> Iterator[tuple[str, Call]]:
    """Names and calls, all kinds and both robots in turn, without end."""
    scenes = {name: scene_of(name, *example_file(name), n_motions=40) for name in HANDS}
    worlds = {name: mp.World.from_file(config_file(f"{name}_scene.yaml")) for name in scenes}
    planners = {
        (name, kind): planner_of(
            scene,
            worlds[name] if kind == "scene" else None,
            timing="shortest" if kind == "shortest" else "auto",
        )
        for name, scene in scenes.items()
        for kind in KINDS
    }
    problems = {name: held_out_problems(scene, 120, 7) for name, scene in scenes.items()}
    for k in range(10**9):
        kind, name = KINDS[k % len(KINDS)], list(scenes)[k // len(KINDS) % len(scenes)]
        one, two, three = (problems[name][(k + i) % 120] for i in (0, 40, 80))
        goal: object = one.goal
        if kind == "pose":
            place = scenes[name].robot.attached_poses(
                one.goal[None], [HANDS[name]], np.zeros((1, 6))
            )
            goal = mp.Pose(HANDS[name], place[0, 0, :3])
        elif kind == "sequence":
            goal = [one.goal, two.start, three.goal]
        planner = planners[name, kind]
        yield f"{name} {kind}", lambda p=planner, g=goal, s=one.start: p.plan(start=s, goal=g)


def answer(call: Call) -> tuple[object, ...]:
    """Status and content of a plan, or the reason why there is none."""
    try:
        plan = call()
    except PlannerError as error:
        return "rejected", str(error)
    motion = plan.trajectory
    return plan.status, motion.times.tobytes(), *(x.tobytes() for x in motion.states)


@contextmanager
def burners(n: int) -> Iterator[None]:
    """Processes that compute all the time."""
    processes = [multiprocessing.Process(target=_burn, daemon=True) for _ in range(n)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()


def _burn() -> None:
    while True:
        sum(range(10_000))


class DrivenArm(RigidArm):
    """With the damping and the friction of the description."""

    def efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of the drives."""
        damping, friction = (
            x[self.velocity_index] for x in (self.model.damping, self.model.friction)
        )
        return super().efforts(q, v, a) + damping * v + friction * np.tanh(v / CREEP)


def limits(arguments: argparse.Namespace) -> tuple[Table, list[str]]:
    """A row for each robot."""
    n = -(-(arguments.number or 500) // len(ROBOTS))
    rows, problems = [], []
    with mock.patch.object(context.time, "perf_counter", time.process_time):
        for name in ROBOTS:
            scene = scene_of(name, *example_file(name), n_motions=40)
            arm = DrivenArm(scene.urdf, scene.joint_names)
            planners = {
                t: planner_of(scene, timing=t, max_solve_time=MAX_SOLVE_TIME) for t in TIMINGS
            }
            asked = random_problems(scene, n, arguments.seed)
            counts, times, excesses = Counter[str](), [0.0], [0.0]
            for k, problem in enumerate(asked):
                timing = TIMINGS[k % len(TIMINGS)]
                planner = planners[timing]
                if k % 3 == k // 3 % 3:
                    world = _world(scene, problem, np.random.default_rng([arguments.seed, k]))
                    planner = planner_of(scene, world, timing=timing, max_solve_time=MAX_SOLVE_TIME)
                began = time.process_time()
                try:
                    plan = planner.plan(start=problem.start, goal=problem.goal)
                except PlannerError:
                    counts["rejected"] += 1
                    continue
                times.append(time.process_time() - began)
                counts[plan.status] += 1
                call = f"{name}, seed {arguments.seed}, problem {k}, {timing}"
                if times[-1] > MAX_SOLVE_TIME + MORE:
                    problems.append(f"{call}: {1e3 * times[-1]:.0f} ms, {plan.status}")
                if plan.status in (SOLVED, STOPPED_EARLY):
                    found = judge(plan.trajectory, problem, arm, planner.limits, period=PERIOD)
                    excesses.append(found.limit_violation)
                    if excesses[-1] > TOLERANCE:
                        problems.append(f"{call}: {excesses[-1]:.2g} over {found.worst_limit}")
            states = ", ".join(f"{number} {state}" for state, number in counts.most_common())
            rows.append([name, states, f"{1e3 * max(times):.0f}", f"{max(excesses):.1e}"])
    return (["robot", "plans", "longest [ms]", "largest excess"], rows), problems


def _world(scene: Scene, problem: Problem, random: np.random.Generator) -> mp.World:
    """Twelve boxes and balls within reach, not at the hand's start and goal."""
    ends = np.array([problem.start, problem.goal])
    hands = scene.robot.frame_positions(ends, [scene.robot.frame_names[-1]])[:, 0]
    found: list[mp.Obstacle] = []
    while len(found) < 12:
        place, size = hands.mean(axis=0) + random.normal(0.0, 0.3, 3), random.uniform(0.03, 0.1)
        shape = mp.Sphere(size, place) if len(found) % 2 else mp.Box(np.full(3, size), place)
        if np.linalg.norm(hands - place, axis=1).min() > 0.25:
            found.append(mp.Obstacle(f"obstacle {len(found)}", shape))
    return mp.World(found)


PARTS = {"repeats": repeats, "limits": limits}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of a part, and what is wrong."""
    given = options(
        __doc__, arguments, part=PARTS, number=0, times=5, burners=4, seed=0, json=False
    )
    table, problems = PARTS[given.part](given)
    show({f"Random plans: {given.part}": table}, as_json=given.json)
    print(*problems, f"{len(problems)} problems", sep="\n", file=sys.stderr)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
