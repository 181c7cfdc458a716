# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`watch` beside a real node: what it draws of goals, reports, states and diagnostics."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("rich", reason="rich (extra view) is not installed")

from arm import JOINTS, arm_primitive
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nodes import (
    GOAL,
    PATIENTLY,
    START,
    NodeClient,
    described_client,
    goal_message,
    running_node,
    set_domain,
)
from patience import HANG
from rich.console import Console

from mp_pca_planner.cli.watch import frame
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.ros.monitor import Monitor, NodeView


def drawn(seen: NodeView, *, with_colours: bool = False) -> str:
    console = Console(width=110, record=True, file=StringIO(), color_system="standard")
    console.print(frame(seen, time.monotonic()))
    return console.export_text(styles=with_colours)


def wait_until(
    monitor: Monitor, client: NodeClient, wanted: Callable[[NodeView], bool]
) -> NodeView:
    deadline = time.monotonic() + HANG
    while not wanted(monitor.look()) and time.monotonic() < deadline:
        client.publish_state((*JOINTS, "gripper"), (*START, 0.5))
        time.sleep(0.02)
    return monitor.seen


def test_view_shows_states_goal_report_and_diagnostics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 31)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    arguments = ("-p", f"primitives:=['{tmp_path / 'arm.npz'}']", *PATIENTLY)
    with (
        running_node(tmp_path / "log.txt", *arguments),
        described_client() as client,
        Monitor() as monitor,
    ):
        assert "none yet" in drawn(NodeView())
        wait_until(monitor, client, lambda s: bool(s.states and s.limits and s.diagnostics))
        answer = client.send(goal_message(GOAL))
        wait_until(monitor, client, lambda s: s.report is not None)
        served = drawn(monitor.seen)
        refusal = client.send(goal_message([np.nan, *GOAL[1:]]))
        wait_until(monitor, client, lambda s: s.report and s.report[0].level == b"\2")
        refused = drawn(monitor.seen)
    lines: dict[str, str] = {}
    for line in served.splitlines():
        if line.startswith("│ "):
            lines.setdefault(line.split()[1], line)  # joints come first
    for name, position in zip(JOINTS, START, strict=True):
        assert f"{position:.3f}" in lines[name]
        assert lines[name].count("●") == 1
    assert "0.500" in lines["gripper"]
    assert "●" not in lines["gripper"]
    assert f"{JOINTS[0]} {GOAL[0]:.3f}" in served
    assert f"OK  {answer.report.message[:40]}" in served
    assert f"{float(answer.values['effort_cost']):.4g}" in lines["effort_cost"]
    assert "ready for goals" in served
    assert f"ERROR  {refusal.report.message[:40]}" in refused


def test_position_outside_of_its_limits_is_at_the_end_of_its_bar_and_red() -> None:
    limits = JointLimits(["a"], {"a": {"min_position": -1.0, "max_position": 1.0}}, source="test")
    seen = NodeView(states={"a": (2.0, 0.0, time.monotonic())}, limits=limits)
    (line,) = [x for x in drawn(seen, with_colours=True).splitlines() if "●" in x]
    assert "─●" in line
    assert "\x1b[31m" in line


def test_view_ends_after_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    set_domain(monkeypatch, 33)
    command = [sys.executable, "-m", "mp_pca_planner", "watch", "--for", "0.3"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG, check=True)
    assert "joint states" in done.stdout
    assert not done.stderr


def test_names_and_words_of_others_do_not_steer_the_terminal() -> None:
    now, hostile = time.monotonic(), "\x1b[31m\nroot# \u202e"
    report = DiagnosticStatus(message=hostile, values=[KeyValue(key=hostile, value=hostile)])
    text = drawn(
        NodeView(
            states={hostile: (0.0, 0.0, now)},
            goal=(hostile, now),
            report=(DiagnosticStatus(message=hostile), now),
            diagnostics=(report, now),
        )
    )
    assert all(line.isprintable() for line in text.split("\n"))
    assert text.count(r"\x1b[31m\nroot#") == 6
