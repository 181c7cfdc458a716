# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning times by what a goal asks for: limits, motion at the start, poses, durations.

    python benchmarks/planning_cases.py [--goals 40] [--robots panda,ur5] [--cases pose] [--json]

Goals are those of held-out motions; the primitive has 8 components of the whole arm. The floor is
ten passes of 16 nodes of `computeRNEADerivatives`, called from Python in the same run between the
plans. Limits of acceleration are those of MoveIt's panda (ur5: 3 rad/s²), those of jerk 20 times
as much.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from problems import Problem, Scene, held_out_problems, scene_of
from referee import RigidArm
from support.virtual_node import MAX_ACCELERATION
from tables import benchmark_parser, show

from mp_pca_planner.cli.example_robots import robot_file
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal
from mp_pca_planner.planning.options import FREE, SHORTEST, PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.robot.limits import JointLimits

JERK_PER_ACCELERATION = 20.0
FLOOR_CALLS = 160
"""Calls in ten passes of 16 nodes."""

END_EFFECTORS = {"panda": "panda_hand", "ur5": "ee_link"}


@dataclass(frozen=True)
class Case:
    """A row: what is asked for, and the goals of time / floor at ρ = 1 and at ρ = 0."""

    name: str
    limits: str
    goals: tuple[float | None, float | None]
    moves: bool = False
    pose: str = ""
    timing: str = "demonstrated"


CASES = (
    Case("limits of the URDF", "urdf", (2.0, 5.0)),
    Case("and acceleration", "acceleration", (4.0, 8.0)),
    Case("and acceleration and jerk", "jerk", (6.0, 12.0)),
    Case("the same, starting in motion", "jerk", (6.0, 12.0), moves=True),
    Case("pose goal, position only", "jerk", (12.0, 25.0), pose="position"),
    Case("pose goal, full", "jerk", (10.0, 20.0), pose="full"),
    Case("shortest duration", "jerk", (30.0, None), timing=SHORTEST),
    Case("free duration", "jerk", (6.0, None), timing=FREE),
)


def main() -> None:
    """Print a table of every case."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=40)
    parser.add_argument("--robots", default="panda,ur5")
    parser.add_argument("--cases", default="", help="only those whose name contains this text")
    arguments = parser.parse_args()
    cases = [case for case in CASES if arguments.cases in case.name]
    found = []
    for name in arguments.robots.split(","):
        scene = scene_of(*robot_file(name), n_motions=40)
        problems = held_out_problems(scene, arguments.goals, 2)
        for case in cases:
            for naturalness, goal in zip((1.0, 0.0), case.goals, strict=True):
                if goal is not None:
                    found.append(measured(scene, problems, case, naturalness, goal))
    header = ["robot", "case", "ρ", "median [ms]", "99 % / median", "passes", "executable"]
    rows = [
        [
            one["robot"],
            one["case"],
            f"{one['naturalness']:g}",
            f"{1e3 * one['median_s']:.2f}",
            f"{one['p99_over_median']:.1f}",
            f"{one['passes']:g}",
            f"{one['executable']:.0%}",
            f"{one['over_floor']:.1f}",
            f"{one['goal']:g}",
        ]
        for one in found
    ]
    header += ["/ floor", "goal"]
    show({"What a goal asks for": (header, rows)}, as_json=arguments.json)


def measured(
    scene: Scene, problems: list[Problem], case: Case, naturalness: float, goal: float
) -> dict[str, float | str]:
    """Times of one case."""
    options = PrimitiveOptions(coupling="arm", n_components=8)
    primitive = build_primitive(scene.demonstrations, "speed", options)
    planner = Planner(
        scene.robot,
        [primitive],
        limits_of(scene, case.limits),
        PlannerOptions(naturalness=naturalness, timing=case.timing, max_solve_time=10.0),
    )
    call = rnea_call(scene)
    names, times, calls, passes, executable = scene.robot.joint_names, [], [], [], []
    for problem in problems:
        start = JointState(names, problem.start)
        if case.moves:
            start = moving_start(planner, problem)
        request = goal_of(scene, problem, case)
        began = time.perf_counter()
        plan = planner.plan(request, start)
        times.append(time.perf_counter() - began)
        calls.append(call())
        passes.append(plan.solution.iterations)
        executable.append(plan.is_executable)
    median = float(np.median(times))
    return {
        "robot": scene.name,
        "case": case.name,
        "naturalness": naturalness,
        "median_s": median,
        "p99_over_median": float(np.percentile(times, 99)) / median,
        "passes": float(np.median(passes)),
        "executable": float(np.mean(executable)),
        "over_floor": median / (FLOOR_CALLS * float(np.median(calls))),
        "goal": goal,
    }


def limits_of(scene: Scene, which: str) -> JointLimits:
    """The limits of the robot description, with those of acceleration and jerk if asked for."""
    if which == "urdf":
        return scene.limits
    overrides = {}
    for name, most in zip(scene.robot.joint_names, MAX_ACCELERATION[scene.name], strict=True):
        overrides[name] = {"max_acceleration": most}
        if which == "jerk":
            overrides[name]["max_jerk"] = JERK_PER_ACCELERATION * most
    return scene.robot.limits(overrides)


def goal_of(scene: Scene, problem: Problem, case: Case) -> JointGoal | PoseGoal:
    """The goal of a held-out motion, as a configuration or as a pose of the last link."""
    if not case.pose:
        return JointGoal(JointState(scene.robot.joint_names, problem.goal))
    arm = RigidArm(scene.urdf, scene.robot.joint_names).model
    data, frame = arm.createData(), END_EFFECTORS[scene.name]
    pin.framesForwardKinematics(arm, data, problem.goal)
    there = data.oMf[arm.getFrameId(frame)]
    turned = pin.Quaternion(there.rotation).coeffs() if case.pose == "full" else None
    return PoseGoal(Pose(frame, there.translation, turned))


def moving_start(planner: Planner, problem: Problem) -> JointState:
    """The state at 30 % of a motion to the same goal from elsewhere."""
    names = planner.robot.joint_names
    before = JointState(names, 2.0 * problem.start - problem.goal)
    lower, upper = planner.limits.lower, planner.limits.upper
    before = JointState(names, np.clip(before.positions, lower + 0.05, upper - 0.05))
    plan = planner.plan(JointGoal(JointState(names, problem.goal)), before)
    trajectory = plan.trajectory
    k = round(0.3 * len(trajectory.times))
    return JointState(
        names, trajectory.positions[k], trajectory.velocities[k], trajectory.accelerations[k]
    )


def rnea_call(scene: Scene) -> Callable[[], float]:
    """Measures the time of one call of the dynamics [s]."""
    model = RigidArm(scene.urdf, scene.robot.joint_names).model
    data, q, v = model.createData(), pin.neutral(model), np.full(model.nv, 0.1)

    def call() -> float:
        began = time.perf_counter()
        for _ in range(FLOOR_CALLS):
            pin.computeRNEADerivatives(model, data, q, v, v)
        return (time.perf_counter() - began) / FLOOR_CALLS

    return call


if __name__ == "__main__":
    main()
