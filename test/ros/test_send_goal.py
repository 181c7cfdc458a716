# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command that sends goals; with a node it is run by test_planner_node.py."""

from __future__ import annotations

import pytest

from mp_pca_planner.cli.main import main

pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["0.1,elbow"], "name=value,… or a list"),
        (["elbow=x"], "'x', not a number"),
        (["elbow=1,elbow=2"], "more than once"),
        (["elbow=1@soon"], "not a number from"),
        (["elbow=1@1", "--via", "elbow=2@2"], "increase"),
        (["elbow=1", "--via", "shoulder=2"], "no joint of the goal is called 'shoulder'"),
        (["elbow=1", "--via", "hand: 0.1 0 0"], "'hand: 0.1 0 0' is a pose, but the node takes"),
        (["elbow=1", "--node", "a-b"], "no node can be called '/a-b'"),
        (["--pose", "0.5 0.2"], "a position has 3 (x y z) and a pose 7"),
    ],
)
def test_goal_that_is_no_goal_is_refused_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["send_goal", *arguments]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert words in output.err


def test_a_node_without_a_robot_is_asked_for_the_driver() -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    from mp_pca_planner.ros.client import GoalClient, NoAnswerError

    with GoalClient(namespace="alone") as client:
        for text, is_alone in (
            ("waiting for joint_states", True),
            ("waiting for a robot description: nothing has arrived", True),
            ("no primitives are loaded", False),
        ):
            client.diagnostics.append(DiagnosticArray(status=[DiagnosticStatus(message=text)]))
            with pytest.raises(NoAnswerError) as found:
                client.wait_for_diagnostics(timeout=0.0)
            assert f"is not ready ({text}" in str(found.value)
            assert ("'mp-pca simulate', running?" in str(found.value)) == is_alone
