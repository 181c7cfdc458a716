# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated robots: time per cycle, lag of the drives, sag under a payload, referee findings.

Each arm makes minimum-jerk motions between random configurations, at the limits of the referee,
through a hold and with speed scaling. Then it holds a payload.

    python benchmarks/simulated_robots.py [--motions 20] [--plant mujoco]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from referee import Verdict, judge
from tables import benchmark_parser, show

from mp_pca_planner.evaluation.problems import robot_file
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.simulation.robot import SimulatedRobot

PAYLOAD = 3.0
DURATION = 1.5
# Peaks of the minimum-jerk motion in units of D / T, D / T² and D / T³.
PEAKS = {"velocity": 1.875, "acceleration": 5.7735, "jerk": 60.0}


def main() -> None:
    """Print the table."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--motions", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=("human_arm", "panda", "ur5"))
    parser.add_argument("--plant", default="pinocchio")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.robots:
        _, path, joints = robot_file(name)
        rows.append([name, *measure(Robot.from_file(path, joints), arguments)])
    header = ["robot", "per cycle [µs]", "lag [ms]", f"sag at {PAYLOAD:g} kg [mrad]"]
    header += ["limits exceeded", "largest jump [mrad]"]
    show({"Simulated robots": (header, rows)}, as_json=arguments.json)


def measure(robot: Robot, arguments: argparse.Namespace) -> list[str]:
    """One row of the table."""
    rng, limits = np.random.default_rng(1), robot.limits()
    low, high = np.clip(limits.lower, -2.0, None), np.clip(limits.upper, None, 2.0)
    q = 0.5 * (low + high)
    simulated = SimulatedRobot(robot, q, plant=arguments.plant)
    record, lags, exceeded, jumps, spent = simulated.record, [], 0, [0.0], 0.0
    for k in range(arguments.motions):
        goal = q + rng.uniform(-0.3, 0.3) * (high - low)
        goal = np.clip(goal, low, high)
        record.clear()
        zero = np.zeros((2, len(q)))
        simulated.send(Trajectory(robot.joint_names, [0.0, DURATION], [q, goal], zero, zero))
        begin = time.perf_counter()
        run(simulated, faulty=k % 2 == 1)
        spent += (time.perf_counter() - begin) / len(record)
        if k % 2 == 0:
            lags.append(lag(simulated))
        verdict = judged(simulated, goal - q)
        exceeded, jumps, q = exceeded + len(verdict.exceeded), [*jumps, verdict.largest_jump], goal
    simulated.faults.payload = PAYLOAD
    for _ in range(2000):
        simulated.step()
    sag = np.abs(record.q[-1] - record.measured[-1]).max()
    figures = (spent / arguments.motions * 1e6, np.median(lags) * 1e3, sag * 1e3)
    return [*(f"{x:.2f}" for x in figures), str(exceeded), f"{max(jumps) * 1e3:.1e}"]


def run(simulated: SimulatedRobot, *, faulty: bool) -> None:
    """Run a motion to its end, optionally with speed scaling and a hold."""
    faults = simulated.faults
    for k in range(6000 if faulty else 2000):
        faults.held = faulty and 400 < k < 1200
        faults.speed_scaling = 0.4 if faulty and k > 2000 else 1.0
        simulated.step()
    faults.speed_scaling = 1.0
    for _ in range(1000):
        simulated.step()


def lag(simulated: SimulatedRobot) -> float:
    """Delay of the fastest joint at its peak speed [s]."""
    record = simulated.record
    k, j = np.unravel_index(np.abs(record.v).argmax(), record.v.shape)
    return float((record.q[k, j] - record.measured[k, j]) / record.v[k, j])


def judged(simulated: SimulatedRobot, displacement: np.ndarray) -> Verdict:
    """Findings of the referee on a motion that reaches all of its limits."""
    limits = {
        quantity: peak * np.abs(displacement) / DURATION ** (order + 1)
        for order, (quantity, peak) in enumerate(PEAKS.items())
    }
    return judge(simulated.record.q, simulated.record.clock, limits)


if __name__ == "__main__":
    main()
