# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The running node in the words of the page."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot

from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.view.content import SILENCE, LiveView, NodeStatus

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view.live_panel import figures_html, node_html, reports_html, states_html
from mp_pca_planner.view.stage import BAD, GOOD, WARNING

NOW = 1000.0
HOSTILE = "<b>\x1b[31m\u202e"


def status(level: int = 0, message: str = "ready", age: float = 1.0, **values: str) -> NodeStatus:
    return NodeStatus(level, message, values, NOW - age)


def test_a_node_is_not_there_yet_then_runs_then_is_gone():
    assert "No node yet" in node_html(LiveView(), NOW)
    running = node_html(LiveView(diagnostics=status()), NOW)
    assert "ready" in running and GOOD in running
    gone = node_html(LiveView(diagnostics=status(age=2.0 * SILENCE)), NOW)
    assert "The node is gone" in gone and BAD in gone


def test_reports_are_shown_with_their_level_and_figures():
    view = LiveView(
        goal=("elbow -0.600", NOW - 7.0),
        report=status(2, "outside the limits", effort_cost="12.3456", goal_error="nan"),
        execution=status(1, "stopped", outcome="stopped"),
    )
    shown = reports_html(view, NOW)
    for text in ("elbow -0.600 (7 s ago)", "outside the limits", "12.35", BAD, WARNING, "stopped"):
        assert text in shown
    assert "goal_error" not in shown
    assert "none yet" in reports_html(LiveView(), NOW)


def test_joint_states_are_shown_within_their_limits():
    limits = JointLimits(["a"], {"a": {"min_position": -1.0, "max_position": 1.0}})
    states = {"a": (0.5, np.nan, NOW), "free": (7.0, 0.25, NOW - 1.0)}
    shown = states_html(LiveView(states), limits, NOW)
    first, second = shown.split("<tr")[2:]
    assert "75%" in first and BAD not in first and "old" not in first
    assert "0.250" in second and "1.0 s old" in second and "%" not in second
    outside = states_html(LiveView({"a": (2.0, 0.0, NOW)}), limits, NOW)
    assert BAD in outside and "100%" in outside


def test_text_from_topics_is_no_markup():
    hostile = NodeStatus(9, HOSTILE, {HOSTILE: HOSTILE, "primitive": HOSTILE}, NOW)
    view = LiveView({HOSTILE: (0.0, 0.0, NOW)}, (HOSTILE, NOW), hostile, hostile, hostile)
    shown = [node_html(view, NOW), reports_html(view, NOW), figures_html(view)]
    shown.append(states_html(view, arm_robot().limits(), NOW))
    for html in shown:
        assert "<b>\\" not in html and "\x1b" not in html and "\u202e" not in html
        assert "&lt;b&gt;" in html


def test_a_configuration_is_known_when_all_joints_are():
    states = {name: (0.1 * i, 0.0, NOW) for i, name in enumerate(JOINTS)}
    found = LiveView(states).configuration(JOINTS)
    np.testing.assert_allclose(found, 0.1 * np.arange(len(JOINTS)))
    assert LiveView({}).configuration(JOINTS) is None
    assert LiveView({**states, JOINTS[0]: (np.nan, 0.0, NOW)}).configuration(JOINTS) is None
