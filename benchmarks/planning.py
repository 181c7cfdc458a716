#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Times and success of plans: how long, within which limits, to what kind of goal.

    python3 benchmarks/planning.py speed|cases|poses|sequences [--number 40] [--robots panda,ur5]

speed: bases and naturalness, limits of the URDF, durations given.
cases: limits of acceleration and jerk, motion at the start, poses, free and shortest durations.
poses: cost of motions to poses, beside the best of 16 configurations that reach them.
sequences: motions through five goals, beside stopping at each in the same total duration.

Goals are those of held-out motions. The floor is ten passes of `computeRNEADerivatives` at every
node of the grid, called from Python between the plans: no planner of this kind needs less.
Limits of acceleration are those of MoveIt's panda (ur5: 3 rad/s²), those of jerk 20 times as much.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from support.motion_referee import RigidArm
from support.problems import Problem, Scene, held_out_problems, scene_of
from support.tables import Table, benchmark_parser, show
from support.virtual_node import JERK_OF_ACCELERATION, MAX_ACCELERATION

from mp_pca_planner.motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from mp_pca_planner.planning.configurations import (
    POSE_TOLERANCE,
    nearest_configuration,
    starts_near,
)
from mp_pca_planner.planning.motion import Tables, cost_of, samples_of
from mp_pca_planner.planning.objectives import effort
from mp_pca_planner.planning.options import FREE, OPTIMAL, REAL_TIME, SHORTEST, PlannerOptions
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.request import NATURAL
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from mp_pca_planner.robot.examples import example_file
from mp_pca_planner.robot.limits import JointLimits

END_EFFECTORS = {
    "human_arm": "wrist",
    "panda": "panda_hand",
    "ur5": "ee_link",
    "kinova": "j2s6s200_end_effector",
}
FLOOR_PASSES = 10
N_CALLS = 160
"""Calls of the dynamics that are timed after each plan."""


def main() -> None:
    """Print the table of a part."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--number", type=int, help="of goals of each robot, or of sequences")
    parser.add_argument("--robots", help="separated by commas")
    arguments = parser.parse_args()
    show(PARTS[arguments.part](arguments), as_json=arguments.json)


def scenes(robots: str) -> list[Scene]:
    """Robots by their names, with 40 demonstrations each."""
    return [scene_of(name, *example_file(name), n_motions=40) for name in robots.split(",")]


def planner_of(
    scene: Scene,
    options: PlannerOptions,
    limits: JointLimits | None = None,
    components: PrimitiveOptions | None = None,
) -> Planner:
    """A planner with one primitive; by default of 8 components, within the limits of the URDF."""
    components = components or PrimitiveOptions("arm", 8)
    primitive = build_primitive(scene.demonstrations, "reach", components)
    return Planner(scene.robot, [primitive], limits or scene.limits, options, collision=False)


def limits_of(scene: Scene, *, jerk: bool) -> JointLimits:
    """The limits of the URDF, of acceleration and, if asked for, of jerk."""
    overrides = {}
    for name, most in zip(scene.robot.joint_names, MAX_ACCELERATION[scene.name], strict=True):
        overrides[name] = {"max_acceleration": most}
        if jerk:
            overrides[name]["max_jerk"] = JERK_OF_ACCELERATION * most
    return scene.robot.limits(overrides)


class Stopwatch:
    """Measures one call of the dynamics of a robot, between the plans."""

    def __init__(self, scene: Scene) -> None:
        self._model = RigidArm(scene.urdf, scene.robot.joint_names).model
        self._data = self._model.createData()
        self._state = pin.neutral(self._model), np.full(self._model.nv, 0.1)
        self._calls: list[float] = []

    def measure(self) -> None:
        """Time some calls."""
        q, v = self._state
        began = time.perf_counter()
        for _ in range(N_CALLS):
            pin.computeRNEADerivatives(self._model, self._data, q, v, v)
        self._calls.append((time.perf_counter() - began) / N_CALLS)

    def floor(self, n_nodes: int) -> float:
        """Time of ten passes of some nodes [s]."""
        return FLOOR_PASSES * n_nodes * float(np.median(self._calls))


def speed(arguments: argparse.Namespace) -> dict[str, Table]:
    """A row for each robot and basis."""
    rows = []
    for scene in scenes(arguments.robots or "human_arm,panda"):
        problems, names = held_out_problems(scene, arguments.number or 200, 2), scene.joint_names
        for label, components, basis, rho in (
            ("components, arm", PrimitiveOptions("arm", 8), "pca", 1.0),
            ("components, arm", PrimitiveOptions("arm", 8), "pca", 0.0),
            ("components, joint", PrimitiveOptions("joint", 4), "pca", 1.0),
            ("components, joint", PrimitiveOptions("joint", 4), "pca", 0.0),
            ("B-splines", PrimitiveOptions("arm", 8), "bspline", 0.0),
        ):
            options = PlannerOptions(basis=basis, naturalness=rho)
            planner, watch = planner_of(scene, options, None, components), Stopwatch(scene)
            plans = []
            for one in problems:
                goal = JointGoal(JointState(names, one.goal), one.duration)
                plans.append(planner.plan(goal, JointState(names, one.start)))
                watch.measure()
            basis_used = plans[-1].motion.basis
            n_nodes = Tables(basis_used).n_nodes
            seconds = [plan.solve_time for plan in plans]
            row = [scene.name, label, f"{rho:g}", str(basis_used.n_weights), str(n_nodes)]
            rows.append([*row, *_figures(plans, seconds, watch.floor(n_nodes))])
    header = ["robot", "basis", "ρ", "weights", "nodes", *_FIGURES]
    return {"Time of a plan: the optimisation alone": (header, rows)}


_FIGURES = ["median [ms]", "99 % [ms]", "passes", "executable [%]", "/ floor"]


def _figures(plans: Sequence[Plan], seconds: Sequence[float], floor: float) -> list[str]:
    median = np.median(seconds)
    return [
        f"{1e3 * median:.2f}",
        f"{1e3 * np.percentile(seconds, 99):.2f}",
        f"{np.median([plan.iterations for plan in plans]):g}",
        f"{100 * np.mean([plan.is_executable for plan in plans]):.0f}",
        f"{median / floor:.1f}",
    ]


@dataclass(frozen=True)
class Case:
    """What is asked for; `limits` are those of the URDF and more."""

    name: str
    limits: str = "jerk"
    moves: bool = False
    pose: str = ""
    timing: str = "demonstrated"

    @property
    def naturalness(self) -> tuple[float, ...]:
        """Naturalness weights with which it is planned."""
        return (1.0, 0.0) if self.timing == "demonstrated" else (1.0,)


CASES = (
    Case("limits of the URDF", "urdf"),
    Case("and acceleration", "acceleration"),
    Case("and acceleration and jerk"),
    Case("the same, starting in motion", moves=True),
    Case("pose goal, position only", pose="position"),
    Case("pose goal, full", pose="full"),
    Case("shortest duration", timing=SHORTEST),
    Case("free duration", timing=FREE),
)
N_CASE_NODES = 16
"""Nodes of a pass in the floor of a case, whose grids differ."""


def cases(arguments: argparse.Namespace) -> dict[str, Table]:
    """A row for each robot, case and naturalness; times of whole calls."""
    rows, asked = [], [(one, rho) for one in CASES for rho in one.naturalness]
    for scene in scenes(arguments.robots or "panda,ur5"):
        problems = held_out_problems(scene, arguments.number or 40, 2)
        for case, rho in asked:
            options = PlannerOptions(naturalness=rho, timing=case.timing, max_solve_time=10.0)
            is_plain = case.limits == "urdf"
            limits = None if is_plain else limits_of(scene, jerk=case.limits == "jerk")
            planner, watch = planner_of(scene, options, limits), Stopwatch(scene)
            plans, seconds = [], []
            for problem in problems:
                start = JointState(scene.joint_names, problem.start)
                if case.moves:
                    start = moving_start(planner, problem)
                goal = case_goal(scene, problem, case)
                began = time.perf_counter()
                plans.append(planner.plan(goal, start))
                seconds.append(time.perf_counter() - began)
                watch.measure()
            figures = _figures(plans, seconds, watch.floor(N_CASE_NODES))
            rows.append([scene.name, case.name, f"{rho:g}", *figures])
    return {"What a goal asks for: whole calls": (["robot", "case", "ρ", *_FIGURES], rows)}


def case_goal(scene: Scene, problem: Problem, case: Case) -> Goal:
    """The goal of a held-out motion, as a configuration or as a pose."""
    if case.pose:
        return PoseGoal(pose_of(scene, problem, case.pose))
    return JointGoal(JointState(scene.joint_names, problem.goal))


def pose_of(scene: Scene, problem: Problem, kind: str) -> Pose:
    """The pose at the end of a held-out motion, "full" or its "position"."""
    frame = END_EFFECTORS[scene.name]
    place = scene.robot.attached_poses(problem.goal[None], [frame], np.zeros((1, 6)))[0, 0]
    return Pose(frame, place[:3], place[3:] if kind == "full" else None)


def moving_start(planner: Planner, problem: Problem) -> JointState:
    """The state at 30 % of a motion to the same goal from elsewhere."""
    names, limits = planner.robot.joint_names, planner.limits
    before = np.clip(2.0 * problem.start - problem.goal, limits.lower + 0.05, limits.upper - 0.05)
    plan = planner.plan(JointGoal(JointState(names, problem.goal)), JointState(names, before))
    k = round(0.3 * len(plan.trajectory.times))
    return JointState(names, *(states[k] for states in plan.trajectory.states))


N_CONFIGURATIONS = 16
DISTINCT = 0.05
"""Least distance between two configurations [rad or m]."""


def poses(arguments: argparse.Namespace) -> dict[str, Table]:
    """A row for each robot and kind of pose.

    A pose is planned as it is, then as a goal of each configuration: by inverse kinematics from
    ends of demonstrations, from the start, and from random ones. Those like the demonstrations have
    an in-span score up to 3, or the least one; the last two columns are about all.
    """
    rows = []
    for scene in scenes(arguments.robots or ",".join(END_EFFECTORS)):
        problems = held_out_problems(scene, arguments.number or 12, 2)
        limits = limits_of(scene, jerk=False) if scene.name in MAX_ACCELERATION else None
        options = PlannerOptions(naturalness=1.0, max_solve_time=10.0)
        planner = planner_of(scene, options, limits)
        # An arm of four joints has no six degrees of freedom.
        for kind in ("full", "position")[scene.robot.n_joints < 6 :]:
            rows.append([scene.name, kind, *compared_poses(scene, planner, problems, kind)])
    header = ["robot", "pose", "executable", "configurations", "like demonstrations"]
    header += ["score", "/ best, mean", "worst", "/ best of all, mean", "worst"]
    return {"Cost of motions to poses, ρ = 1": (header, rows)}


def compared_poses(scene: Scene, planner: Planner, problems: list[Problem], kind: str) -> list[str]:
    """The figures of a row."""
    ratios, numbers, plans = [], [], []
    for problem in problems:
        start = JointState(scene.joint_names, problem.start)
        pose = pose_of(scene, problem, kind)
        plans.append(planner.plan(PoseGoal(pose), start))
        others = motions_to(scene, planner, pose, start)
        most = max(UNUSUAL_IN_SPAN_SCORE, min(one.in_span_score for one in others))
        natural = [one for one in others if one.in_span_score <= most]
        numbers.append([len(others), len(natural)])
        best = [min(one.cost for one in group) for group in (natural, others)]
        ratios.append(plans[-1].cost / np.array(best))
    mean, worst = np.mean(ratios, axis=0), np.max(ratios, axis=0)
    return [
        f"{np.mean([plan.is_executable for plan in plans]):.0%}",
        *(f"{x:.1f}" for x in np.mean(numbers, axis=0)),
        f"{np.mean([plan.in_span_score for plan in plans]):.2f}",
        *(f"{x:.3f}" for pair in zip(mean, worst, strict=True) for x in pair),
    ]


def motions_to(scene: Scene, planner: Planner, pose: Pose, start: JointState) -> list[Plan]:
    """Executable motions to different configurations that reach a pose."""
    ends = np.array([motion.positions[-1] for motion in scene.demonstrations])
    low, high = np.clip([planner.limits.lower, planner.limits.upper], -np.pi, np.pi)
    random = np.random.default_rng(0).uniform(low, high, (40, len(low)))
    found: list[np.ndarray] = []
    for first in (*starts_near(scene.robot, pose, ends, 12), start.positions, *random):
        q, error = nearest_configuration(scene.robot, planner.limits, pose, first)
        is_new = all(np.abs(q - other).max() > DISTINCT for other in found)
        if np.abs(error).max() <= POSE_TOLERANCE and is_new:
            found.append(q)
        if len(found) == N_CONFIGURATIONS:
            break
    plans = [planner.plan(JointGoal(JointState(start.joint_names, q)), start) for q in found]
    return [plan for plan in plans if plan.is_executable]


def sequences(arguments: argparse.Namespace) -> dict[str, Table]:
    """Sequences of five segments of the human-like arm, and the time of longer ones.

    They are joined in real time, optimised, optimised with the vias at the times of stopping, and
    optimised through the positions of the wrist, which leave one degree of freedom each.
    """
    (scene,) = scenes("human_arm")
    robot, names = scene.robot, scene.joint_names
    primitive = build_primitive(scene.demonstrations, "reach", PrimitiveOptions(n_components=6))
    planner = Planner(
        robot, [primitive], options=PlannerOptions(max_solve_time=float("inf")), collision=False
    )
    # As sequences are planned, whatever the in-span score: in the predicted durations.
    alike = replace(planner.options, naturalness=NATURAL, timing="demonstrated")
    stopping_planner = Planner(robot, [primitive], options=alike, collision=False)
    held_out = held_out_problems(scene, 60, 2)
    ends = np.array([q for problem in held_out for q in (problem.start, problem.goal)])
    rng = np.random.default_rng(0)
    found: dict[str, list[Plan]] = {}
    stopping = []
    for _ in range(arguments.number or 50):
        start, *vias = [JointState(names, q) for q in ends[rng.choice(len(ends), 6, replace=False)]]
        alone = [stopping_planner.plan(JointGoal(b), a).motion for a, b in pairwise([start, *vias])]
        costs = [cost_of(robot, one, Tables(one.basis), [(1.0, effort)]) for one in alone]
        stopping.append(sum(costs))
        goal = SequenceGoal(tuple(vias))
        passing = np.cumsum([motion.duration for motion in alone]).tolist()
        places = robot.frame_positions(np.array([q.positions for q in vias]), ["wrist"])[:, 0]
        through_poses = SequenceGoal(tuple(Pose("wrist", place) for place in places))
        for name, asked, mode in (
            ("real time", goal, REAL_TIME),
            ("optimal", goal, OPTIMAL),
            ("optimal, times of stopping", SequenceGoal(goal.targets, tuple(passing)), OPTIMAL),
            ("optimal, through poses", through_poses, OPTIMAL),
        ):
            found.setdefault(name, []).append(planner.plan(asked, start, mode))
    rows = [[name, *_sequence_figures(plans, stopping)] for name, plans in found.items()]
    header = ["5 segments", "executable [%]", "optimised [%]", "largest jump"]
    header += ["effort saved against stopping [%]", "beyond ends [rad]", "90 %"]
    tables = {"Sequences of five segments": ([*header, "median [ms]", "99 % [ms]"], rows)}
    rows = []
    for n in (5, 10, 20, 50):
        start, *vias = [
            JointState(names, q) for q in ends[rng.choice(len(ends), n + 1, replace=False)]
        ]
        goal = SequenceGoal(tuple(vias))
        plans = [planner.plan(goal, start, mode) for mode in (REAL_TIME, OPTIMAL)]
        times = [f"{1e3 * plan.solve_time:.1f}" for plan in plans]
        rows.append([str(n), plans[1].mode, *times, str(plans[1].iterations)])
    header = ["segments", "mode", "real time [ms]", "optimal [ms]", "passes"]
    tables["Longer sequences"] = (header, rows)
    return tables


def _sequence_figures(plans: list[Plan], stopping: list[float]) -> list[str]:
    saved = 1.0 - np.mean([p.effort_cost for p in plans] / np.array(stopping))
    overshoots = [beyond for plan in plans for beyond in beyond_ends(plan)]
    times = [1e3 * plan.solve_time for plan in plans]
    return [
        f"{100 * np.mean([p.is_executable for p in plans]):.0f}",
        f"{100 * np.mean([p.mode == OPTIMAL for p in plans]):.0f}",
        f"{max(jump(p) for p in plans):.1e}",
        f"{100 * saved:.1f}",
        f"{np.median(overshoots):.2f}",
        f"{np.percentile(overshoots, 90):.2f}",
        f"{np.median(times):.2f}",
        f"{np.percentile(times, 99):.2f}",
    ]


def beyond_ends(plan: Plan) -> list[float]:
    """Largest overshoot of a joint beyond its positions at the ends of each segment [rad]."""
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


PARTS = {"speed": speed, "cases": cases, "poses": poses, "sequences": sequences}

if __name__ == "__main__":
    main()
