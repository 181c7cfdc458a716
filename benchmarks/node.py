#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Latencies of the node over real topics: goals and stops.

    python3 benchmarks/node.py [--goals 40] [--motions 15] [--obstacles 20]

The arm is that of ``config/human_arm.urdf``, the node a process of its own, without other robots.
A goal's latency ends when the client's middleware has its trajectory. "Among obstacles" there are
boxes around the robot, self-collision is checked, and velocity, acceleration, jerk and effort are
limited. Then motions of 3 s are stopped by a call of ``~/stop``. Obstacles on the path of a motion:
``python3 -m campaigns.obstacle_stops``, in `test/`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from subprocess import Popen

import numpy as np
from sensor_msgs.msg import JointState
from support.nodes import (
    Answer,
    NodeClient,
    arm_node,
    described_client,
    other_process,
    processor_time,
    publish_states,
    resident_megabytes,
    simulated_robot,
)
from support.tables import benchmark_parser, show
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import this_machine_only
from mp_pca_planner.ros.nodes import LATCHED

RATES = (20.0, 1000.0)  # of joint states [Hz]
N_ROUNDS = 4
# A robot that never moves: for a moment after a motion, the node waits for it to start.
PAUSE = 0.6
LIMITS = {"max_velocity": 3.0, "max_acceleration": 12.0, "max_jerk": 240.0, "max_effort": 60.0}
DURATION = 3.0  # of the motions that are stopped [s]
TIMEOUT = 20.0

Latencies = dict[str, list[float]]
"""Times [s] by what was measured."""


def main() -> None:
    """Run the measurements and print them."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--goals", type=int, default=40, help="of a robot at rest, of each kind")
    parser.add_argument("--motions", type=int, default=15, help="to be stopped")
    parser.add_argument("--obstacles", type=int, default=20, help="beside the motions")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    n = max(arguments.goals, arguments.motions) + 1
    ends = [motion.positions[-1] for motion in generate_motions(n, seed=2)]
    found, loads = at_rest(ends[: arguments.goals])
    with user_among(arguments.obstacles, ends[0]) as user:
        answers = [user.arrive(end) for end in ends[1 : arguments.goals + 1]]
        what = "the node, Python's resource tracker, the planner and the watcher"
        loads.append(f"resident memory of {what}: {user.memory} MB")
    found["goal to trajectory, among obstacles"] = latencies(answers)
    with user_among(arguments.obstacles, ends[0], duration=DURATION) as user:
        for end in ends[1 : arguments.motions + 1]:
            for what, seconds in user.stop(end):
                found.setdefault(what, []).append(seconds)
    header = ["from … to …", "number", "median [ms]", "90 %", "99 %", "longest"]
    rows = [
        [
            what,
            str(len(times)),
            *(f"{1e3 * x:.1f}" for x in np.quantile(times, (0.5, 0.9, 0.99, 1))),
        ]
        for what, times in found.items()
        if times
    ]
    show({"Latencies of the node": (header, rows)}, as_json=arguments.json, notes=loads)


def latencies(answers: Sequence[Answer]) -> list[float]:
    """Latencies of the goals that were not refused [s]."""
    return [answer.latency for answer in answers if answer.latency is not None]


def at_rest(ends: Sequence[np.ndarray]) -> tuple[Latencies, list[str]]:
    """Latencies of goals by the rate of joint states, and sentences on the load of the node."""
    answers: dict[float, list[Answer]] = {rate: [] for rate in RATES}
    shares: dict[float, list[float]] = {rate: [] for rate in RATES}
    with arm_node() as (node, _), described_client() as client:

        def plan(end: np.ndarray) -> Answer:
            time.sleep(PAUSE)
            return client.send(JointState(name=JOINT_NAMES, position=end.tolist()))

        # Alternating, so that other load of the machine affects both alike.
        for part in range(N_ROUNDS):
            for rate in RATES:
                with other_process(publish_states, rate, ends[-1].tolist()):
                    while plan(ends[0]).trajectory is None:
                        pass  # no state has been received yet
                    shares[rate].append(idle_share(node))
                    answers[rate] += [plan(end) for end in ends[part::N_ROUNDS]]
    found = {
        f"goal to trajectory, joint states at {rate:g} Hz": latencies(answers[rate])
        for rate in RATES
    }
    served = [one for of_rate in answers.values() for one in of_rate if one.trajectory]
    found["of it the optimisation"] = [float(one.values["solve_time_s"]) for one in served]
    return found, [
        f"joint states at {rate:g} Hz: {np.median(shares[rate]):.1%} of one core without goals"
        for rate in RATES
    ]


def idle_share(node: Popen[str], duration: float = 1.25) -> float:
    """CPU load of the node without goals, as a share of one core."""
    before, began = processor_time(node), time.monotonic()
    time.sleep(duration)
    return (processor_time(node) - before) / (time.monotonic() - began)


@contextmanager
def user_among(n_obstacles: int, start: np.ndarray, **others: float) -> Iterator[User]:
    """The user of a node and a simulated robot that stands among obstacles."""
    limits = {f"limits.{j}.{key}": value for j in JOINT_NAMES for key, value in LIMITS.items()}
    with (
        arm_node(collision="true", **limits, **others) as (node, folder),
        simulated_robot(folder / "robot.txt", start),
        NodeClient() as client,
    ):
        client.wait_for_node()
        client.wait_for_model()
        user = User(client, node)
        user.surround(n_obstacles)
        yield user


class User:
    """Sends goals, stops and obstacles, and measures when trajectories come."""

    def __init__(self, client: NodeClient, node: Popen[str]) -> None:
        self._client = client
        self._node = node
        topic = f"{client.planner}/obstacles"
        self._obstacles = client.node.create_publisher(MarkerArray, topic, LATCHED)
        client.wait(lambda: self._obstacles.get_subscription_count() > 0, TIMEOUT, "not met")
        self._stamp = 0

    @property
    def memory(self) -> str:
        """Resident memory of each process of the node [MB]."""
        return ", ".join(f"{megabytes:.0f}" for megabytes in resident_megabytes(self._node))

    def surround(self, n: int) -> None:
        """Place boxes around the robot, away from its motions."""
        markers = []
        for k, angle in enumerate(np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)):
            one = Marker(ns="far", id=k, type=Marker.CUBE)
            one.scale.x, one.scale.y, one.scale.z = 0.2, 0.2, 1.0
            one.pose.position.x, one.pose.position.y = np.cos(angle), np.sin(angle)
            markers.append(one)
        self._obstacles.publish(MarkerArray(markers=markers))
        self._client.wait_for_diagnostics(lambda values: values["obstacles"] == str(n), TIMEOUT)

    def arrive(self, end: np.ndarray) -> Answer:
        """Answer to a goal from rest, after the motion."""
        answer = self._send(end)
        if answer.trajectory is not None:
            wait_for_arrival(answer.trajectory)
        return answer

    def stop(self, end: np.ndarray) -> list[tuple[str, float]]:
        """Stop a motion: the times until the answer and until the trajectory [s]."""
        if self._send(end).trajectory is None:
            return []
        time.sleep(0.25 * DURATION)
        n, called = len(self._client.trajectories), time.monotonic()
        self._client.call("stop")
        answered = time.monotonic() - called
        stopped, trajectory = self._next_trajectory(n, called)
        wait_for_arrival(trajectory)
        return [("call of ~/stop to its answer", answered), ("call of ~/stop to the stop", stopped)]

    def _send(self, end: np.ndarray) -> Answer:
        self._stamp += 1
        goal = JointState(name=JOINT_NAMES, position=end.tolist())
        goal.header.stamp.sec = self._stamp
        return self._client.send(goal, TIMEOUT)

    def _next_trajectory(self, n_before: int, since: float) -> tuple[float, JointTrajectory]:
        trajectories = self._client.trajectories
        self._client.wait(lambda: len(trajectories) > n_before, TIMEOUT, "sent no trajectory")
        return time.monotonic() - since, trajectories[-1]


def wait_for_arrival(trajectory: JointTrajectory) -> None:
    """Wait for the time of a motion, and a moment more."""
    last = trajectory.points[-1].time_from_start
    time.sleep(last.sec + 1e-9 * last.nanosec + 0.3)


if __name__ == "__main__":
    main()
