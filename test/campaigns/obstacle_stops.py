# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How long before a collision a moving robot is stopped, while the node is kept busy.

In each trial, an obstacle appears on the path of a running motion, or at its goal. Meanwhile,
another process has the node reload 300 primitives, changes parameters and sends mesh files that are
bombs. Measured is the time from the next trajectory, a stop or a detour, to the collision of the
motion that was running. The goal is 0.3 s or more. Obstacles with which the robot would collide in
less than 0.8 s, or collides already, are not counted. After a late reaction, the log of the node
follows::

    python3 -m campaigns.obstacle_stops [--trials 200] [--primitives 300] [--quiet]

The script exits with status 1 if a reaction comes later.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import nullcontext
from itertools import count
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
from node import LIMITS
from support.arm import JOINTS, arm_robot
from support.bench import Bench
from support.hostile_meshes import write_bombs
from support.nodes import NodeClient, arm_node, other_process, simulated_robot
from support.tables import options
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.recordings.synthetic import generate_motions
from mp_pca_planner.robot.world import Obstacle, Sphere, World
from mp_pca_planner.ros.client import this_machine_only
from mp_pca_planner.ros.messages import to_seconds, to_trajectory
from mp_pca_planner.ros.nodes import EVERY

GOAL = 0.3
"""Least time from a reaction to the collision that it prevents [s]."""

RADIUS, MARGIN = 0.03, 0.01
DURATION = 4.0  # of the motions that are interrupted [s]
APPEARS, EARLIEST = 0.2, 1.0  # share of the time to a collision, and the least such time [s]
TIMEOUT = 60.0
PAUSE = 0.5  # between rounds of the busy process: goals that wait for a set-up are refused [s]


def main() -> int:
    """Run the trials, print the results, and return the exit status."""
    arguments = options(__doc__, trials=200, primitives=300, quiet=False)
    os.environ.update(this_machine_only())
    n = arguments.trials
    ends = [motion.positions[-1] for motion in generate_motions(2 * n + 10, seed=2)]
    limits = {f"limits.{j}.{key}": value for j in JOINTS for key, value in LIMITS.items()}
    given = {"duration": DURATION, "obstacle_margin": MARGIN, **limits}
    found, n_read = list[tuple[float, float]](), 0
    with (
        arm_node(**given, n_primitives=arguments.primitives, may_trace=True) as (_, folder),
        simulated_robot(folder / "robot.txt", ends[0]),
        NodeClient() as client,
        nullcontext() if arguments.quiet else other_process(_keep_busy, folder),
    ):
        user = User(client)
        for k, end in enumerate(ends[1:]):
            if len(found) == n:
                break
            times = user.trial(end, share=(0.7, 1.0)[k % 2])
            if times is None:
                continue
            found.append(times)
            reserve, took = times
            text = f"{took:.3f} s after the obstacle, {reserve:.3f} s before the collision"
            print(f"trial {len(found)}: {text}", flush=True)
            log = (folder / "log.txt").read_text(errors="replace")
            if reserve < GOAL:
                print(log[n_read:])
            n_read = len(log)
    reserves, reactions = np.array(found).T
    late = int((reserves < GOAL).sum())
    print(f"{n} obstacles on the path of running motions, {late} reactions later than {GOAL:g} s")
    for what, values, worst in (
        ("reaction to collision", reserves, reserves.min()),
        ("obstacle to reaction", reactions, reactions.max()),
    ):
        print(f"  {what}: median {np.median(values):.2f} s, worst {worst:.3f} s")
    return int(late > 0)


class User:
    """Sends goals and obstacles, and measures when trajectories come."""

    def __init__(self, client: NodeClient) -> None:
        self._client, self._robot, self._bench = client, arm_robot(), Bench(client, client.node)
        topic = f"{client.planner}/obstacles"
        self._obstacles = client.node.create_publisher(MarkerArray, topic, EVERY)
        client.wait_for_node(TIMEOUT)
        client.wait_for_model()
        client.wait(lambda: self._obstacles.get_subscription_count() > 0, TIMEOUT, "not met")
        client.wait(lambda: bool(self._bench.measured), TIMEOUT, "was not heard")

    def trial(self, goal: np.ndarray, share: float) -> tuple[float, float] | None:
        """Put an obstacle at a share of the way to a goal.

        Returns the times from the reaction to the collision and from the obstacle to the reaction
        [s]; None if it would collide too soon.
        """
        message, began = self._send(goal)
        motion = to_trajectory(message)
        place = motion.positions[min(int(share * motion.n_steps), motion.n_steps - 1)]
        hand = self._robot.frame_positions(place[None], [self._robot.frame_names[-1]])[0, 0]
        world = World([Obstacle("ball", Sphere(RADIUS, hand))])
        model = CollisionModel(self._robot, world=world, margin=MARGIN, self_collision=False)
        first = min(one.first_time for one in model.collisions(motion))
        if first < EARLIEST:
            self._wait_for_rest()
            return None
        self._spin_until(began + APPEARS * first)
        n = len(self._client.trajectories)
        self._publish(hand)
        appeared = time.time()
        self._client.wait(lambda: len(self._client.trajectories) > n, TIMEOUT, "no reaction")
        took = time.time() - appeared
        self._spin_until(began + first + 0.5)
        self._publish(None)
        self._wait_for_rest()
        return began + first - appeared - took, took

    def _wait_for_rest(self) -> None:
        """Wait until the robot rests, at its goal or where it was stopped."""
        before = np.full(len(JOINTS), np.inf)
        while np.abs(self._bench.position - before).max() > 1e-4:
            before = self._bench.position
            self._spin_until(time.time() + 0.5)

    def _send(self, goal: np.ndarray) -> tuple[JointTrajectory, float]:
        """Send a goal until it is served; returns the trajectory and when it begins [s]."""
        deadline = time.time() + TIMEOUT
        while time.time() < deadline:
            sent = time.time()
            answer = self._bench.send(goal)
            if answer.trajectory is not None:
                while 0.0 < (began := self._newest_stamp()) < sent:
                    self._client.spin_once()  # that of an earlier goal may come first
                return self._client.trajectories[-1], began or time.time()
        raise PlannerError(f"no goal was served: {answer.report.message}")

    def _newest_stamp(self) -> float:
        """When the newest motion begins [s]; 0 if it begins now."""
        return to_seconds(self._client.trajectories[-1].header.stamp)

    def _publish(self, centre: np.ndarray | None) -> None:
        one = Marker(ns="ball", type=Marker.SPHERE)
        one.scale.x = one.scale.y = one.scale.z = 2.0 * RADIUS
        if centre is None:
            one.action = Marker.DELETE
        else:
            place = one.pose.position
            place.x, place.y, place.z = map(float, centre)
        self._obstacles.publish(MarkerArray(markers=[one]))

    def _spin_until(self, end: float) -> None:
        while time.time() < end:
            self._client.spin_once(0.01)


def _keep_busy(folder: Path, is_ready: Event) -> None:
    with NodeClient("busy") as client:
        client.wait_for_node(TIMEOUT)
        bombs = write_bombs(folder)
        is_ready.set()
        for k in count():
            client.call("reload_primitives", TIMEOUT)
            client.set(naturalness=0.5 + 0.1 * (k % 5))
            bomb = Marker(ns="bomb", id=k % 2, type=Marker.MESH_RESOURCE)
            bomb.mesh_resource = f"file://{bombs[k % len(bombs)]}"
            bomb.scale.x = bomb.scale.y = bomb.scale.z = 1.0
            client.publish_markers(bomb)
            time.sleep(PAUSE)


if __name__ == "__main__":
    sys.exit(main())
