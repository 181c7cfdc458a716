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
        (["elbow"], "name=value"),
        (["0.1,elbow"], "name=value,… or a list"),
        (["elbow=x"], "'x', not a number"),
        (["elbow=nan"], "finite"),
        (["elbow=1,elbow=2"], "more than once"),
        ([""], "name=value"),
        (["elbow=1@soon"], "not a number from"),
        (["elbow=1@-1"], "not a number from"),
        (["elbow=1@1", "--via", "elbow=2@2"], "increase"),
        (["elbow=1", "--via", "shoulder=2"], "no joint of the goal is called 'shoulder'"),
        (["elbow=1,wrist=2", "--via", "elbow=2"], "lacks 'wrist'"),
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


@pytest.mark.parametrize("option", [("--namespace", "left arm"), ("--node", "a-b")])
def test_names_that_no_node_can_have_are_refused_in_one_line(
    option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["send_goal", "elbow=1", *option]) == 2
    output = capsys.readouterr().err
    assert output.count("\n") == 1
    assert "no node can be called" in output and option[1] in output


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


def test_a_client_does_not_appear_as_the_robot() -> None:
    from mp_pca_planner.ros.client import GoalClient

    with GoalClient(namespace="alone") as client:
        for topic in ("joint_states", "robot_description"):
            assert client.node.count_publishers(f"/alone/{topic}") == 0
        assert client.node.count_publishers("/alone/mp_pca_planner/goal") == 1
