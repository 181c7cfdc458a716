# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Spheres on the hand's path: share that is avoided, effort and likeness to the demonstration.

Held-out motions of panda are planned in their duration, then again with a sphere where the hand
was. Problems whose start or goal is in collision with it are left out. Plain calls of Pinocchio
check the motions every millisecond.

    python benchmarks/spheres_on_path.py [--problems 200] [--radius 0.05] [--naturalness 1]
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin
from scenes import plain_geometry, scene_of
from tables import benchmark_parser, show

import mp_pca_planner as mp
from mp_pca_planner.evaluation.problems import Problem, held_out_problems, robot_file
from mp_pca_planner.evaluation.referee import RigidArm, judge
from mp_pca_planner.motion.collision import CollisionModel, package_folders
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.planner import Planner, PlannerOptions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive

HAND = "panda_hand"
MAX_TIME = 2.0


def main() -> None:
    """Print a table of the results."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--radius", type=float, default=0.05, help="of the spheres [m]")
    parser.add_argument("--naturalness", type=float, nargs="+", default=[0.01, 1.0])
    arguments = parser.parse_args()
    rows = []
    for naturalness in arguments.naturalness:
        course = Course(naturalness, arguments.radius)
        results = list(course.run(arguments.problems))
        rows.append([f"{naturalness:g}", *summary(np.array(results))])
    header = ["ρ", "spheres hit", "avoided", "J ratio", "90 %", "worst", "from the demonstration"]
    header += ["without sphere", "plan [ms]", "90 %"]
    show({"Spheres on the path": (header, rows)}, as_json=arguments.json)


def summary(results: np.ndarray) -> list[str]:
    """A row of the table of results of `Course.run`."""
    solved = results[results[:, 0] == 1.0]
    _, ratios, bare, careful, seconds = solved.T
    middle, most = np.quantile(1e3 * seconds, [0.5, 0.9])
    return [
        str(len(results)),
        f"{100.0 * len(solved) / len(results):.1f} %",
        *(f"{q:.3f}" for q in np.quantile(ratios, [0.5, 0.9, 1.0])),
        f"{np.median(careful):.1f}°",
        f"{np.median(bare):.1f}°",
        f"{middle:.0f}",
        f"{most:.0f}",
    ]


class Course:
    """Motions of panda with and without a sphere in their path."""

    def __init__(self, naturalness: float, radius: float) -> None:
        self._scene, self._radius = scene_of(*robot_file("panda"), n_motions=30), radius
        folders = package_folders([], self._scene.urdf)
        robot, limits = self._scene.robot, self._scene.limits
        self._collision = CollisionModel(robot, package_dirs=folders)
        primitive = build_primitive(self._scene.demonstrations, "panda", PrimitiveOptions("arm", 8))
        options = PlannerOptions(naturalness=naturalness, max_solve_time=MAX_TIME)
        self._planner = Planner(robot, [primitive], limits, options, self._collision)
        self._arm = RigidArm(self._scene.urdf, robot.joint_names)
        self._model, self._geometry, self._order = plain_geometry(
            self._scene.urdf, robot.joint_names
        )

    def run(self, n_problems: int) -> Iterator[tuple[float, ...]]:
        """Solved (1 or 0), ratio of efforts, distances from the demonstration [deg], time [s]."""
        n, problems = 0, held_out_problems(self._scene, 2 * n_problems, 2)
        for problem in problems:
            self._collision.set_world(mp.World())
            bare = self._plan(problem)
            hand = self._scene.robot.frame_positions(bare.trajectory.positions, [HAND])[:, 0]
            place = hand[len(hand) // 2]
            sphere = mp.Obstacle("sphere", mp.Sphere(self._radius, place))
            self._collision.set_world(mp.World([sphere]))
            if any(map(self._collision.collides, (problem.start, problem.goal))):
                continue
            began = time.perf_counter()
            plan = self._plan(problem)
            seconds = time.perf_counter() - began
            clear = plan.is_executable and not self._collides(plan.trajectory, place)
            before, after = (
                judge(one.trajectory, problem, self._arm, self._scene.limits)
                for one in (bare, plan)
            )
            ratio = after.effort_cost / before.effort_cost
            distances = before.demo_distance_deg, after.demo_distance_deg
            yield float(clear and after.feasible), ratio, *distances, seconds
            n += 1
            if n == n_problems:
                return

    def _plan(self, problem: Problem) -> mp.Plan:
        names = self._scene.robot.joint_names
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        return self._planner.plan(goal, JointState(names, problem.start))

    def _collides(self, trajectory: Trajectory, place: np.ndarray) -> bool:
        """Whether a link touches the sphere at a millisecond."""
        geometry = self._geometry.copy()
        geometry.removeAllCollisionPairs()
        sphere = geometry.addGeometryObject(
            pin.GeometryObject(
                "sphere",
                parent_joint=0,
                placement=pin.SE3(np.eye(3), place),
                collision_geometry=coal.Sphere(self._radius),
            )
        )
        for i in range(sphere):
            geometry.addCollisionPair(pin.CollisionPair(i, sphere))
        data, poses = self._model.createData(), geometry.createData()
        return any(
            pin.computeCollisions(self._model, data, geometry, poses, q[self._order], True)
            for q in interpolate(trajectory).q
        )


if __name__ == "__main__":
    main()
