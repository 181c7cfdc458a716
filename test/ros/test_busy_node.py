# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A node in this process, some of whose threads are held up by the tests."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENTLY,
    START,
    NodeClient,
    column,
    described_client,
    goal_message,
)
from support.patience import HANG

from mp_pca_planner.motion.goal import Goal, JointState
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.node import PlannerNode


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PlannerNode]:
    set_domain(monkeypatch, 33)
    file = tmp_path / "arm.npz"
    save_primitive(arm_primitive(), file)
    arguments = ["--ros-args", "-p", f"primitives:=['{file}']", *PATIENTLY]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node, is_over = PlannerNode(), threading.Event()
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        while not is_over.is_set():
            executor.spin_once(0.1)

    thread = threading.Thread(target=spin)
    thread.start()
    yield node
    is_over.set()
    thread.join()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def client(node: PlannerNode) -> Iterator[NodeClient]:
    with described_client() as client:
        client.publish_state(JOINTS, START)
        yield client


def test_stop_is_answered_while_parameters_are_changed(
    node: PlannerNode, client: NodeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert client.send(goal_message(GOAL), HANG).trajectory is not None
    change, may_end, waited = node._setup.change, threading.Event(), []

    def slow_change(changes: list[Parameter]) -> None:
        waited.append(may_end.wait(HANG))
        change(changes)

    monkeypatch.setattr(node._setup, "change", slow_change)
    message = Parameter("naturalness", value=0.5).to_parameter_msg()
    request = SetParameters.Request(parameters=[message])
    changed = client._services["set_parameters"].call_async(request)
    answer, trajectory = client.stop(HANG)
    assert answer.success
    assert trajectory is not None
    may_end.set()
    client.wait(changed.done, HANG, "did not set the parameter")
    assert waited == [True]


def policy_of(thread: int) -> int:
    """The scheduling policy of a thread of this process: the 41st field of its state."""
    stat = Path(f"/proc/self/task/{thread}/stat").read_text(encoding="ascii")
    return int(stat.rpartition(")")[2].split()[38])


def may_run_in_real_time() -> bool:
    """Whether the system lets a thread of this process run in real time."""
    permitted = []

    def ask() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        except OSError:
            return
        permitted.append(policy_of(threading.get_native_id()) == os.SCHED_RR)

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return permitted == [True]


def test_only_the_thread_that_stops_the_robot_runs_in_real_time_where_that_is_permitted(
    node: PlannerNode, client: NodeClient
) -> None:
    assert client.stop(HANG)[0].message  # the thread is running
    found = {t.name: policy_of(t.native_id) for t in threading.enumerate() if t.native_id}
    assert found.pop("safety") == (os.SCHED_RR if may_run_in_real_time() else os.SCHED_OTHER)
    assert {found["planning"], found["obstacles"], found["meshes"]} == {os.SCHED_OTHER}


def test_goal_is_refused_if_the_limits_change_while_it_is_planned(
    node: PlannerNode, client: NodeClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = node._setup.context
    assert context is not None
    plan, has_begun, may_end = context.planner.plan, threading.Event(), threading.Event()

    def slow_plan(goal: Goal, start: JointState) -> object:
        has_begun.set()
        assert may_end.wait(HANG)
        return plan(goal, start)

    monkeypatch.setattr(context.planner, "plan", slow_plan)
    n_reports, goal = len(client.reports), goal_message(GOAL)
    client.publish_goal(goal)
    assert has_begun.wait(HANG)
    limit = Parameter("limits.elbow.max_velocity", value=0.1)
    (result,) = client.set_parameters(limit.to_parameter_msg())
    assert result.successful, result.reason
    may_end.set()
    client.wait(lambda: len(client.reports) > n_reports, HANG, "did not report")
    assert client.reports[-1].level == DiagnosticStatus.ERROR
    assert "changed during planning" in client.reports[-1].message
    again = client.send(goal, HANG)
    assert again.trajectory is not None
    assert np.abs(column(again.trajectory, "velocities")[:, JOINTS.index("elbow")]).max() <= 0.1
    assert len(client.trajectories) == 1
