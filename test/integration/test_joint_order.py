# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Lists of values mean the joints of the robot description, whatever order a primitive has."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.arm import JOINTS, arm_demonstrations

from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.model import Robot

URDF = config_file("human_arm.urdf")
START, GOAL = "-0.2,0.1,0.5,-0.4", "-1.2,0.1,0.5,-0.9"
START_BY_NAME = "shoulder1=-0.2, shoulder2=0.1, shoulder3=0.5, elbow=-0.4"
GOAL_BY_NAME = "shoulder1=-1.2, shoulder2=0.1, shoulder3=0.5, elbow=-0.9"

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def reversed_primitive(tmp_path_factory: pytest.TempPathFactory) -> str:
    """File of a primitive whose joints are in reverse order, as in a bag without a robot."""
    motions = [
        replace(motion, joint_names=motion.joint_names[::-1], positions=motion.positions[:, ::-1])
        for motion in arm_demonstrations()
    ]
    primitive = build_primitive(motions, "reach", PrimitiveOptions(n_components=4))
    assert primitive.joint_names == JOINTS[::-1]
    path = tmp_path_factory.mktemp("order") / "reach.npz"
    save_primitive(primitive, path)
    return str(path)


@pytest.fixture
def run(reversed_primitive: str, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command on that primitive; returns what it prints."""

    def run_command(command: str, *options: str) -> str:
        assert main([command, reversed_primitive, "--robot", str(URDF), *options]) == 0
        return capsys.readouterr().out

    return run_command


@pytest.mark.parametrize("command", ["sequence", "refine"])
def test_lists_follow_the_robot_description_and_not_the_primitive(command: str, run: Run) -> None:
    by_list = json.loads(run(command, "--start", START, "--goal", GOAL, "--json"))
    by_name = json.loads(run(command, "--start", START_BY_NAME, "--goal", GOAL_BY_NAME, "--json"))
    assert by_list["joint_names"] == list(JOINTS[::-1])
    assert by_list["positions"] == by_name["positions"]
    assert by_list["positions"][0] == [-0.4, 0.5, 0.1, -0.2]
    assert by_list["start"] == dict(zip(JOINTS, [-0.2, 0.1, 0.5, -0.4], strict=True))
    assert by_list["goal"] == dict(zip(JOINTS, [-1.2, 0.1, 0.5, -0.9], strict=True))
    hand, robot = by_list["end_effector"], Robot.from_file(URDF, JOINTS)
    q = np.array([[by_list[end][name] for name in JOINTS] for end in ("start", "goal")])
    expected = robot.frame_positions(q, [robot.end_effector])[:, 0]
    assert hand["frame"] == robot.end_effector
    np.testing.assert_allclose([hand["start"], hand["goal"]], expected, atol=1e-6)


@pytest.mark.parametrize("command", ["plan", "refine"])
def test_degrees_are_read(command: str, run: Run) -> None:
    start, goal, via = "-10,5,30,-20", "shoulder1=-60,elbow=-50", "shoulder1=-30,elbow=-30"
    given = ("--start", start, "--goal", goal, "--via", via)
    facts = json.loads(run(command, *given, "--degrees", "--json"))
    expected = {"shoulder1": -60.0, "shoulder2": 5.0, "shoulder3": 30.0, "elbow": -50.0}
    assert facts["goal"] == pytest.approx({n: math.radians(x) for n, x in expected.items()})
    assert facts["vias"][0]["elbow"] == pytest.approx(math.radians(-30.0), abs=1e-6)
