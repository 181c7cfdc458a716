# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node while its planner dies, hangs or takes all memory, in every phase.

    python3 -m campaigns.planner_kills [--rounds 13] [--only FAULT …] [--seed 0]

A round is each fault in each phase, 16 in all: SIGKILL, SIGSEGV, 20 GB of memory, and an endless
loop, while the planner is set up, plans, idles, and while a simulated robot moves. ``~/stop`` is
called after each fault, or before its goal is reported. Each goal has to get exactly one report,
and the next one has to be served 5 s after the planner has ended: at once if it dies, else when the
node has waited as long as it waits for a set-up (60 s) or a goal (5 s, 2 s after a stop). Printed
are the longest times of ``~/stop`` and until a goal was served. The script exits with 1 if a report
is missing or wrong, or a time is too long.
"""

from __future__ import annotations

import argparse
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
from node import simulated_robot
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.commands import with_folder
from support.node_setup import RobotClient, running_node
from support.nodes import GOAL, START, URDF, planner_of

from mp_pca_planner.recordings.synthetic import JOINT_NAMES
from mp_pca_planner.ros.client import report_values, this_machine_only

STOP_TIME, SERVED_TIME = 0.1, 5.0  # longest time of an answer, and to a served goal [s]
WAITS = {"set-up": 60.0, "planning": 5.5, "idle": 5.5, "moving": 5.5}  # of the node [s]
PATIENCE = 120.0
MEMORY, LOOP = "20 GB", "endless loop"
FAULTS = {
    "SIGKILL": signal.SIGKILL,
    "SIGSEGV": signal.SIGSEGV,
    MEMORY: signal.SIGUSR1,
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


def main() -> int:
    """Run all rounds, print the longest times, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=13)
    parser.add_argument("--only", nargs="+", default=FAULTS, choices=FAULTS, metavar="FAULT")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random = np.random.default_rng(arguments.seed)
    os.environ.update(this_machine_only())
    problems, times = list[str](), dict[tuple[str, str], list[tuple[float, float]]]()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "sitecustomize.py").write_text(CUSTOM, encoding="utf-8")
        os.environ["PYTHONPATH"] = with_folder(Path(folder))
        with (
            running_node("--log-level", "fatal") as node,
            simulated_robot(np.array(START)),
            RobotClient() as client,
        ):
            user = User(client, node, random)
            for k in range(arguments.rounds):
                for fault, phase in product(arguments.only, WAITS):
                    name = f"round {k}, {fault}, {phase}"
                    try:
                        found = user.trial(fault, phase)
                    except AssertionError as problem:
                        problems.append(f"{name}: {problem}")
                        print(problems[-1], file=sys.stderr, flush=True)
                        continue
                    times.setdefault((fault, phase), []).append(found)
    for (fault, phase), found in times.items():
        stop, served = np.max(found, axis=0)
        print(
            f"{fault:12} {phase:8} {len(found)} times: ~/stop {1e3 * stop:.1f} ms, next goal "
            f"{served:.1f} s"
        )
    print(f"{len(problems)} problems")
    return int(bool(problems))


class User:
    """Sends goals and faults, and looks at the reports."""

    def __init__(self, client: RobotClient, node: Popen[str], random: np.random.Generator) -> None:
        self._client, self._node, self._random = client, node, random
        self._stamps = count(1)
        name = f"{client.planner}/set_parameters"
        self._set = client.node.create_client(SetParameters, name)
        client.wait_for_node()
        client.publish("robot_description", String(data=URDF))
        client.wait_for_model()
        assert self._set.wait_for_service(PATIENCE)

    def trial(self, fault: str, phase: str) -> tuple[float, float]:
        """Times of ``~/stop`` and from the fault to a goal that is served [s]."""
        self._serve(START)
        planner, goal = planner_of(self._node), 0
        if phase == "moving":
            self._serve(GOAL, is_awaited=False)
        elif phase == "planning":
            goal = self._publish(GOAL)
        elif phase == "set-up":
            value = Parameter("naturalness", value=self._random.uniform()).to_parameter_msg()
            self._set.call_async(SetParameters.Request(parameters=[value]))
        time.sleep(self._random.uniform(0.0, 0.02))
        began = time.monotonic()
        os.kill(planner, FAULTS[fault])
        if goal and self._random.random() < 0.5:
            self._wait_for_reports(goal)
        called = time.monotonic()
        assert self._client.call("stop", PATIENCE).success
        stopped = time.monotonic() - called
        if goal:
            self._wait_for_reports(goal)
        served = self._serve(GOAL) - began
        assert self._node.poll() is None, "the node ended"
        if goal:
            assert len(self._reports(goal)) == 1, "a goal has several reports"
        assert stopped <= STOP_TIME, f"~/stop took {stopped:.3f} s"
        most = SERVED_TIME + (WAITS[phase] if fault == LOOP else 0.0)
        assert served <= most, f"a goal was served only {served:.1f} s after the fault"
        return stopped, served

    def _publish(self, positions: list[float]) -> int:
        stamp = next(self._stamps)
        goal = JointState(name=JOINT_NAMES, position=positions)
        goal.header.stamp.sec = stamp
        self._client.publish_goal(goal)
        return stamp

    def _reports(self, stamp: int) -> list[dict[str, str]]:
        values = map(report_values, self._client.reports)
        return [one for one in values if int(float(one["goal_stamp"])) == stamp]

    def _wait_for_reports(self, stamp: int) -> str:
        self._wait(lambda: bool(self._reports(stamp)), "a goal has no report")
        return self._reports(stamp)[0]["status"]

    def _serve(self, positions: list[float], *, is_awaited: bool = True) -> float:
        """Send goals until one is served; returns when that was [s], once the robot is there."""
        deadline = time.monotonic() + PATIENCE
        while (status := self._wait_for_reports(self._publish(positions))) == "refused":
            assert time.monotonic() < deadline, "no goal is served"
            time.sleep(0.05)
        served = time.monotonic()
        if not is_awaited:
            time.sleep(0.2)
        elif status != "under_way":
            last = self._client.trajectories[-1].points[-1].time_from_start
            time.sleep(last.sec + 1e-9 * last.nanosec + 0.3)
        return served

    def _wait(self, is_done: Callable[[], bool], problem: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not is_done():
            assert time.monotonic() < deadline, problem
            self._client.spin_once(0.05)


if __name__ == "__main__":
    sys.exit(main())
