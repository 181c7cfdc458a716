# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Latency of the node among obstacles, over real topics.

Printed are the times from a goal to its trajectory with 20 obstacles, self-collision and limits of
velocity, acceleration, jerk and effort, and from an obstacle on the path of a running motion to the
trajectory that replaces it. The robot is the arm of ``config/human_arm.urdf``, simulated::

    python benchmarks/obstacle_latency.py [--goals 100] [--obstacles 20]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from sensor_msgs.msg import JointState
from support.node_setup import URDF, running_node
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.ros.client import Answer, GoalClient, this_machine_only
from mp_pca_planner.ros.nodes import LATCHED

RADIUS = 0.03
LIMITS = {"max_velocity": 3.0, "max_acceleration": 12.0, "max_jerk": 240.0, "max_effort": 60.0}
DURATION = 3.0  # of the motions that are interrupted [s]
TIMEOUT = 20.0


def main() -> None:
    """Run the measurements and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", type=int, default=100, help="number of each kind")
    parser.add_argument("--obstacles", type=int, default=20, help="number beside the motions")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    ends = [motion.positions[-1] for motion in generate_motions(arguments.goals + 1, seed=2)]
    with user_among(arguments.obstacles, ends[0]) as user:
        goals = [user.goal(end) for end in ends[1:]]
    found = [latency for latency in goals if latency is not None]
    print(f"{len(goals)} goals among {arguments.obstacles} obstacles, {len(found)} motions")
    print_times("goal to trajectory", found)
    with user_among(arguments.obstacles, ends[0], "-p", f"duration:={DURATION}") as user:
        reactions = [one for one in map(user.interrupt, ends[1:]) if one is not None]
    print(f"{len(reactions)} obstacles on the path of running motions")
    for name, kind in (("detour", True), ("stop", False)):
        own = [latency for latency, leads_around in reactions if leads_around == kind]
        print_times(f"obstacle to {name} ({len(own)})", own)


@contextmanager
def user_among(n_obstacles: int, start: np.ndarray, *words: str) -> Iterator[User]:
    """The user of a node and a simulated robot that stands among obstacles."""
    limits = [f"limits.{j}.{key}:={value}" for j in JOINT_NAMES for key, value in LIMITS.items()]
    given = [word for one in ("collision:=true", *limits) for word in ("-p", one)]
    with running_node(*given, *words), simulated_robot(start), GoalClient() as client:
        client.wait_for_node()
        client.wait_for_diagnostics(lambda values: values["model"] != "none")
        user = User(client)
        user.surround(n_obstacles)
        yield user


class User:
    """Sends goals and obstacles, and measures when trajectories come."""

    def __init__(self, client: GoalClient) -> None:
        self._client, self._robot = client, Robot.from_file(URDF, JOINT_NAMES)
        topic = f"{client.planner}/obstacles"
        self._obstacles = client.node.create_publisher(MarkerArray, topic, LATCHED)
        client.wait(lambda: self._obstacles.get_subscription_count() > 0, TIMEOUT, "not met")
        self._stamp = 0

    def surround(self, n: int) -> None:
        """Place boxes around the robot, away from its motions."""
        angles = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        markers = []
        for k, angle in enumerate(angles):
            one = Marker(ns="far", id=k, type=Marker.CUBE)
            one.scale.x, one.scale.y, one.scale.z = 0.2, 0.2, 1.0
            one.pose.position.x, one.pose.position.y = np.cos(angle), np.sin(angle)
            markers.append(one)
        self._obstacles.publish(MarkerArray(markers=markers))
        self._client.wait_for_diagnostics(lambda values: values["obstacles"] == str(n), TIMEOUT)

    def goal(self, positions: np.ndarray) -> float | None:
        """Latency of a goal from rest [s]; None if it was refused."""
        answer = self._send(positions)
        if answer.trajectory is None:
            return None
        self._wait_for_arrival(answer.trajectory)
        return answer.latency

    def interrupt(self, positions: np.ndarray) -> tuple[float, bool] | None:
        """Put an obstacle on the path of a motion.

        Returns the latency of the next trajectory [s] and whether it leads around; None if the goal
        was refused.
        """
        answer = self._send(positions)
        if answer.trajectory is None:
            return None
        path = np.array([point.positions for point in answer.trajectory.points])
        hand = self._robot.frame_positions(path, [self._robot.frame_names[-1]])[:, 0]
        one = Marker(ns="path", id=1, type=Marker.SPHERE)
        one.scale.x = one.scale.y = one.scale.z = 2.0 * RADIUS
        place = one.pose.position
        place.x, place.y, place.z = map(float, hand[int(0.6 * len(hand))])
        # A robot that has hardly moved does not show yet whether it follows the motion.
        time.sleep(0.25 * DURATION)
        n, sent = len(self._client.trajectories), time.monotonic()
        self._obstacles.publish(MarkerArray(markers=[one]))
        self._client.wait(lambda: len(self._client.trajectories) > n, TIMEOUT, "no trajectory")
        latency, new = time.monotonic() - sent, self._client.trajectories[-1]
        leads_around = np.allclose(new.points[-1].positions, positions, atol=1e-3)
        self._wait_for_arrival(new)
        self._obstacles.publish(MarkerArray(markers=[Marker(ns="path", id=1, action=2)]))
        time.sleep(0.1)
        return latency, leads_around

    def _send(self, positions: np.ndarray) -> Answer:
        self._stamp += 1
        goal = JointState(name=JOINT_NAMES, position=positions.tolist())
        goal.header.stamp.sec = self._stamp
        return self._client.send(goal, TIMEOUT)

    def _wait_for_arrival(self, trajectory: JointTrajectory) -> None:
        last = trajectory.points[-1].time_from_start
        time.sleep(last.sec + 1e-9 * last.nanosec + 0.3)


@contextmanager
def simulated_robot(start: np.ndarray) -> Iterator[None]:
    """A simulated robot in a process of its own."""
    command = [sys.executable, "-m", "mp_pca_planner", "simulate", "--robot", str(URDF)]
    command += ["--joints", ",".join(JOINT_NAMES), "--start", ",".join(map(str, start))]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as robot:
        try:
            yield
        finally:
            robot.terminate()


def print_times(name: str, seconds: list[float]) -> None:
    """Median, 90 % and the longest of some times."""
    if seconds:
        times = 1e3 * np.array(seconds)
        median, most = np.median(times), np.quantile(times, 0.9)
        print(f"  {name}: median {median:.0f} ms, 90 % {most:.0f} ms, longest {times.max():.0f} ms")


if __name__ == "__main__":
    main()
