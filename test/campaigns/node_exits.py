# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repeated starts and stops of the node: times until it is ready, and exit statuses.

Run it as ``python3 -m campaigns.node_exits``. Times count from the start of the interpreter: until
the node reports that it is ready, and until a running client receives the report on its first goal.
Of two signals, the second is sent at a random moment of the shutdown.

The script exits with status 1 if the node ever exits with a status other than 0 or prints a
traceback. After a SIGKILL the next start must succeed.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO

import numpy as np
import yaml
from sensor_msgs.msg import JointState
from support.node_setup import URDF, RobotClient, primitive_file, start_node

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import NoAnswerError, is_served, this_machine_only

ENDS = {
    "SIGINT": [signal.SIGINT],
    "SIGTERM": [signal.SIGTERM],
    "SIGINT twice": [signal.SIGINT, signal.SIGINT],
    "SIGTERM often": [signal.SIGTERM] * 10,
    "SIGKILL": [signal.SIGKILL],
}
# Longest time between two signals [s]; the node is usually still running after it.
_LONGEST_PAUSE = 0.3


def main() -> int:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100, help="starts for each signal")
    n_repeats = parser.parse_args().repeats
    os.environ.update(this_machine_only())
    motion = generate_motions(1, seed=2)[0]
    goal = JointState(name=JOINT_NAMES, position=motion.positions[-1])
    n_failed = 0
    state = JointState(name=JOINT_NAMES, position=motion.positions[0])
    with (
        primitive_file() as file,
        RobotClient() as client,
        tempfile.TemporaryFile("w+") as log,
    ):
        parameters = write_parameters(file)
        for name, signals in ENDS.items():
            ready, served, n_clean = [], [], 0
            for _ in range(n_repeats):
                log.seek(0)
                log.truncate()
                began = time.time()
                node = start_node("--params-file", str(parameters), output=log)
                wait_until_served(client, state, goal)
                served.append(time.time() - began)
                ready.append(time_of_readiness(log) - began)
                n_clean += ends_cleanly(node, signals, log)
            n_failed += n_repeats - n_clean
            print(
                f"{name:13} {n_clean} of {n_repeats} ends clean; ready after {told(ready)}, "
                f"first goal served after {told(served)}"
            )
    return int(n_failed > 0)


def write_parameters(primitives: Path) -> Path:
    """Write the parameter file of the node beside the primitives."""
    values = {
        "primitives": [str(primitives)],
        "robot_description": URDF.read_text(encoding="utf-8"),
    }
    file = primitives.with_suffix(".yaml")
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
    return file


def told(times: list[float]) -> str:
    """Median and 99th percentile [s]."""
    median, high = np.percentile(times, (50, 99))
    return f"{median:.2f} s (99th percentile {high:.2f} s)"


def wait_until_served(client: RobotClient, state: JointState, goal: JointState) -> None:
    """Send the goal repeatedly, as a client that waits for the node."""
    patience = 0.05
    while True:
        # Each goal has its own stamp: a report of the previous node must not be mistaken for this
        # one's.
        goal.header.stamp.sec += 1
        client.publish("joint_states", state)
        try:
            if is_served(client.send(goal, patience, with_trajectory=False).report):
                return
        except NoAnswerError:
            patience *= 1.1  # a busy machine may need more time


def time_of_readiness(log: IO[str]) -> float:
    """Time at which the node reported that it is ready [s]; it may serve a goal before."""
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        log.seek(0)
        found = re.search(r"\[INFO\] \[([\d.]+)\].*ready for goals", log.read())
        if found is not None:
            return float(found[1])
        time.sleep(0.01)
    raise TimeoutError("the node did not report that it is ready")


def ends_cleanly(node: subprocess.Popen[str], signals: list[int], log: IO[str]) -> bool:
    """Send the signals; return whether the node exited as expected."""
    for k, number in enumerate(signals):
        if k > 0:
            time.sleep(random.uniform(0.0, _LONGEST_PAUSE / len(signals)))
        node.send_signal(number)
        if node.poll() is not None:
            break
    status = node.wait(timeout=30.0)
    if signals == [signal.SIGKILL]:
        return status == -signal.SIGKILL
    log.seek(0)
    said = log.read()
    if status == 0 and "Traceback" not in said:
        return True
    print(f"ended with status {status}:\n{said}")
    return False


if __name__ == "__main__":
    sys.exit(main())
