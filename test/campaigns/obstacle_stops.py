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

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

import numpy as np
from campaigns.stop_latency import BOMBS, primitive_folder, running
from node import LIMITS, simulated_robot
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from support.node_setup import PROCESSES, URDF, RobotClient, silent_node, start_node
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot
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


def main() -> int:
    """Run the trials, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--primitives", type=int, default=300, help="primitives that are reloaded")
    parser.add_argument("--quiet", action="store_true", help="without the other process")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    n = arguments.trials
    ends = [motion.positions[-1] for motion in generate_motions(2 * n + 10, seed=2)]
    given = [f"limits.{j}.{key}:={value}" for j in JOINT_NAMES for key, value in LIMITS.items()]
    given += [f"duration:={DURATION}", f"obstacle_margin:={MARGIN}"]
    words = [word for one in given for word in ("-p", one)]
    reserves, times, n_read = list[float](), list[float](), 0
    with tempfile.TemporaryDirectory() as name, RobotClient() as client:
        folder, log = Path(name), Path(name) / "log.txt"
        library = primitive_folder(folder, arguments.primitives)
        with (
            log.open("w") as output,
            running(start_node("-p", f"primitives:=['{library}']", *words, output=output)),
            simulated_robot(ends[0]),
        ):
            user = User(client)
            with nullcontext() if arguments.quiet else busy(folder):
                for k, end in enumerate(ends[1:]):
                    if len(reserves) == n:
                        break
                    found = user.trial(end, share=(0.7, 1.0)[k % 2])
                    if found is None:
                        continue
                    reserve, took = found
                    reserves.append(reserve)
                    times.append(took)
                    text = f"{took:.3f} s after the obstacle, {reserve:.3f} s before the collision"
                    print(f"trial {len(reserves)}: {text}", flush=True)
                    words = log.read_text(errors="replace")
                    if reserve < GOAL:
                        print(words[n_read:])
                    n_read = len(words)
    late = int((np.array(reserves) < GOAL).sum())
    print(f"{n} obstacles on the path of running motions, {late} reactions later than {GOAL:g} s")
    print(
        f"  reaction to collision: median {np.median(reserves):.2f} s, least {min(reserves):.3f} s"
    )
    print(f"  obstacle to reaction: median {np.median(times):.3f} s, longest {max(times):.3f} s")
    return int(late > 0)


class User:
    """Sends goals and obstacles, and measures when trajectories come."""

    def __init__(self, client: RobotClient) -> None:
        self._client = client
        self._robot = Robot.from_file(URDF, JOINT_NAMES)
        topic = f"{client.planner}/obstacles"
        self._obstacles = client.node.create_publisher(MarkerArray, topic, EVERY)
        self._state = np.zeros(len(JOINT_NAMES))
        client.node.create_subscription(JointState, "joint_states", self._on_state, 10)
        self._stamp = 0
        client.wait_for_node(TIMEOUT)
        client.wait_for_model()
        client.wait(lambda: self._obstacles.get_subscription_count() > 0, TIMEOUT, "not met")

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
        reserve = began + first - appeared - took
        self._spin_until(began + first + 0.5)
        self._publish(None)
        self._wait_for_rest()
        return reserve, took

    def _wait_for_rest(self) -> None:
        """Wait until the robot rests, at its goal or where it was stopped."""
        before = np.full_like(self._state, np.inf)
        while np.abs(self._state - before).max() > 1e-4:
            before = self._state
            self._spin_until(time.time() + 0.5)

    def _send(self, goal: np.ndarray) -> tuple[JointTrajectory, float]:
        """Send a goal until it is served; returns the trajectory and when it begins [s]."""
        deadline = time.time() + TIMEOUT
        while time.time() < deadline:
            self._stamp += 1
            message = JointState(name=JOINT_NAMES, position=goal.tolist())
            message.header.stamp.sec = self._stamp
            sent = time.time()
            answer = self._client.send(message, TIMEOUT)
            if answer.trajectory is not None:
                # That of an earlier goal may come first.
                self._client.wait(partial(self._began_after, sent), TIMEOUT, "no motion")
                newest = self._client.trajectories[-1]
                return newest, to_seconds(newest.header.stamp) or time.time()
        raise PlannerError(f"no goal was served: {answer.report.message}")

    def _began_after(self, sent: float) -> bool:
        """Whether the newest motion begins after a time [s]; without a stamp, it begins now."""
        return not 0.0 < to_seconds(self._client.trajectories[-1].header.stamp) < sent

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

    def _on_state(self, message: JointState) -> None:
        self._state = np.array(message.position[: len(JOINT_NAMES)])


@contextmanager
def busy(folder: Path) -> Iterator[None]:
    """A process that keeps the node busy."""
    for name, text in BOMBS.items():
        (folder / name).write_text(text, encoding="utf-8")
    process = PROCESSES.Process(target=_keep_busy, args=[folder], daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _keep_busy(folder: Path) -> None:
    with silent_node("busy") as node:
        there = "mp_pca_planner"
        obstacles = node.create_publisher(MarkerArray, f"{there}/obstacles", 10)
        reload = node.create_client(Trigger, f"{there}/reload_primitives")
        change = node.create_client(SetParameters, f"{there}/set_parameters")
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        for k in range(10**9):
            executor.spin_until_future_complete(reload.call_async(Trigger.Request()), TIMEOUT)
            value = Parameter("naturalness", value=0.5 + 0.1 * (k % 5)).to_parameter_msg()
            request = SetParameters.Request(parameters=[value])
            executor.spin_until_future_complete(change.call_async(request), TIMEOUT)
            bomb = Marker(ns="bomb", id=k % 2, type=Marker.MESH_RESOURCE)
            bomb.mesh_resource = f"file://{folder / list(BOMBS)[k % len(BOMBS)]}"
            bomb.scale.x = bomb.scale.y = bomb.scale.z = 1.0
            obstacles.publish(MarkerArray(markers=[bomb]))


if __name__ == "__main__":
    sys.exit(main())
