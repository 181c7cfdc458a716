# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

import re

import numpy as np
import pytest
from support.obstacle_scenes import write_request, write_scene

from mp_pca_planner.evaluation.problems import robot_of_scene, scene_problem, scenes_in
from mp_pca_planner.exceptions import PlannerError

JOINTS = ("one", "two")


@pytest.fixture
def folder(tmp_path):
    for group in ("easy", "hard"):
        place = tmp_path / "problems" / group
        place.mkdir(parents=True)
        for i in range(1, 6):
            write_scene(place / f"scene{i:04d}.yaml", [], "crane")
            write_request(place / f"request{i:04d}.yaml", JOINTS, [0.1 * i, 0.2], [0.3, -0.1 * i])
    return tmp_path


def test_scenes_are_spread_over_each_group(folder):
    found = scenes_in(folder, 3)
    assert [(one.parent.name, one.stem) for one in found] == [
        (group, f"scene000{n}") for group in ("easy", "hard") for n in (1, 3, 5)
    ]


def test_ends_are_in_the_order_of_the_joints(folder):
    scene = scenes_in(folder / "problems" / "easy", 5)[1]
    problem = scene_problem(scene, ["two", "one"])
    np.testing.assert_allclose(problem.start, [0.2, 0.2])
    np.testing.assert_allclose(problem.goal, [-0.2, 0.3])


def test_missing_joint_is_named(folder):
    with pytest.raises(PlannerError, match="has no start position of joint 'three'"):
        scene_problem(scenes_in(folder, 1)[0], ["one", "three"])


def test_robot_is_found_above_the_problems(folder):
    scene = scenes_in(folder, 1)[0]
    with pytest.raises(PlannerError, match=re.escape("no 'crane.urdf'")):
        robot_of_scene(scene)
    urdf = folder / "crane" / "crane.urdf"
    urdf.parent.mkdir()
    urdf.touch()
    assert robot_of_scene(scene) == urdf.resolve()


def test_folder_without_problems_is_rejected(tmp_path):
    with pytest.raises(PlannerError, match="no problems in"):
        scenes_in(tmp_path, 3)


@pytest.mark.parametrize(
    "text", ["", "start_state: {}", "[1, 2]", "start_state: {joint_state: {name: [a]}}"]
)
def test_malformed_request_is_rejected_by_name(folder, text):
    path = folder / "problems" / "easy" / "request0001.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PlannerError, match="request0001.yaml' can't be read"):
        scene_problem(scenes_in(folder, 1)[0], ["one"])
