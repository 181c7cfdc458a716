# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node whose planner dies, hangs or takes all memory, and the node that gets signals.

    python3 -m campaigns.node_kills planner [--number 13] [--seed 0]
    python3 -m campaigns.node_kills exits [--number 100]

planner: the process that plans gets a SIGKILL or a SIGSEGV, takes 20 GB, or loops for ever, while
it is set up, plans, idles, and while a simulated robot moves. ``~/stop`` is called after each fault
or before its goal is reported, and answers in 0.1 s. Each goal gets exactly one report. The next
one is served 5 s after the fault; after an endless set-up, for which the node waits for 60 s, 5 s
later. On a busy machine, a planner takes longer to start.
exits: the node is started, serves a goal, and is ended by signals, the second one at a random
moment of the shutdown. It exits with 0 and without a traceback; after a SIGKILL, the next start
succeeds.

The script exits with 1 otherwise.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import count, product
from pathlib import Path
from subprocess import Popen

import numpy as np
from support.arm import JOINTS, URDF, arm_primitive
from support.commands import with_folder
from support.nodes import (
    GOAL,
    START,
    NodeClient,
    arm_node,
    described_client,
    goal_message,
    planner_of,
    simulated_robot,
    start_node,
    times,
    words,
)
from support.tables import options

from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.client import (
    NoAnswerError,
    is_served,
    report_values,
    this_machine_only,
)

Random = np.random.Generator
PATIENCE = 120.0
STOP_TIME, SERVED_TIME = 0.1, 5.0  # longest time of an answer, and to a served goal [s]
PHASES, SET_UP_TIME = ("set-up", "planning", "idle", "moving"), 60.0  # wait of the node [s]
LOOP = "endless loop"
FAULTS = {
    "SIGKILL": signal.SIGKILL,
    "SIGSEGV": signal.SIGSEGV,
    "20 GB": signal.SIGUSR1,
    LOOP: signal.SIGUSR2,
}
# Python imports this at its start: the node's processes have two faults, each behind a signal.
CUSTOM = """
import signal
def loop(*_):
    while True:
        pass
signal.signal(signal.SIGUSR1, lambda *_: bytearray(20 << 30))
signal.signal(signal.SIGUSR2, loop)
"""


def planner(number: int, random: Random) -> list[str]:
    """Rounds of each fault of the planner in each phase."""
    problems, found = list[str](), dict[tuple[str, str], list[tuple[float, float]]]()
    with tempfile.TemporaryDirectory() as name:
        Path(name, "sitecustomize.py").write_text(CUSTOM, encoding="utf-8")
        os.environ["PYTHONPATH"] = with_folder(Path(name))
        with (
            arm_node("--log-level", "fatal", may_trace=True) as (node, folder),
            simulated_robot(folder / "robot.txt", START),
            described_client() as client,
        ):
            user = User(client, node, random)
            for k, fault, phase in product(range(number), FAULTS, PHASES):
                try:
                    took = user.trial(fault, phase)
                except AssertionError as problem:
                    problems.append(f"round {k}, {fault}, {phase}: {problem}")
                    print(problems[-1], file=sys.stderr, flush=True)
                else:
                    found.setdefault((fault, phase), []).append(took)
    for (fault, phase), seconds in found.items():
        stop, served = np.max(seconds, axis=0)
        print(f"{fault:12} {phase:8} ~/stop {1e3 * stop:.1f} ms, next goal {served:.1f} s")
    return problems


class User:
    """Sends goals and faults, and looks at the reports."""

    def __init__(self, client: NodeClient, node: Popen[str], random: Random) -> None:
        self._client, self._node, self._random = client, node, random
        self._stamps = count(1)

    def trial(self, fault: str, phase: str) -> tuple[float, float]:
        """Times of ``~/stop`` and from the fault to a goal that is served [s]."""
        self._serve(START)
        process, goal = planner_of(self._node), 0
        if phase == "moving":
            self._serve(GOAL, is_awaited=False)
        elif phase == "planning":
            goal = self._publish(GOAL)
        elif phase == "set-up":
            self._client.try_to_set({"naturalness": self._random.uniform()})
        time.sleep(self._random.uniform(0.0, 0.02))
        began = time.monotonic()
        os.kill(process, FAULTS[fault])
        if goal and self._random.random() < 0.5:
            self._status(goal)
        called = time.monotonic()
        assert self._client.call("stop", PATIENCE).success
        stopped = time.monotonic() - called
        if goal:
            self._status(goal)
        served = self._serve(GOAL) - began
        assert self._node.poll() is None, "the node ended"
        assert not goal or len(self._reports(goal)) == 1, "a goal has several reports"
        assert stopped <= STOP_TIME, f"~/stop took {stopped:.3f} s"
        most = SERVED_TIME + SET_UP_TIME * (fault == LOOP and phase == "set-up")
        assert served <= most, f"a goal was served only {served:.1f} s after the fault"
        return stopped, served

    def _publish(self, positions: list[float]) -> int:
        goal = goal_message(positions)
        goal.header.stamp.sec = next(self._stamps)
        self._client.publish_goal(goal)
        return int(goal.header.stamp.sec)

    def _reports(self, stamp: int) -> list[dict[str, str]]:
        values = map(report_values, self._client.reports)
        return [one for one in values if int(float(one["goal_stamp"])) == stamp]

    def _status(self, stamp: int) -> str:
        """The reported status of a goal."""
        self._client.wait(lambda: bool(self._reports(stamp)), PATIENCE, "did not report")
        return self._reports(stamp)[0]["status"]

    def _serve(self, positions: list[float], *, is_awaited: bool = True) -> float:
        """Send goals until one is served; returns when that was [s], once the robot is there."""
        deadline = time.monotonic() + PATIENCE
        while (status := self._status(self._publish(positions))) == "refused":
            assert time.monotonic() < deadline, "no goal is served"
            time.sleep(0.05)
        served = time.monotonic()
        if not is_awaited:
            time.sleep(0.2)
        elif status != "under_way":
            time.sleep(1e-9 * times(self._client.trajectories[-1])[-1] + 0.3)
        return served


ENDS = {
    "SIGINT": [signal.SIGINT],
    "SIGTERM": [signal.SIGTERM],
    "SIGINT twice": [signal.SIGINT, signal.SIGINT],
    "SIGTERM often": [signal.SIGTERM] * 10,
    "SIGKILL": [signal.SIGKILL],
}
LONGEST_PAUSE = 0.3  # between two signals [s]; the node is usually still running after it


def exits(number: int, random: Random) -> list[str]:
    """Start and end the node; print the times until a first goal is served."""

    def serve(client: NodeClient, patience: float = 0.05) -> None:
        """Send a goal again and again, as a client that waits for the node."""
        while True:
            goal.header.stamp.sec += 1  # the report of the previous node is another one
            client.publish_state(JOINTS, START)
            try:
                if is_served(client.send(goal, patience, with_trajectory=False).report):
                    return
            except NoAnswerError:
                patience *= 1.1  # a busy machine may need more time

    problems, goal = list[str](), goal_message()
    with tempfile.TemporaryDirectory() as name, NodeClient() as client:
        log = Path(name, "log.txt")
        save_primitive(arm_primitive(), Path(name, "arm.npz"))
        client.publish_description(URDF)
        for end, signals in ENDS.items():
            served = []
            for _ in range(number):
                began = time.monotonic()
                with log.open("w") as output:
                    given = words(primitives=f"['{name}/arm.npz']")
                    process = start_node(*given, output=output)
                serve(client)
                served.append(time.monotonic() - began)
                for k, signal_number in enumerate(signals):
                    time.sleep(random.uniform(0.0, LONGEST_PAUSE / len(signals)) if k else 0.0)
                    process.send_signal(signal_number)
                status, said = process.wait(timeout=60.0), log.read_text()
                is_killed = signals == [signal.SIGKILL]
                if status != -signal.SIGKILL * is_killed or "Traceback" in said:
                    problems.append(f"{end}: ended with status {status}:\n{said}")
            median, high = np.percentile(served, (50, 99))
            print(f"{end:13} first goal served after {median:.2f} s (99 % {high:.2f} s)")
    return problems


PARTS: dict[str, tuple[Callable[[int, Random], list[str]], int]] = {
    "planner": (planner, 13),
    "exits": (exits, 100),
}


def main() -> int:
    """Run a part and print its problems."""
    arguments = options(__doc__, part=PARTS, number=0, seed=0)
    os.environ.update(this_machine_only())
    part, number = PARTS[arguments.part]
    problems = part(arguments.number or number, np.random.default_rng(arguments.seed))
    print(*problems, f"{len(problems)} problems", sep="\n")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
