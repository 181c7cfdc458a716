# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A robot whose primitive moves the arm alone: the gripper counts where it is."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    GRIPPER_URDF,
    PATIENCE,
    START,
    NodeClient,
    goal_message,
    running_node,
    words,
)

from mp_pca_planner.primitives.file import save_primitive


@pytest.mark.slow
def test_finger_with_a_mass_is_locked_where_it_is_measured_or_goals_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    massive = (
        '<link name="finger_link"><inertial><mass value="0.3"/><inertia ixx="1e-4" iyy="1e-4" '
        'izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    set_domain(monkeypatch, 33)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    arguments = words(primitives=[str(tmp_path / "arm.npz")], **PATIENCE)
    with running_node(tmp_path / "log.txt", *arguments), NodeClient() as client:
        client.wait_for_node()
        client.publish_description(GRIPPER_URDF.replace('<link name="finger_link"/>', massive))
        client.wait_for_model()
        client.publish_state(JOINTS, START)
        client.wait_for_diagnostics(lambda values: "'finger' are not known" in values["text"])
        answer = client.send(goal_message(GOAL))
        assert answer.trajectory is None
        assert "joints 'finger' are not known" in answer.report.message
        for position in (0.01, 0.03):
            client.publish_state(("finger", *JOINTS), [position, *START])
            answer = client.send(goal_message(GOAL))
            assert answer.trajectory is not None, answer.report.message
            assert client.wait_for_diagnostics()["locked_joints"] == f"finger={position}"
        # From another publisher, while the states of the arm come without it.
        client.publish_state(("finger",), [0.02])
        client.publish_state(JOINTS, START)
        answer = client.send(goal_message(GOAL))
        assert answer.trajectory is not None, answer.report.message
        assert client.wait_for_diagnostics()["locked_joints"] == "finger=0.02"
