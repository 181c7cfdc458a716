# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals and stops of robots whose servos lag and sag, without any fault.

The node sees joint states alone: it must know by itself what is commanded. The node and the robot
are stepped together in virtual time, and a referee judges the commands.

    python3 -m campaigns.slow_servos [--events 1000] [--robots panda,ur5] [--json]

Exits with 1 if a command jumps by more than 1 mrad or exceeds a limit, a goal is refused, or a
motion ends otherwise than arrived, replaced or stopped.
"""

from __future__ import annotations

import sys
from collections import Counter
from itertools import product
from typing import Any

import numpy as np
from support.problems import Scene
from support.referee import judge
from support.tables import benchmark_parser, show
from support.virtual_node import VirtualNode, scene_and_model

from mp_pca_planner.execution.planning import Model
from mp_pca_planner.motion.goal import JointGoal, JointState

LAGS, SAGS = (0.02, 0.05, 0.1), (0.0, 0.006)  # [s], [rad]
LARGEST_JUMP = 1e-3  # [rad]
PERIOD = 1e-3  # of the controller [s]
FINEST = 1e-6  # step below the resolution of encoders [rad]
P_GOAL = 0.75  # share of goals among the events; others are stops


class LaggingServos:
    """Drives that approach their commands with a time constant [s], less a sag [rad]."""

    def __init__(self, q: Any, lag: float, sag: float) -> None:
        self.q = np.array(q) - sag
        self.v = self.acting = np.zeros_like(self.q)
        self._share, self._sag = 1.0 - np.exp(-PERIOD / lag), sag

    def set_payload(self, mass: float) -> None:
        """Do nothing: the sag stands for it."""

    def step(self, command: Any) -> None:
        """Move for one period."""
        moved = (command - self._sag - self.q) * self._share
        self.q, self.v = self.q + moved, moved / PERIOD


class Run:
    """Random goals and stops of a robot, after a first motion."""

    def __init__(
        self, scene: Scene, model: Model, lag: float, sag: float, n_events: int, seed: int = 1
    ) -> None:
        ends = np.array([m.positions[[0, -1]] for m in scene.demonstrations])
        ends = ends.reshape(-1, model.robot.n_joints)
        random = np.random.default_rng(seed)
        self.node = node = VirtualNode(model, ends[0], seed=seed)
        node.robot.plant = LaggingServos(ends[0], lag, sag)
        node.run(0.3)
        for k in range(n_events + 1):
            if k == 0 or random.random() < P_GOAL:
                q = ends[random.integers(len(ends)) if k else 1]
                node.goal(JointGoal(JointState(model.robot.joint_names, q)), k)
            else:
                node.stop()
            node.run(random.uniform(0.1, 2.0) if k else 5.0)
            if k == 0:
                # A resting robot that has not moved yet is commanded to be where it is measured.
                first = len(node.robot.record)
        node.run(8.0)
        record, limits = node.robot.record, model.limits
        names = ("lower", "upper", "velocity", "acceleration", "jerk")
        verdict = judge(
            record.q[first:],
            record.clock[first:],
            {name: getattr(limits, name) for name in names},
            time=record.times[first:],
            finest=FINEST,
        )
        self.largest_jump, self.exceeded = verdict.largest_jump, verdict.exceeded
        self.statuses = Counter(str(r.status) for r in node.plan_reports)
        self.outcomes = Counter(str(r.outcome) for _, r in node.execution_reports)

    @property
    def is_good(self) -> bool:
        """Whether nothing jumped, was refused or ended badly."""
        is_smooth = self.largest_jump <= LARGEST_JUMP and not self.exceeded
        expected = {"arrived", "replaced", "stopped"}
        return is_smooth and not self.statuses["refused"] and set(self.outcomes) <= expected


def main() -> int:
    """Print a row for each robot, lag and sag."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--events", type=int, default=1000, help="in all")
    parser.add_argument("--robots", default="panda,ur5")
    arguments = parser.parse_args()
    robots = arguments.robots.split(",")
    n_events = -(-arguments.events // (len(robots) * len(LAGS) * len(SAGS)))
    rows, is_good = [], True
    for name in robots:
        scene, model = scene_and_model(name)
        for lag, sag in product(LAGS, SAGS):
            run = Run(scene, model, lag, sag, n_events)
            is_good &= run.is_good
            counts = [", ".join(f"{n} {x}" for x, n in sorted(c.items())) for c in (run.statuses,)]
            counts += [", ".join(f"{n} {x}" for x, n in sorted(run.outcomes.items()))]
            jump = f"{1e3 * run.largest_jump:.3f}"
            rows.append([name, f"{1e3 * lag:g}", f"{1e3 * sag:g}", jump, *counts])
    header = ["robot", "lag [ms]", "sag [mrad]", "largest jump [mrad]", "goals", "motions"]
    show({"Servos that lag": (header, rows)}, as_json=arguments.json)
    return int(not is_good)


if __name__ == "__main__":
    sys.exit(main())
