# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands: their help, and the library's choices and defaults."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.arm import arm_primitive, arm_robot
from support.commands import refusal

from mp_pca_planner.cli.goal_arguments import planned_goal
from mp_pca_planner.cli.main import COMMANDS, main, parse
from mp_pca_planner.cli.terminal import UsageError
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import SequenceGoal

OF_ROS = {"planner_node", "simulate", "send_goal", "stop", "call", "demo"}
MAX_LINES = 60
GOAL_OF_PLAN = ("plan", "FILE", "--robot", "URDF", "--start", "0")
GOAL = (*GOAL_OF_PLAN[1:], "--goal", "0")


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"planner_node"}))
def test_every_command_has_a_help_of_one_page(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in OF_ROS:
        pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as ending:
        main(["help", name])
    assert ending.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith(f"usage: mp-pca {name} ")
    assert "(default: None)" not in text
    assert len(text.splitlines()) <= MAX_LINES


def test_sequence_is_another_name_of_plan() -> None:
    words = [*GOAL[:-1], "-1,1", "--via", "2@0.5", "--stop=3", "--via", "-4"]
    plan, sequence = parse("plan", words), parse("sequence", words)
    assert plan.via == ["2@0.5", "3", "-4"] and plan.goal == "-1,1"
    assert vars(plan) | {"command": "sequence"} == vars(sequence)


def test_each_target_of_a_sequence_has_its_time_and_its_stop() -> None:
    vias = ["--via", "elbow=-0.5@0.5", "--stop", "elbow=-0.7"]
    for goal, last in (["elbow=-1@2"], 2.0), (["elbow=-1", "--duration", "3"], 3.0):
        options = parse("plan", [*GOAL_OF_PLAN, *vias, "--goal", *goal])
        found = planned_goal(options, arm_robot())
        assert isinstance(found, SequenceGoal)
        assert (found.times, found.stops) == ((0.5, None, last), (False, True, False))


def test_arguments_for_ros_are_passed_on_as_they_are() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    ros = ["--ros-args", "-p", "delay:=0.1", "--", "--rate", "3"]
    options = parse("simulate", ["--robot", "arm.urdf", "--rate", "2", *ros])
    assert (options.rate, options.ros_arguments) == (2, ros)
    with pytest.raises(UsageError):
        parse("inspect", ["BAG", *ros])


def test_goals_of_the_node_are_positional_or_options() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")
    for words in (["-0.1,0.2"], ["--goal", "-0.1,0.2"], ["--goal=-0.1,0.2"]):
        assert parse("send_goal", words).goal == "-0.1,0.2"
    old, new = (parse("send_goal", [name, "0 0 0"]) for name in ("--pose", "--goal-pose"))
    assert old == new
    for words in ([], ["0.1", "--goal", "0.2"], ["0.1", "--goal-pose", "0 0 0"]):
        with pytest.raises(UsageError):
            parse("send_goal", words)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([*GOAL_OF_PLAN, "--goal-pose", "0.1", "0.5", "-4e-1"], "put quotes around the numbers"),
        ([*GOAL_OF_PLAN, "--goal", "0", "--duration", "601"], "a number from 0.001 to 600 s"),
        ([*GOAL_OF_PLAN[:4], "--strat", "0"], "no option --strat (did you mean --start?)"),
        ([*GOAL_OF_PLAN], "the arguments --goal --goal-pose is required"),
        (["plan", "FILE"], "required: --robot, --start, --goal or --goal-pose"),
        (["plan", "FILE", "--goal-pose", "0.4 0.1 0.6"], "plan: the following arguments are"),
        (["send_obstacles", "1", "2"], "put quotes around the numbers"),
        (["view", "--robot", "arm.urdf"], "pass primitive files and --robot URDF"),
    ],
)
def test_slips_of_the_hand_are_named(words: list[str], sentence: str) -> None:
    assert sentence in refusal(*words)


def test_a_primitive_of_another_robot_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    primitive, urdf = tmp_path / "reach.npz", tmp_path / "other.urdf"
    arm_primitive().save(primitive)
    urdf.write_text(config_file("human_arm.urdf").read_text().replace("elbow", "knee"))
    for command, *options in (["plan", *GOAL[3:]], ["view"]):
        assert main([command, str(primitive), "--robot", str(urdf), *options]) == 2
        said = capsys.readouterr().err
        assert "was learned for another robot: its joints 'elbow' are not in" in said
        assert "which has 'shoulder1'" in said


@pytest.mark.parametrize(
    ("typed", "offered"), [("mp-pca vi", {"view"}), ("mp-pca plan --nat", {"--naturalness"})]
)
def test_a_shell_completes_commands_and_options(
    typed: str, offered: set[str], tmp_path: Path
) -> None:
    found = tmp_path / "completions"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(found),
        "COMP_LINE": typed,
        "COMP_POINT": str(len(typed)),
    }
    command = [sys.executable, "-m", "mp_pca_planner"]
    subprocess.run(command, env={**os.environ, **asked}, check=True, timeout=60)
    assert set(found.read_text().split("\v")[0].split()) == offered
