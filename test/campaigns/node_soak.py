# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Soak test of the node: valid, invalid and mixed goals from three processes at once.

Run it as ``python3 -m campaigns.node_soak``; joint states are published at 500 Hz meanwhile. The
script exits with status 1 if a goal gets a wrong answer, a motion is missing, or the memory grows
by 5 MB.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections import Counter
from contextlib import ExitStack
from multiprocessing import Queue
from multiprocessing.synchronize import Event

import numpy as np
from support.nodes import (
    PROCESSES,
    NodeClient,
    arm_node,
    described_client,
    goal_message,
    other_process,
    processor_time,
    publish_states,
    resident_megabytes,
)
from support.tables import options

from mp_pca_planner.recordings.synthetic import generate_motions
from mp_pca_planner.ros.client import NoAnswerError, is_served, this_machine_only

Outcome = tuple[str, str, int]
"""Kind of a goal, its status, and the number of its motions."""

KINDS = ("good", "bad", "mixed")
# A valid goal may be preempted by that of another client.
RIGHT = {("good", "served"), ("good", "overtaken"), ("bad", "refused")}
MOST_MEGABYTES, PATIENCE = 5.0, 5.0


def main() -> int:
    """Run the soak test and print the results."""
    arguments = options(__doc__, goals=21_000, rate=45.0)
    os.environ.update(this_machine_only())
    n, rate = arguments.goals // len(KINDS), arguments.rate / len(KINDS)
    outcomes: Queue[Outcome] = PROCESSES.Queue()
    found, memory = list[Outcome](), list[float]()
    with arm_node("--log-level", "fatal") as (node, _), ExitStack() as others:
        start = generate_motions(1, seed=2)[0].positions[0].tolist()
        others.enter_context(other_process(publish_states, 500.0, start))
        with described_client():
            pass
        for number in range(len(KINDS)):
            others.enter_context(other_process(send_goals, number, n, rate, outcomes))
        began, before = time.monotonic(), processor_time(node)
        while len(found) < n * len(KINDS):
            found.append(outcomes.get(timeout=60.0))
            if len(found) % (n // 33) == 0:
                memory.append(resident_megabytes(node)[0])
        took = time.monotonic() - began
        share = (processor_time(node) - before) / took
    print(f"{len(found)} goals in {took:.0f} s; the node took {share:.0%} of one core")
    return report(found, memory)


def send_goals(
    number: int, n_goals: int, rate: float, outcomes: Queue[Outcome], is_ready: Event
) -> None:
    """Send goals of one kind one after the other."""
    random = np.random.default_rng(number)
    ends = [motion.positions[-1] for motion in generate_motions(100, seed=3)]
    kinds = itertools.cycle(("good", "bad") if KINDS[number] == "mixed" else (KINDS[number],))
    with NodeClient(f"client_{number}") as client:
        client.wait_for_node(60.0)
        is_ready.set()
        due = time.monotonic()
        for k, kind in zip(range(n_goals), kinds, strict=False):
            positions = ends[random.integers(len(ends))] + random.uniform(-1e-3, 1e-3, 4)
            if kind == "bad":
                positions[random.integers(4)] = random.choice([np.nan, np.inf, 100.0])
            due = max(due + random.uniform(0.0, 2.0) / rate, time.monotonic() - 1.0 / rate)
            while time.monotonic() < due:
                client.spin_once(max(due - time.monotonic(), 0.0))
            outcomes.put((kind, *send(client, positions.tolist(), number + 1, k)))


def send(client: NodeClient, positions: list[float], second: int, number: int) -> tuple[str, int]:
    """Send a goal with this stamp; its status, and the number of its motions."""
    goal = goal_message(positions)
    goal.header.stamp.sec, goal.header.stamp.nanosec = second, number
    client.reports.clear()
    client.trajectories.clear()

    def n_motions() -> int:
        ends = (list(motion.points[-1].positions) for motion in client.trajectories)
        return sum(end == positions for end in ends)

    try:
        answer = client.send(goal, PATIENCE)
        if not is_served(answer.report):
            return answer.values["status"], 0
        client.wait(lambda: n_motions() > 0, PATIENCE, "sent no motion")
    except NoAnswerError:
        return "unanswered", 0
    return "served", n_motions()


def report(found: list[Outcome], memory: list[float]) -> int:
    """Print counts and memory; returns the exit status."""
    counts = Counter(pair[:2] for pair in found)
    for (kind, status), n in sorted(counts.items()):
        print(f"{kind:5} {status:11} {n:6}" + " wrong" * ((kind, status) not in RIGHT))
    missed = sum(n != 1 for _, status, n in found if status == "served")
    print(f"{missed} served goals without exactly one motion")
    growth = max(memory[10:]) - memory[10]
    print(f"memory after a tenth of the goals {memory[10]:.1f} MB, at most {growth:.1f} MB more")
    return int(bool(counts.keys() - RIGHT or missed) or growth > MOST_MEGABYTES)


if __name__ == "__main__":
    sys.exit(main())
