# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options that mean nothing beside the others are refused, not ignored."""

from pathlib import Path

import pytest
from support.arm import arm_primitive
from support.commands import refusal

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import save_primitive

URDF = config_file("human_arm.urdf")
START, GOAL = "-0.2,0.1,0.5,-0.4", "elbow=-0.9"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("primitive") / "arm.npz"
    save_primitive(arm_primitive(), path)
    return [str(path), "--robot", str(URDF)]


def test_frame_is_refused_where_no_link_is_concerned(files: list[str]) -> None:
    ends = ("--start", START, "--goal", GOAL)
    for command in ("plan", "refine", "verify"):
        assert "--frame is for --goal-pose" in refusal(command, *files, *ends, "--frame", "nope")
    straight = ("--objective", "effort=1,straightness=1")
    assert "no link is called 'nope'" in refusal("plan", *files, *ends, *straight, "--frame=nope")


def test_teach_needs_a_robot_for_a_frame(tmp_path: Path) -> None:
    output = tmp_path / "taught.npz"
    assert "--frame names a link of --robot" in refusal(
        "teach", "--output", output, "--frame", "wrist"
    )
    assert "no link is called 'nope'" in refusal(
        "teach", "--output", output, "--frame", "nope", "--robot", URDF
    )


def test_existing_file_is_refused_in_words_for_commands_and_python(
    files: list[str], tmp_path: Path
) -> None:
    output = tmp_path / "motion.csv"
    output.write_text("kept")
    line = refusal("plan", *files, "--start", START, "--goal", GOAL, "--output", output)
    assert "--force, in Python overwrite=True" in line
    assert output.read_text() == "kept"
