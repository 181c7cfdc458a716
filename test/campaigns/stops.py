# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Stops of a robot among obstacles: how many collide, and the processor time to find them.

A simulated robot moves among 20 obstacles in virtual time and is stopped at a random moment. Of the
kinds of stops, one is of a robot that follows its motion; before another one, a sphere appears
ahead of the hand; the others are of a slowed robot, of one that is held, and of one that sends no
states. Plain calls of Pinocchio check the commands after the stop every millisecond. Stops along
the path are free of collisions but with a new obstacle; others are not checked.

    python3 -m campaigns.stops [--stops 200] [--obstacles 20] [--robots panda,ur5] [--seed 0]
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from support.problems import Scene
from support.tables import benchmark_parser, show
from support.virtual_node import VirtualNode, scene_and_model

import mp_pca_planner as mp
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.robot.examples import example_file
from mp_pca_planner.robot.meshes import package_folders

KINDS = ("on its motion", "new obstacle", "slowed", "held", "silent")
MARGIN = 0.01
FREE = 0.05  # distance of obstacles from the ends of motions [m]
AHEAD = (0.25, 0.6)  # time after which the hand would be near a new obstacle [s]
ASIDE = 0.04  # standard deviation of its distance from the hand's path along each axis [m]


def main() -> None:
    """Print a row for each robot and kind of stop."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--stops", type=int, default=200, help="of each robot")
    parser.add_argument("--obstacles", type=int, default=20)
    parser.add_argument("--robots", default="panda,ur5")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    header = ["robot", "kind", "stops", "collide", "median [ms]", "99 %", "longest"]
    rows = []
    for name in arguments.robots.split(","):
        course = Course(name, arguments.obstacles)
        random = np.random.default_rng(arguments.seed)
        found = [course.stop(KINDS[k % len(KINDS)], random) for k in range(arguments.stops)]
        for kind in KINDS:
            own = [one for one in found if one is not None and one[0] == kind]
            hits, seconds = (np.array([one[k] for one in own]) for k in (1, 2))
            times = [f"{1e3 * x:.1f}" for x in np.quantile(seconds, [0.5, 0.99, 1.0])]
            rows.append([name, kind, str(len(own)), str(hits.sum()), *times])
    show({"Stops among obstacles": (header, rows)}, as_json=arguments.json)


class Course:
    """Motions of a robot between the ends of its demonstrations."""

    def __init__(self, name: str, n_obstacles: int) -> None:
        folders = package_folders([], example_file(name)[0])
        self._scene, self._model = scene_and_model(
            name,
            collision=True,
            obstacle_margin=MARGIN,
            package_dirs=tuple(map(str, folders)),
            max_solve_time=1.0,
        )
        self._robot, self._n = self._scene.robot, n_obstacles
        self._ends = np.array([m.positions[[0, -1]] for m in self._scene.demonstrations])

    def stop(self, kind: str, random: np.random.Generator) -> tuple[str, bool, float] | None:
        """Kind, whether the stop collides, and the time to find it [s].

        None if the goal was refused.
        """
        start, goal = self._ends[random.integers(len(self._ends))]
        world = self._world(np.array([start, goal]), random)
        node = VirtualNode(self._model, start, seed=int(random.integers(1_000_000)))
        faults = node.robot.faults
        node.use_world(world)
        node.run(0.2)
        node.goal(JointGoal(JointState(self._robot.joint_names, goal)), "goal")
        node.run(0.1)
        if node.server.execution is None:
            return None
        motion = node.server.execution.motion
        node.run(random.uniform(0.2, 0.7) * motion.duration)
        if kind == "new obstacle":
            ahead = motion.state(node.now - motion.began + random.uniform(*AHEAD)).positions
            hand = self._robot.frame_positions(ahead[None], [self._model.end_effector])[0, 0]
            place = hand + random.normal(0.0, ASIDE, 3)
            world = world.with_obstacles(mp.Obstacle("new", mp.Sphere(0.03, place)))
            if PlainCheck(self._scene, world).collides(node.robot.record.q[-1:], MARGIN):
                return None
            node.use_world(world)
            node.run(0.01)
        elif kind == "slowed":
            faults.speed_scaling = random.uniform(0.2, 0.8)
            node.run(random.uniform(0.0, 0.3))
        elif kind == "held":
            faults.held = True
            node.run(random.uniform(0.05, 0.3))
        elif kind == "silent":
            faults.silent = True
            node.run(random.uniform(0.55, 0.8))
        came, began = node.now, time.process_time()
        node.stop()
        seconds = time.process_time() - began
        node.run(3.0)
        record = node.robot.record
        hit = PlainCheck(self._scene, world).collides(record.q[record.times >= came])
        return kind, hit, seconds

    def _world(self, ends: Any, random: np.random.Generator) -> mp.World:
        """Obstacles around the hand's motion, away from its ends."""
        hands = self._robot.frame_positions(ends, [self._model.end_effector])[:, 0]
        found: list[mp.Obstacle] = []
        while len(found) < self._n:
            place = hands.mean(axis=0) + random.normal(0.0, 0.3, 3)
            size = random.uniform(0.03, 0.1)
            shape = mp.Sphere(size, place) if len(found) % 2 else mp.Box(np.full(3, size), place)
            one = mp.Obstacle(f"obstacle {len(found)}", shape)
            if not PlainCheck(self._scene, mp.World([one])).collides(ends, FREE):
                found.append(one)
        return mp.World(found)


class PlainCheck:
    """Links that move and the obstacles of a world, for Pinocchio alone."""

    def __init__(self, scene: Scene, world: mp.World) -> None:
        self._model, links, self._order = plain_geometry(scene.urdf, scene.robot.joint_names)
        links.removeAllCollisionPairs()
        moving = [i for i, part in enumerate(links.geometryObjects) if part.parentJoint]
        for obstacle in world:
            (shape,) = obstacle.shapes
            is_ball = isinstance(shape, mp.Sphere)
            body = coal.Sphere(shape.radius) if is_ball else coal.Box(*shape.size)
            place = pin.SE3(np.eye(3), shape.position)
            part = pin.GeometryObject(
                obstacle.name, parent_joint=0, placement=place, collision_geometry=body
            )
            number = links.addGeometryObject(part)
            for i in moving:
                links.addCollisionPair(pin.CollisionPair(i, number))
        self._geometry, self._data, self._poses = (
            links,
            self._model.createData(),
            links.createData(),
        )

    def collides(self, q: Any, margin: float = 0.0) -> bool:
        """Whether a link is nearer to an obstacle than a margin [m] anywhere."""
        for request in self._poses.collisionRequests:
            request.security_margin = margin
        bodies = self._model, self._data, self._geometry, self._poses
        return any(pin.computeCollisions(*bodies, one[self._order], True) for one in q)


def plain_geometry(urdf: Path, joints: Sequence[str]) -> tuple[Any, Any, list[int]]:
    """Model, collision geometry and order of some joints by Pinocchio alone, others locked."""
    full = pin.buildModelFromUrdf(str(urdf))
    kind, folders = pin.GeometryType.COLLISION, [str(folder) for folder in urdf.parents]
    links = pin.buildGeomFromUrdf(full, str(urdf), kind, package_dirs=folders)
    locked = [i for i, name in enumerate(full.names) if i > 0 and name not in joints]
    rest = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
    model, links = pin.buildReducedModel(full, links, locked, rest)
    return model, links, [list(joints).index(name) for name in model.names[1:]]


if __name__ == "__main__":
    main()
