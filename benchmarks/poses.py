# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Costs of motions to poses beside the best of 16 configurations that reach them.

A pose is planned as it is, then as a goal of each configuration: by inverse kinematics from ends of
demonstrations, from the start, and from random ones. Only configurations like the demonstrations
count (in-span score up to 3, or the least one); the last two columns are about all of them. Poses
are those at the ends of held-out motions.

    python benchmarks/poses.py [--goals 12] [--robots panda,ur5] [--json]
"""

from __future__ import annotations

import numpy as np
from planning_cases import limits_of
from problems import Problem, Scene, held_out_problems, scene_of
from tables import benchmark_parser, show

from mp_pca_planner.cli.example_robots import robot_file
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal
from mp_pca_planner.planning.configurations import (
    POSE_TOLERANCE,
    nearest_configuration,
    starts_near,
)
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.in_span import UNUSUAL_IN_SPAN_SCORE

FRAMES = {
    "human_arm": "wrist",
    "panda": "panda_hand",
    "ur5": "ee_link",
    "kinova": "j2s6s200_end_effector",
}
N_CONFIGURATIONS = 16
DISTINCT = 0.05
"""Least distance between two configurations [rad or m]."""


def main() -> None:
    """Print a row for each robot and kind of pose."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=12, help="of each robot")
    parser.add_argument("--robots", default=",".join(FRAMES))
    arguments = parser.parse_args()
    rows = []
    for name in arguments.robots.split(","):
        scene = scene_of(*robot_file(name), n_motions=40)
        problems = held_out_problems(scene, arguments.goals, 2)
        primitive = build_primitive(scene.demonstrations, name, PrimitiveOptions("arm", 8))
        limits = limits_of(scene, "acceleration") if name in ("panda", "ur5") else scene.limits
        options = PlannerOptions(naturalness=1.0, max_solve_time=10.0)
        planner = Planner(scene.robot, [primitive], limits, options)
        # An arm of four joints has no six degrees of freedom.
        for kind in ("full", "position")[scene.robot.n_joints < 6 :]:
            rows.append([name, kind, *compared(scene, planner, problems, kind)])
    header = ["robot", "pose", "executable", "configurations", "like demonstrations"]
    header += ["score", "/ best, mean", "worst", "/ best of all, mean", "worst"]
    show({"Cost of motions to poses, ρ = 1": (header, rows)}, as_json=arguments.json)


def compared(scene: Scene, planner: Planner, problems: list[Problem], kind: str) -> list[str]:
    """The figures of a row."""
    ratios, numbers, scores, executable = [], [], [], []
    for problem in problems:
        start = JointState(scene.robot.joint_names, problem.start)
        pose = pose_of(scene, problem, kind)
        plan = planner.plan(PoseGoal(pose), start)
        executable.append(plan.is_executable)
        others = motions_to(scene, planner, pose, start)
        least = min(one.in_span_score for one in others)
        natural = [one for one in others if one.in_span_score <= max(least, UNUSUAL_IN_SPAN_SCORE)]
        scores.append(plan.in_span_score)
        numbers.append([len(others), len(natural)])
        best = [min(one.cost for one in group) for group in (natural, others)]
        ratios.append(plan.cost / np.array(best))
    mean, worst = np.mean(ratios, axis=0), np.max(ratios, axis=0)
    figures = [f"{x:.3f}" for pair in zip(mean, worst, strict=True) for x in pair]
    counts = [f"{x:.1f}" for x in np.mean(numbers, axis=0)]
    return [f"{np.mean(executable):.0%}", *counts, f"{np.mean(scores):.2f}", *figures]


def motions_to(scene: Scene, planner: Planner, pose: Pose, start: JointState) -> list[Plan]:
    """Executable motions to different configurations that reach a pose."""
    ends = np.array([motion.positions[-1] for motion in scene.demonstrations])
    low = np.maximum(planner.limits.lower, -np.pi)
    random = np.random.default_rng(0).uniform(
        low, np.minimum(planner.limits.upper, np.pi), (40, len(low))
    )
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


def pose_of(scene: Scene, problem: Problem, kind: str) -> Pose:
    """The pose at the end of a held-out motion."""
    frame = FRAMES[scene.name]
    place = scene.robot.attached_poses(problem.goal[None], [frame], np.zeros((1, 6)))[0, 0]
    return Pose(frame, place[:3], place[3:] if kind == "full" else None)


if __name__ == "__main__":
    main()
