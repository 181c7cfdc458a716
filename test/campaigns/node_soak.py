# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Soak test of the node: valid, invalid and mixed goals from three processes at once.

Run it as ``python3 -m campaigns.node_soak``; joint states are published at 500 Hz meanwhile. The
script exits with status 1 if a goal gets a wrong answer, a motion is missing, or the memory grows
by 5 MB.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing import Queue
from subprocess import Popen
from typing import NamedTuple, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.node_setup import (
    PROCESSES,
    URDF,
    RobotClient,
    joint_states,
    print_latencies,
    processor_time,
    resident_megabytes,
    running_node,
    silent_node,
)
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import is_served, this_machine_only
from mp_pca_planner.ros.messages import to_stamp_text

T = TypeVar("T")

_KINDS = ("good", "bad", "mixed")
_MOST_MEGABYTES = 5.0
_PATIENCE = 5.0


class Outcome(NamedTuple):
    """Outcome of a goal; times in seconds, 0 where there are none."""

    kind: str
    status: str
    n_trajectories: int = 0
    to_trajectory: float = 0.0
    solve_time: float = 0.0


def main() -> int:
    """Run the soak test and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=21_000, help="number of goals")
    parser.add_argument("--rate", type=float, default=75.0, help="goals per second of all clients")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    start = generate_motions(1, seed=2)[0].positions[0].tolist()
    n_goals = arguments.goals // len(_KINDS)
    outcomes: Queue[Outcome] = PROCESSES.Queue()
    with running_node("--log-level", "fatal") as node, joint_states(500.0, start):
        with RobotClient("monitor") as monitor:
            monitor.publish("robot_description", String(data=URDF.read_text(encoding="utf-8")))
            monitor.wait_for_model()
        clients = [
            PROCESSES.Process(
                target=send_goals,
                args=(number, n_goals, arguments.rate / len(_KINDS), outcomes),
                daemon=True,
            )
            for number in range(len(_KINDS))
        ]
        for client in clients:
            client.start()
        began, before = time.monotonic(), processor_time(node)
        found, memory = watch(node, outcomes, n_goals * len(_KINDS))
        took = time.monotonic() - began
        assert node.poll() is None, "the node died"
        share = (processor_time(node) - before) / took
        print(f"{len(found)} goals in {took:.0f} s, load of the machine {os.getloadavg()[0]:.1f}")
        print(f"the node took {share:.0%} of one core")
        return report(found, memory)


def watch(
    node: Popen[str], outcomes: Queue[Outcome], n_goals: int
) -> tuple[list[Outcome], list[float]]:
    """Collect outcomes, and the memory at each hundredth of the goals [MB]."""
    found: list[Outcome] = []
    memory: list[float] = []
    while len(found) < n_goals:
        found.append(outcomes.get(timeout=60.0))
        if len(found) % (n_goals // 100) == 0:
            memory.append(resident_megabytes(node)[0])
    return found, memory


def send_goals(number: int, n_goals: int, rate: float, outcomes: Queue[Outcome]) -> None:
    """Send goals of one kind one after the other, in a separate process."""
    random = np.random.default_rng(number)
    ends = [motion.positions[-1] for motion in generate_motions(100, seed=3)]
    kinds = itertools.cycle(("good", "bad") if _KINDS[number] == "mixed" else (_KINDS[number],))
    with silent_node(f"client_{number}") as node:
        client = SoakClient(node)
        due = time.monotonic()
        for k, kind in zip(range(n_goals), kinds, strict=False):
            # A unique stamp identifies the trajectory.
            positions = ends[random.integers(len(ends))] + random.uniform(-1e-3, 1e-3, 4)
            if kind == "bad":
                positions[random.integers(4)] = random.choice([np.nan, np.inf, 100.0])
            due = max(due + random.uniform(0.0, 2.0) / rate, time.monotonic() - 1.0 / rate)
            time.sleep(max(due - time.monotonic(), 0.0))
            outcomes.put(client.send(kind, positions, number + 1, k))


class SoakClient:
    """A client with little CPU load: messages stay serialised."""

    def __init__(self, node: Node) -> None:
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._reports: list[bytes] = []
        self._trajectories: list[tuple[bytes, float]] = []
        there = "mp_pca_planner"
        self._goals = node.create_publisher(JointState, f"{there}/goal", 1)
        node.create_subscription(
            DiagnosticStatus, f"{there}/plan_report", self._reports.append, 1000, raw=True
        )
        node.create_subscription(
            JointTrajectory, f"{there}/joint_trajectory", self._on_trajectory, 1000, raw=True
        )
        while not (self._goals.get_subscription_count() and self._publishers(node, there)):
            self._executor.spin_once(timeout_sec=0.05)

    @staticmethod
    def _publishers(node: Node, there: str) -> bool:
        topics = (f"{there}/plan_report", f"{there}/joint_trajectory")
        return all(node.count_publishers(topic) for topic in topics)

    def _on_trajectory(self, message: bytes, facts: dict[str, int]) -> None:
        self._trajectories.append((message, facts["received_timestamp"] * 1e-9))

    def send(self, kind: str, positions: np.ndarray, second: int, number: int) -> Outcome:
        """Send a goal with this stamp, and wait for its outcome."""
        goal = JointState(name=JOINT_NAMES, position=positions.tolist())
        goal.header.stamp.sec, goal.header.stamp.nanosec = second, number
        stamp, end = to_stamp_text(goal.header.stamp).encode(), positions.tobytes()
        self._reports.clear()
        self._trajectories.clear()
        sent = time.time()
        self._goals.publish(goal)
        raw = self._first(lambda: (r for r in self._reports if stamp in r))
        if raw is None:
            return Outcome(kind, "unanswered")
        found = deserialize_message(raw, DiagnosticStatus)
        values = {pair.key: pair.value for pair in found.values}
        if not is_served(found):
            return Outcome(kind, values["status"])
        self._first(lambda: (True for message, _ in self._trajectories if end in message))
        received = [when for message, when in self._trajectories if end in message]
        after = received[0] - sent if received else float("nan")
        return Outcome(kind, "served", len(received), after, float(values["solve_time_s"]))

    def _first(self, candidates: Callable[[], Iterator[T]]) -> T | None:
        """Wait for the first of these conditions."""
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            for one in candidates():
                return one
            self._executor.spin_once(timeout_sec=_PATIENCE)
        return None


def report(found: list[Outcome], memory: list[float]) -> int:
    """Print counts, latencies and memory; returns the exit status."""
    counts = Counter((one.kind, one.status) for one in found)
    for (kind, status), n in sorted(counts.items()):
        print(f"{kind:5} {status:11} {n:6}")
    served = [one for one in found if one.status == "served"]
    missed = sum(one.n_trajectories != 1 for one in served)
    print(f"{missed} of {len(served)} served goals without exactly one trajectory")
    print_latencies(
        np.array([one.to_trajectory for one in served]),
        np.array([one.solve_time for one in served]),
    )
    growth = max(memory[10:]) - memory[10]
    print(f"memory after a tenth of the goals {memory[10]:.1f} MB, at most {growth:.1f} MB more")
    # A valid goal may be preempted by that of another client.
    wrong = counts.keys() - {("good", "served"), ("good", "overtaken"), ("bad", "refused")}
    for pair in wrong:
        print(f"wrong: {pair}")
    return int(bool(wrong or missed) or growth > _MOST_MEGABYTES)


if __name__ == "__main__":
    sys.exit(main())
