# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Latency of the node over real topics, and its CPU load by joint states at 1 kHz.

The time from sending a goal to receiving its trajectory is measured; run it as
``python benchmarks/node_latency.py``. The robot is the arm of ``config/human_arm.urdf``.
"""

from __future__ import annotations

import argparse
import os
import time
from subprocess import Popen

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.node_setup import (
    URDF,
    RobotClient,
    joint_states,
    print_latencies,
    processor_time,
    running_node,
)

from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import Answer, this_machine_only

RATES = (20.0, 1000.0)
_N_ROUNDS = 4
# This robot never moves. For a moment after a motion, the node waits for it to start.
_PAUSE = 0.6


def main() -> None:
    """Run the measurements and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=400, help="number of goals for each rate")
    parser.add_argument("--idle", type=float, default=5.0, help="time without goals [s]")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    motions = generate_motions(arguments.goals // _N_ROUNDS, seed=2)
    answers: dict[float, list[Answer]] = {rate: [] for rate in RATES}
    shares: dict[float, list[float]] = {rate: [] for rate in RATES}
    with running_node() as node, RobotClient() as client:
        client.publish("robot_description", String(data=URDF.read_text(encoding="utf-8")))
        client.wait_for_node()
        client.wait_for_model()
        # Alternating, so that other load of the machine affects both alike.
        for _ in range(_N_ROUNDS):
            for rate in RATES:
                with joint_states(rate, motions[0].positions[0].tolist()):
                    while plan(client, motions[0]).trajectory is None:
                        pass  # no state has been received yet
                    shares[rate].append(idle_share(node, arguments.idle / _N_ROUNDS))
                    answers[rate] += [plan(client, motion) for motion in motions]
    for rate in RATES:
        share = np.median(shares[rate])
        print(f"joint states at {rate:g} Hz: {share:.1%} of one core without goals")
        report(answers[rate])


def idle_share(node: Popen[str], duration: float) -> float:
    """CPU load of the node without goals, as a share of one core."""
    before, began = processor_time(node), time.monotonic()
    time.sleep(duration)
    return (processor_time(node) - before) / (time.monotonic() - began)


def plan(client: RobotClient, motion: Demonstration) -> Answer:
    """A goal at the end of a motion, some time after the last one."""
    time.sleep(_PAUSE)
    return client.send(JointState(name=JOINT_NAMES, position=motion.positions[-1]))


def report(answers: list[Answer]) -> None:
    """Print medians and 99th percentiles [ms]."""
    served = [a for a in answers if a.report.level != DiagnosticStatus.ERROR]
    print(f"  {len(answers)} goals, {len(served)} motions")
    for reason in {a.report.message for a in answers if a not in served}:
        print(f"  refused: {reason}")
    print_latencies(
        np.array([a.latency for a in served]),
        np.array([float(a.values["solve_time_s"]) for a in served]),
    )


if __name__ == "__main__":
    main()
