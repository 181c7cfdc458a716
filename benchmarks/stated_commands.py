# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Jumps of the command where it can only be known from the controller itself.

Restarts of the node and of the controller in motion, goals and stops under a speed scaling from 1
to 100 %, steady or changing, and stops of a robot whose motion is unknown: what is listed apart in
``moving_robot.py``. The controller states its command, or not (``--inferred``). All in virtual
time.

    python benchmarks/stated_commands.py [--events 200] [--robots panda,ur5] [--inferred] [--json]

A jump is the change of the commanded velocity from one millisecond to the next, times that time;
jumps that the controller makes by itself, when it restarts, are not counted. Exits with 1 if one
exceeds 0.2 mrad while the controller states its command.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from moving_robot import Run
from tables import benchmark_parser, show
from virtual_node import scene_and_model

LARGEST = 2e-4  # [rad]
EVENTS_IN_A_RUN = 10


def move(run: Run) -> None:
    """Send a goal, and wait until the robot is somewhere on its way."""
    run.send(run.target())
    run.node.run(run.random.uniform(0.2, 1.2))


def disturb(run: Run) -> None:
    """Send a goal or a stop, and wait."""
    if run.random.random() < 0.5:
        run.send(run.target())
    else:
        run.node.stop()
    run.node.run(run.random.uniform(0.2, 1.5))


def scaled(run: Run) -> None:
    """Scale the speed; a goal and a stop meanwhile, and while it returns."""
    move(run)
    run.faults.speed_scaling = float(run.random.uniform(0.01, 1.0))
    run.node.run(run.random.uniform(0.02, 1.0))
    disturb(run)
    run.faults.speed_scaling = 1.0
    run.node.run(run.random.uniform(0.02, 0.6))
    disturb(run)


def node_restart(run: Run) -> None:
    """Restart the node in motion: it has no motion of its own to stop on."""
    move(run)
    run.node.restart()
    run.node.run(run.random.uniform(0.05, 0.5))
    run.node.stop()
    run.node.run(run.random.uniform(0.2, 1.5))


def controller_restart(run: Run) -> None:
    """Restart the controller in motion: it holds a position that nobody has sent."""
    move(run)
    run.node.robot.restart_controller()
    run.node.run(run.random.uniform(0.0, 0.5))
    disturb(run)


def second_stop(run: Run) -> None:
    """Stop twice, and send a goal while the robot comes to rest."""
    move(run)
    run.node.stop()
    run.node.run(run.random.uniform(0.01, 0.2))
    run.node.stop()
    run.node.run(run.random.uniform(0.01, 0.5))
    disturb(run)


EVENTS: tuple[Callable[[Run], None], ...] = (scaled, node_restart, controller_restart, second_stop)


def jumps(run: Run) -> np.ndarray:
    """The largest jump of a joint at each message [rad]."""
    record = run.node.robot.record
    steps = np.diff(record.q, axis=0)
    change = np.abs(np.diff(steps, axis=0)).max(axis=1)
    own = {cut + shift for cut in record.cuts for shift in range(-1, 3)}
    ticks = [
        tick for tick, _ in run.node.robot.taken if 2 <= tick < len(record) and tick not in own
    ]
    # Where the controller leads to a point, the second step shows the jump of the first.
    return np.array([change[tick - 2 : tick].max() for tick in ticks])


def main() -> int:
    """Print a row per robot."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--events", type=int, default=200, help="of each robot")
    parser.add_argument("--robots", default="panda,ur5")
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--inferred", action="store_true", help="the controller states nothing")
    arguments = parser.parse_args()
    rows: list[list[str]] = []
    is_good = True
    for name in arguments.robots.split(","):
        scene, model = scene_and_model(name)
        found, n_points = [np.zeros(1)], 0
        for k in range(-(-arguments.events // EVENTS_IN_A_RUN)):
            run = Run(scene, model, arguments.seed + k, not arguments.inferred)
            for _ in range(EVENTS_IN_A_RUN):
                EVENTS[run.random.integers(len(EVENTS))](run)
            found.append(jumps(run))
            n_points += sum(n == 1 for _, n in run.node.robot.taken)
            if (worst := found[-1].max(initial=0.0)) > LARGEST:
                print(f"{name}, seed {arguments.seed + k}: a jump of {1e3 * worst:.2f} mrad")
        every = np.concatenate(found)
        is_good = is_good and every.max() <= LARGEST
        large = int((every > LARGEST).sum())
        counts = len(every) - 1, n_points, large, round(1e3 * every.max(), 3)
        rows.append([name, *map(str, counts)])
    columns = ["robot", "messages", "of one point", "jumps over 0.2 mrad", "largest [mrad]"]
    show({"Stated commands": (columns, rows)}, as_json=arguments.json)
    return int(not (is_good or arguments.inferred))


if __name__ == "__main__":
    raise SystemExit(main())
