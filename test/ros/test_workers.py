# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Workers that hang or die cost their goal: the node answers, and serves the next one."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    START,
    NodeClient,
    column,
    described_client,
    goal_message,
    planner_of,
    running_node,
)
from support.patience import HANG

from mp_pca_planner.primitives.file import save_primitive


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    folder = tmp_path_factory.mktemp("workers")
    save_primitive(arm_primitive(), folder / "arm.npz")
    arguments = ["-p", f"primitives:=['{folder / 'arm.npz'}']", "-p", "state_timeout:=0.0"]
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 33)
        with running_node(folder / "log.txt", *arguments) as process:
            yield process


@pytest.fixture
def client(node: subprocess.Popen[str]) -> Iterator[NodeClient]:
    with described_client() as client:
        client.publish_state(JOINTS, START)
        client.call("stop", HANG)
        yield client


def serve(client: NodeClient) -> None:
    """Have a goal served, as soon as goals are."""
    for _ in range(100):
        answer = client.send(goal_message(GOAL), HANG)
        if answer.trajectory is not None:
            client.call("stop", HANG)
            np.testing.assert_array_equal(column(answer.trajectory, "positions")[-1], GOAL)
            return
        assert "send the goal again" in answer.report.message, answer.report.message
        client.wait_for_diagnostics(timeout=HANG)
    raise AssertionError(answer.report.message)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_goal_whose_planner_dies_is_refused_with_the_reason_and_the_next_one_served(
    node: subprocess.Popen[str], client: NodeClient, number: signal.Signals
) -> None:
    serve(client)
    planner, n = planner_of(node), len(client.reports)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    answer = client.call("stop", HANG)  # the planner hangs, and the node answers
    assert answer.success
    client.publish_goal(goal_message(GOAL))
    os.kill(planner, number)
    os.kill(planner, signal.SIGCONT)
    client.wait(lambda: len(client.reports) >= n + 2, HANG, "did not report")
    overtaken, refused = client.reports[n : n + 2]
    assert "preempted" in overtaken.message
    assert refused.level == DiagnosticStatus.ERROR
    assert "the planner has ended" in refused.message or "started again" in refused.message
    serve(client)


def test_planner_that_ignores_a_cancelled_goal_is_ended(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner = planner_of(node)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    assert client.call("stop", HANG).success
    client.wait_for_diagnostics(lambda values: int(values["worker_restarts"]) > 0, HANG)
    serve(client)
    assert planner_of(node) != planner


def test_goal_is_refused_if_the_limits_change_while_it_is_planned(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner, n = planner_of(node), len(client.reports)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    limit = Parameter("limits.elbow.max_velocity", value=0.5).to_parameter_msg()
    service = client._services["set_parameters"]
    changed = service.call_async(service.srv_type.Request(parameters=[limit]))
    assert client.call("stop", HANG).success  # while a parameter waits for the planner
    os.kill(planner, signal.SIGCONT)
    client.wait(changed.done, HANG, "did not set the parameter")
    (result,) = changed.result().results
    assert result.successful, result.reason
    client.wait(lambda: len(client.reports) > n, HANG, "did not report")
    answer = client.send(goal_message(GOAL), HANG)
    assert answer.trajectory is not None
    elbow = column(answer.trajectory, "velocities")[:, JOINTS.index("elbow")]
    assert np.abs(elbow).max() <= 0.5
