# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner as a managed node: what it does in each state, and from one to the next."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node
from support.arm import JOINTS, arm_primitive
from support.bench import benched
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENTLY,
    START,
    URDF,
    NodeClient,
    call,
    goal_message,
    ros_node,
    running_node,
)

from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow

CONFIGURE, ACTIVATE, DEACTIVATE, CLEAN_UP = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
)


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """A node beside a managed planner, whose primitive file is missing at first."""
    set_domain(monkeypatch, 41)
    arguments = ("-p", f"primitives:=['{tmp_path / 'arm.npz'}']", *PATIENTLY)
    with (
        running_node(tmp_path / "log.txt", *arguments, options=["--managed"]),
        ros_node("manager") as node,
    ):
        yield node


def change(manager: Node, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return call(manager, ChangeState, "mp_pca_planner/change_state", request).success


def state(manager: Node) -> str:
    request = GetState.Request()
    return call(manager, GetState, "mp_pca_planner/get_state", request).current_state.label


def test_deactivated_node_stops_its_robot_and_still_answers_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(user: Node) -> None:
        assert change(user, CONFIGURE) and change(user, ACTIVATE)

    set_domain(monkeypatch, 42)
    with benched(tmp_path, prepare=start) as bench, ros_node("operator") as operator:
        moving = bench.begin_slowly(GOAL)
        assert change(operator, DEACTIVATE)
        report = bench.execution(moving)
        assert report["outcome"] == "stopped"
        assert np.abs(bench.position - GOAL).max() > 0.1
        answer, hold = bench.client.stop()
        assert answer.success, answer.message
        assert hold is not None


def test_transition_that_is_not_possible_is_answered_and_changes_nothing(manager: Node) -> None:
    for number in range(256):
        if number not in (CONFIGURE, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN):
            assert not change(manager, number), number
    assert state(manager) == "unconfigured"


def test_managed_node_plans_when_it_is_active_only(manager: Node, tmp_path: Path) -> None:
    with NodeClient() as client:
        client.wait_for_node()
        client.publish_description(URDF)

        def refusal() -> str:
            answer = client.send(goal_message())
            assert answer.trajectory is None
            assert answer.values["status"] == "refused"
            return answer.report.message

        def serves() -> bool:
            client.publish_state(JOINTS, START)
            client.wait_for_diagnostics(lambda values: values["joint_states_age_s"] != "none")
            return client.send(goal_message()).trajectory is not None

        assert not change(manager, CONFIGURE), "there is no primitive file"
        assert state(manager) == "unconfigured"
        save_primitive(arm_primitive(), tmp_path / "arm.npz")
        assert change(manager, CONFIGURE)
        assert "the node is not active" in refusal()
        answer, stopping = client.stop()
        assert not answer.success
        assert stopping is None
        assert change(manager, ACTIVATE)
        assert serves()
        assert change(manager, DEACTIVATE)
        assert "the node is not active" in refusal()
        assert change(manager, CLEAN_UP)
        assert state(manager) == "unconfigured"
        assert client.wait_for_diagnostics()["library"] == "none"
        assert change(manager, CONFIGURE)
        assert change(manager, ACTIVATE)
        assert serves()
