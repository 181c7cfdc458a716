# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks of the node share: a node, joint states, and what the node takes."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path
from subprocess import Popen

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.resources import config_file
from mp_pca_planner.ros.client import GoalClient, start_node

URDF = config_file("human_arm.urdf")
# Fresh processes: ROS does not survive a fork.
PROCESSES = multiprocessing.get_context("spawn")


@contextmanager
def primitive_file() -> Iterator[Path]:
    """A primitive of that arm."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "raise_arm.npz"
        demonstrations = [motion.as_demonstration() for motion in generate_motions(20, seed=1)]
        save_primitive(build_primitive(demonstrations, "raise_arm"), file)
        yield file


@contextmanager
def running_node(*ros_arguments: str) -> Iterator[Popen[str]]:
    """A node that is ended afterwards."""
    with primitive_file() as file:
        node = start_node("-p", f"primitives:=['{file}']", *ros_arguments)
        try:
            yield node
        finally:
            node.terminate()
            node.wait(timeout=20.0)


@contextmanager
def joint_states(rate: float, positions: list[float]) -> Iterator[None]:
    """A process that publishes a state all the time, from before this is entered."""
    is_ready = PROCESSES.Event()
    arguments = (rate, positions, is_ready)
    process = PROCESSES.Process(target=_publish_states, args=arguments, daemon=True)
    process.start()
    try:
        is_ready.wait(60.0)
        yield
    finally:
        process.kill()
        process.join()


def _publish_states(rate: float, positions: list[float], is_ready: Event) -> None:
    with GoalClient("joint_state_broadcaster") as client:
        client.wait_for_node(timeout=120.0)
        is_ready.set()
        due = time.monotonic()
        while True:
            client.publish_state(JOINT_NAMES, positions, [0.0] * len(positions))
            due = max(due + 1.0 / rate, time.monotonic() - 0.1)
            time.sleep(max(due - time.monotonic(), 0.0))


def processor_time(node: Popen[str]) -> float:
    """Time that all threads of the node have run [s]."""
    fields = Path(f"/proc/{node.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_megabytes(node: Popen[str]) -> float:
    """Memory of the node that is not swapped out [MB]."""
    pages = Path(f"/proc/{node.pid}/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6
