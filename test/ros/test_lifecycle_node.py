# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner as a managed node: what it does in each state, and from one to the next."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    PATIENTLY,
    START,
    URDF,
    NodeClient,
    call,
    goal_message,
    ros_node,
    running_node,
)
from support.patience import HANG

from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow

CONFIGURE, ACTIVATE, DEACTIVATE, CLEAN_UP = (
    Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
    Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP,
)


def change(manager: Node, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return call(manager, ChangeState, "mp_pca_planner/change_state", request).success


def state(manager: Node) -> str:
    request = GetState.Request()
    return call(manager, GetState, "mp_pca_planner/get_state", request).current_state.label


def test_managed_node_plans_when_it_is_active_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 41)
    file = tmp_path / "arm.npz"
    arguments = ("-p", f"primitives:=['{file}']", *PATIENTLY)
    with (
        running_node(tmp_path / "log.txt", *arguments, options=["--managed"]),
        ros_node("manager") as manager,
        NodeClient() as client,
    ):
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

        assert not change(manager, ACTIVATE), "it is not configured"
        assert not change(manager, CONFIGURE), "there is no primitive file"
        assert state(manager) == "unconfigured"
        save_primitive(arm_primitive(), file)
        assert change(manager, CONFIGURE)
        assert "the node is not active" in refusal()
        answer, _ = client.stop()
        assert not answer.success
        assert change(manager, ACTIVATE)
        assert serves()
        n = len(client.trajectories)
        assert change(manager, DEACTIVATE)
        assert client.next_trajectory(n, HANG) is not None  # the motion is stopped
        assert "the node is not active" in refusal()
        assert client.stop()[0].success
        assert change(manager, CLEAN_UP)
        assert state(manager) == "unconfigured"
        assert client.wait_for_diagnostics()["library"] == "none"
        assert change(manager, CONFIGURE)
        assert change(manager, ACTIVATE)
        assert serves()
