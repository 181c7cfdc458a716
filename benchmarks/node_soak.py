# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Soak test of the node: good, bad and mixed goals from three processes at once.

Run it as ``python benchmarks/node_soak.py``; joint states come at 500 Hz meanwhile. It ends with
status 1 if a goal got a wrong answer, a motion is missing, or the memory grew by 5 MB.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from multiprocessing import Queue
from subprocess import Popen

import numpy as np
from node_setup import (
    PROCESSES,
    URDF,
    joint_states,
    resident_megabytes,
    running_node,
)
from sensor_msgs.msg import JointState

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import GoalClient, NoAnswerError, is_served, this_machine_only

_KINDS = ("good", "bad", "mixed")
_MOST_MEGABYTES = 5.0
# A goal that another client's took the place of in the middleware gets no report.
_PATIENCE = 1.0
# The monitor takes longer than the node to go through its messages [s].
_LONGEST_LAG = 20.0


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=21_000, help="number of goals")
    n_goals = parser.parse_args().goals // len(_KINDS)
    os.environ.update(this_machine_only())
    start = generate_motions(1, seed=2)[0].positions[0].tolist()
    answers: Queue[tuple[str, str, float, float]] = PROCESSES.Queue()
    with (
        running_node("--log-level", "fatal") as node,
        GoalClient("monitor") as monitor,
        joint_states(500.0, start),
    ):
        monitor.publish_description(URDF.read_text(encoding="utf-8"))
        monitor.wait_for_model()
        clients = [
            PROCESSES.Process(target=send_goals, args=(number, n_goals, answers), daemon=True)
            for number in range(len(_KINDS))
        ]
        for client in clients:
            client.start()
        found, memory = watch(monitor, node, answers, n_goals * len(_KINDS))
        n_served = int(monitor.wait_for_diagnostics()["goals_served"])
        deadline = time.monotonic() + _LONGEST_LAG
        while len(monitor.trajectories) < n_served and time.monotonic() < deadline:
            monitor.spin_once()
        assert node.poll() is None, "the node died"
        return report(found, memory, len(monitor.trajectories))


def watch(
    monitor: GoalClient, node: Popen[str], answers: Queue, n_goals: int
) -> tuple[list[tuple[str, str, float, float]], list[float]]:
    """Collect answers, and the memory at each hundredth of the goals [MB]."""
    found: list[tuple[str, str, float, float]] = []
    memory: list[float] = []
    while len(found) < n_goals:
        monitor.spin_once()
        while not answers.empty():
            found.append(answers.get())
            if len(found) % (n_goals // 100) == 0:
                memory.append(resident_megabytes(node))
    return found, memory


def send_goals(number: int, n_goals: int, answers: Queue) -> None:
    """Send goals of a kind one after the other: in a process of its own."""
    random = np.random.default_rng(number)
    goals = [motion.positions[-1].tolist() for motion in generate_motions(100, seed=3)]
    kinds = itertools.cycle(("good", "bad") if _KINDS[number] == "mixed" else (_KINDS[number],))
    with GoalClient(f"client_{number}") as client:
        client.wait_for_node()
        for k, kind in zip(range(n_goals), kinds, strict=False):
            positions = list(goals[random.integers(len(goals))])
            if kind == "bad":
                positions[random.integers(4)] = random.choice([np.nan, np.inf, 100.0])
            goal = JointState(name=JOINT_NAMES, position=positions)
            goal.header.stamp.sec, goal.header.stamp.nanosec = number + 1, k
            sent = time.perf_counter()
            try:
                answer = client.send(goal, _PATIENCE, with_trajectory=False)
            except NoAnswerError:
                answers.put((kind, "unanswered", 0.0, 0.0))
                continue
            status = answer.values["status"]
            if is_served(answer.report):
                status = "served"
            solve_time = float(answer.values.get("solve_time_s", 0.0))
            answers.put((kind, status, time.perf_counter() - sent, solve_time))
            client.reports.clear()
            client.trajectories.clear()


def report(
    found: list[tuple[str, str, float, float]], memory: list[float], n_trajectories: int
) -> int:
    """Print counts, latencies and memory; returns the exit status."""
    counts = {
        (kind, status): sum(answer[:2] == (kind, status) for answer in found)
        for kind, status in sorted({answer[:2] for answer in found})
    }
    for (kind, status), n in counts.items():
        print(f"{kind:5} {status:11} {n:6}")
    served = np.array([answer[2:] for answer in found if answer[1] == "served"]) * 1e3
    for name, values in (("goal to report", served[:, 0]), ("solve time", served[:, 1])):
        median, high = np.percentile(values, (50, 99))
        print(f"{name:15} median {median:6.2f} ms   99th percentile {high:6.2f} ms")
    growth = max(memory[10:]) - memory[10]
    print(f"memory after a tenth of the goals {memory[10]:.1f} MB, at most {growth:.1f} MB more")
    print(f"{n_trajectories} trajectories for {len(served)} served goals")
    allowed = {("good", "served"), ("bad", "refused")}
    given_up = ("overtaken", "unanswered")
    wrong = {pair for pair in counts if pair not in allowed and pair[1] not in given_up}
    for pair in wrong:
        print(f"wrong: {pair}")
    return int(bool(wrong) or n_trajectories < len(served) or growth > _MOST_MEGABYTES)


if __name__ == "__main__":
    sys.exit(main())
