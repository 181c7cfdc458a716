# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command that sends goals; with a node it is run by test_planner_node.py."""

from __future__ import annotations

import pytest

from mp_pca_planner.cli.send_goal import main


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["elbow"], "name=value"),
        (["elbow=x"], "'x', not a number"),
        (["elbow=nan"], "finite"),
        (["elbow=1,elbow=2"], "more than once"),
        ([""], "name=value"),
        (["elbow=1@soon"], "number of seconds"),
        (["elbow=1@-1"], "positive"),
        (["elbow=1@1", "--via", "elbow=2@2"], "increase"),
        (["elbow=1", "--via", "shoulder=2"], "no joint of the goal is called 'shoulder'"),
        (["elbow=1,wrist=2", "--via", "elbow=2"], "lacks 'wrist'"),
        (
            ["elbow=1", "--namespace", "left arm"],
            "no node can be called '/left arm/mp_pca_planner'",
        ),
        (["elbow=1", "--node", "a-b"], "no node can be called '/a-b'"),
    ],
)
def test_goal_that_is_no_goal_is_refused_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert words in output.err
