# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `example`: files of a robot that the other commands take as they are."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line

import mp_pca_planner as mp
from mp_pca_planner.cli.example import FILES


@pytest.fixture(scope="module", params=["human_arm", "panda"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "panda":
        pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")
    path = tmp_path_factory.mktemp(request.param)
    facts = command_line.result("example", request.param, "--motions", 10, "--output", path)
    assert sorted(path.iterdir()) == sorted(map(Path, facts["files"]))
    assert sorted(Path(file).name for file in facts["files"]) == sorted(FILES)
    return path


def test_the_recording_holds_motions_of_the_arm_within_its_limits(folder: Path) -> None:
    found = mp.load_demonstrations(folder / "session.mcap", robot=folder / "arm.urdf")
    assert 18 <= len(found) <= 20  # ten reaches, and the ways back
    assert all("limit" not in note for report in found.reports for note in report.notes)
    names = found[0].joint_names
    assert len(names) in (4, 7) and not any("finger" in name for name in names)
    robot = mp.Robot.from_file(folder / "arm.urdf", names)
    limits = robot.limits(folder / "limits.yaml")
    assert np.isfinite([limits.velocity, limits.acceleration, limits.jerk]).all()


def test_the_ball_is_in_the_way_and_the_planner_goes_around_it(folder: Path) -> None:
    found = mp.load_demonstrations(folder / "session.mcap", robot=folder / "arm.urdf")
    reach = mp.MovementPrimitive.fit(found)
    robot = mp.Robot.from_file(folder / "arm.urdf", reach.joint_names)
    world = mp.World.from_file(folder / "scene.yaml")
    start, goal = [0.0, 0.0, 0.6, -0.3], [-1.5, 0.0, 0.6, -0.6]
    if robot.n_joints == 7:
        start = np.deg2rad([-58, 27, 50, -99, 42, 168, -42])
        goal = np.deg2rad([0, 0, 50, -60, -60, 78, 42])
    options = mp.PlannerOptions(max_solve_time=np.inf)
    limits = robot.limits(folder / "limits.yaml")
    planner = mp.Planner(robot, reach, limits, options, world=world)
    assert planner.collision.collisions(reach.predict(start, goal))
    plan = planner.plan(start=start, goal=goal)
    assert plan.is_executable
    assert not planner.collision.collisions(plan.trajectory)


def test_files_that_are_there_stay(folder: Path) -> None:
    robot = "panda" if "panda" in folder.name else "human_arm"
    assert "exists already" in command_line.refusal("example", robot, "--output", folder)
