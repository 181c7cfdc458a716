# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `teach` beside a simulated robot and a node: killed, continued, tried."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from support.arm import JOINTS
from support.domains import set_domain
from support.nodes import GOAL, START, NodeClient, arm_node, goal_message, simulated_robot
from support.patience import HANG

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import load_primitive
from mp_pca_planner.recordings.cutting import read_segments
from mp_pca_planner.ros.nodes import READY

URDF_FILE = str(config_file("human_arm.urdf"))


class Teacher:
    """A person at the terminal of `teach`, which ends with it: reads its lines, presses keys."""

    def __init__(self, *words: str) -> None:
        command = [sys.executable, "-m", "mp_pca_planner", "teach", *words]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process, self.lines = subprocess.Popen(command, text=True, **pipes), list[str]()
        threading.Thread(target=self._read, daemon=True).start()

    def __enter__(self) -> Teacher:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def press(self, key: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{key}\n")
        self.process.stdin.flush()

    def has(self, text: str) -> bool:
        return any(text in line for line in self.lines)

    @property
    def n_motions(self) -> int:
        return sum(line.endswith("accepted") for line in self.lines)

    def wait_for(self, text: str) -> None:
        self.wait(lambda: self.has(text), f"'{text}' was not said")

    def wait_until_it_records(self, client: NodeClient, killed: set[bytes]) -> None:
        """Wait until the session hears joint states, and for a rest before the first motion."""
        self.wait(lambda: listeners(client) - killed, "nothing is recorded")
        time.sleep(1.0)

    def wait(self, holds: Callable[[], Any], complaint: str) -> None:
        deadline = time.monotonic() + HANG
        while not holds():
            assert time.monotonic() < deadline, f"{complaint} in {self.lines}"
            assert self.process.poll() is None or holds(), self.lines
            time.sleep(0.02)


def listeners(client: NodeClient) -> set[bytes]:
    """The subscriptions of sessions, also of those that were killed a while ago."""
    found = client.node.get_subscriptions_info_by_topic("/joint_states")
    return {bytes(one.endpoint_gid) for one in found if one.node_name == "teach"}


def move(client: NodeClient, goal: list[float], teacher: Teacher | None = None) -> None:
    """Have the old primitive move the arm as a person would; with a teacher, until it is shown."""
    n_motions, n_executions = teacher.n_motions if teacher else 0, len(client.executions)
    message, deadline = goal_message(goal), time.monotonic() + HANG
    message.header.frame_id = "arm_0"
    while True:
        message.header.stamp = client.node.get_clock().now().to_msg()
        answer = client.send(message, HANG)
        if answer.trajectory is not None:
            break
        # On a busy machine the node hears late that the robot rests.
        assert "the robot moves" in answer.report.message and time.monotonic() < deadline
    if teacher is not None:
        client.wait(lambda: len(client.executions) > n_executions, HANG, "did not arrive")
        teacher.wait(lambda: teacher.n_motions > n_motions, "no motion was shown")


@pytest.mark.slow
def test_a_killed_session_is_continued_and_the_robot_reaches_a_goal_as_it_was_taught(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    set_domain(monkeypatch, 66)
    halfway = (0.5 * (np.array(START) + GOAL)).tolist()
    with (
        arm_node(max_solve_time=HANG) as (_, folder),
        simulated_robot(folder / "robot.txt", START),
        NodeClient() as client,
    ):
        output = folder / "primitives" / "taught.npz"  # which the node reads
        words = ("--output", str(output), "--robot", URDF_FILE, "--timeout", str(HANG))
        client.wait_for_node(HANG)
        client.wait_for_diagnostics(lambda values: values["text"] == READY, HANG)
        with Teacher(*words) as teacher:
            teacher.wait_until_it_records(client, set())
            move(client, GOAL, teacher)
            move(client, START, teacher)
            move(client, halfway)
            killed = listeners(client)
            teacher.process.kill()  # while the arm moves
        client.wait(lambda: len(client.executions) == 3, HANG, "did not arrive")
        with Teacher(*words) as teacher:
            teacher.wait_until_it_records(client, killed)
            teacher.wait_for("motion 2: ")
            move(client, GOAL, teacher)
            teacher.press("d")
            teacher.wait_for("is discarded: ")
            move(client, START, teacher)
            assert teacher.has("left-out error")
            teacher.press("b")
            teacher.wait_for("y and Enter sends it to the robot")
            n_sent = len(client.reports)
            client.spin_once()
            assert len(client.reports) == n_sent  # nothing is sent without a yes
            teacher.press("y")
            assert teacher.process.wait(HANG) == 0, teacher.lines
        assert teacher.has("arrived"), teacher.lines
        primitive = load_primitive(output)
        segments = read_segments(output.with_name("taught_segments.csv"), ["taught"])["taught"]
    assert primitive.name == "taught" and set(primitive.joint_names) == set(JOINTS)
    assert len(primitive.durations) == len(segments) >= 3
