# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands: help without heavy imports, and the library's choices and defaults."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mp_pca_planner.cli.main import COMMANDS, parse
from mp_pca_planner.control.closed_loop import ErrorModel
from mp_pca_planner.control.law import KINDS
from mp_pca_planner.evaluation.problems import EXAMPLE_ROBOTS
from mp_pca_planner.evaluation.run import PEERS
from mp_pca_planner.input_limits import INPUT_LIMITS
from mp_pca_planner.planning.objectives import OBJECTIVES
from mp_pca_planner.planning.options import MOST_STARTS
from mp_pca_planner.planning.plan import BASES, MODES, PlannerOptions
from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.primitive import COUPLINGS
from mp_pca_planner.primitives.timing import ALIGNMENTS
from mp_pca_planner.recordings.repair.recording import GAP_PERIODS, GAP_TIME
from mp_pca_planner.recordings.segmentation import SegmentationOptions

OFFLINE = [name for name in COMMANDS if name != "planner_node"]
GOAL = ("FILE", "--robot", "URDF", "--start", "0", "--goal", "0")


@pytest.fixture
def helps(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Help of every command, on one line."""
    monkeypatch.setenv("COLUMNS", "1000")
    texts = {}
    for name in OFFLINE:
        with pytest.raises(SystemExit):
            parse(name, ["--help-all"])
        texts[name] = " ".join(capsys.readouterr().out.split())
    return texts


def test_help_of_every_command_loads_no_heavy_library() -> None:
    code = f"""
import sys
from mp_pca_planner.cli.main import main
for name in {OFFLINE}:
    try:
        main([name, "--help"])
    except SystemExit as ending:
        assert ending.code == 0
heavy = {{"numpy", "scipy", "pinocchio", "matplotlib", "rclpy", "rosbags"}} & set(sys.modules)
sys.exit(f"loaded: {{heavy}}" if heavy else 0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("usage: mp-pca") == len(OFFLINE)


def test_choices_are_those_of_the_library(helps: dict[str, str]) -> None:
    for command, choices in (
        ("plan", BASES),
        ("sequence", MODES),
        ("verify", KINDS),
        ("build_primitives", COUPLINGS),
        ("build_primitives", ALIGNMENTS),
    ):
        assert f"{{{','.join(choices)}}}" in helps[command]
    assert f"(default: {KINDS[0]})" in helps["verify"]
    assert ", ".join(OBJECTIVES) in helps["plan"]
    assert ", ".join(PEERS) in helps["benchmark"]
    assert ", ".join(EXAMPLE_ROBOTS) in helps["benchmark"]


@pytest.mark.parametrize("name", OFFLINE)
def test_usual_help_leaves_out_the_options_for_experts(
    name: str, helps: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parse(name, ["--help"])
    usual = set(re.findall(r"--[\w-]+", capsys.readouterr().out))
    everyday, _, experts = helps[name].partition(" expert options: ")
    of_experts = set(re.findall(r"(--[\w-]+)[ ,]", experts)) - usual
    assert {"--help", "--help-all"} < usual
    assert bool(of_experts) == bool(experts)
    assert usual <= set(re.findall(r"--[\w-]+", everyday))


@pytest.mark.parametrize("extra", [[], ["--start", "0"], ["--gaol=1"]])
def test_unknown_options_get_a_suggestion(
    extra: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        parse("plan", ["FILE", *extra, "--gaol", "1"])
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mp-pca plan: ")
    assert "no option is called '--gaol' (did you mean '--goal'?)" in line


def defaults(options: argparse.Namespace, *names: str) -> list[object]:
    return [getattr(options, name) for name in names]


def test_goals_of_a_sequence_are_passed_in_their_order_and_the_last_one_ends_it() -> None:
    words = ["--goal", "-1,1", "--via", "2", "--stop=3", "--goal=4", "--goal", "5"]
    found = parse("sequence", [*GOAL[:-1], "0.5", *words])
    assert found.goal == "5"
    assert [str(via) for via in found.via] == ["0.5", "-1,1", "2", "3", "4"]


def test_a_second_goal_does_not_silently_replace_the_first(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ending:
        parse("plan", [*GOAL, "--goal=1"])
    assert ending.value.code == 2
    said = capsys.readouterr().err
    assert "--goal is given 2 times; pass places on the way with --via" in said


def test_defaults_are_those_of_the_library(helps: dict[str, str]) -> None:
    planning, errors = PlannerOptions(), ErrorModel()
    found = defaults(parse("plan", GOAL), "basis", "naturalness", "sample_period", "starts")
    assert found == [planning.basis, planning.naturalness, planning.sample_period, MOST_STARTS]
    found = defaults(parse("verify", GOAL), "inertia_error", "payload", "start_error")
    assert found == [errors.inertia, errors.payload, errors.position]
    building = PrimitiveOptions()
    options = parse("build_primitives", ["BAG", "--output", "p.npz"])
    found = defaults(options, "coupling", "variance", "phases", "degree", "align")
    assert found == [
        *(building.coupling, building.variance, building.n_phases),
        *(building.degree, building.align),
    ]
    cutting = SegmentationOptions()
    for default in (
        f"{cutting.min_rest}",
        f"{cutting.min_duration}",
        f"{GAP_TIME}, or {GAP_PERIODS} usual periods",
    ):
        assert f"(default: {default})" in helps["build_primitives"]


def test_longest_duration_and_most_starts_are_those_of_the_library() -> None:
    longest = INPUT_LIMITS.duration
    most = ("--duration", f"{longest}", "--starts", f"{MOST_STARTS}")
    assert parse("plan", [*GOAL, *most]).duration == longest
    for more in (("--duration", f"{1.01 * longest}"), ("--starts", f"{MOST_STARTS + 1}")):
        with pytest.raises(SystemExit):
            parse("plan", [*GOAL, *more])


@pytest.mark.parametrize(
    ("command", "arguments", "old", "new"),
    [
        ("build_primitives", ["BAG", "--output", "p.npz"], ["--salvage"], ["--recover"]),
        ("inspect", ["BAG"], ["--salvage"], ["--recover"]),
        ("plan", GOAL, ["--use", "reach"], ["--primitive", "reach"]),
    ],
)
def test_old_names_of_options_keep_working(
    command: str, arguments: list[str], old: list[str], new: list[str]
) -> None:
    assert parse(command, [*arguments, *old]) == parse(command, [*arguments, *new])
    assert parse(command, [*arguments, *new]) != parse(command, arguments)


def test_arguments_for_ros_are_passed_on_as_they_are() -> None:
    ros = ["--ros-args", "-p", "delay:=0.1", "--", "--seed", "3"]
    options = parse("simulate", ["--robot", "arm.urdf", "--seed", "2", *ros])
    assert (options.seed, options.ros_arguments) == (2, ros)
    with pytest.raises(SystemExit):
        parse("inspect", ["BAG", *ros])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("mp-pca pl", {"plan", "planner_node"}),
        ("mp-pca plan --ba", {"--basis"}),
        ("mp-pca plan --basis b", {"bspline"}),
        ("mp-pca benchmark --rob", {"--robot"}),
    ],
)
def test_the_shell_completes_commands_options_and_choices(
    line: str, expected: set[str], tmp_path: Path
) -> None:
    pytest.importorskip("argcomplete", reason="argcomplete (extra 'completion') is not installed")
    output = tmp_path / "completions"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(output),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    command = [sys.executable, "-m", "mp_pca_planner"]
    done = subprocess.run(command, env=os.environ | asked, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert set(output.read_text(encoding="utf-8").split()) == expected
