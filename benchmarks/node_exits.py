# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Starts and ends the node again and again: how long it takes to be ready, and how it ends.

Run it as ``python benchmarks/node_exits.py``. It ends with status 1 if the node once ended with
another status than 0, or printed a traceback. After a SIGKILL the next start must work as ever.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from typing import IO

import numpy as np
from node_setup import URDF, primitive_file, use_own_domain
from sensor_msgs.msg import JointState

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import GoalClient, NoAnswerError, is_served, start_node

ENDS = {
    "SIGINT": [signal.SIGINT],
    "SIGTERM": [signal.SIGTERM],
    "SIGINT twice": [signal.SIGINT, signal.SIGINT],
    "SIGKILL": [signal.SIGKILL],
}


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100, help="starts for each signal")
    n_repeats = parser.parse_args().repeats
    use_own_domain()
    motion = generate_motions(1, seed=2)[0]
    goal = JointState(name=JOINT_NAMES, position=motion.positions[-1])
    n_failed = 0
    state = JointState(name=JOINT_NAMES, position=motion.positions[0])
    with (
        primitive_file() as file,
        GoalClient() as client,
        tempfile.TemporaryFile("w+") as log,
    ):
        client.publish_description(URDF.read_text(encoding="utf-8"))
        for name, signals in ENDS.items():
            times, n_clean = [], 0
            for _ in range(n_repeats):
                log.truncate(0)
                began = time.monotonic()
                node = start_node("-p", f"primitives:=['{file}']", output=log)
                wait_until_served(client, state, goal)
                times.append(time.monotonic() - began)
                n_clean += ends_cleanly(node, signals, log)
            n_failed += n_repeats - n_clean
            median, high = np.percentile(times, (50, 99))
            print(
                f"{name:13} {n_clean} of {n_repeats} ends clean; first goal served after "
                f"{median:.2f} s (median), {high:.2f} s (99th percentile)"
            )
    return int(n_failed > 0)


def wait_until_served(client: GoalClient, state: JointState, goal: JointState) -> None:
    """Send the goal again and again, as somebody who waits for the node."""
    while True:
        # A stamp of its own, or an answer of the node before would be taken for this one's.
        goal.header.stamp.sec += 1
        client.publish_state_message(state)
        try:
            if is_served(client.send(goal, 0.1, with_trajectory=False).report):
                return
        except NoAnswerError:
            continue


def ends_cleanly(node: subprocess.Popen[str], signals: list[int], log: IO[str]) -> bool:
    """Send the signals; whether the node ended as it should."""
    for number in signals:
        node.send_signal(number)
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
