# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `benchmark --scenes`."""

import json

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive
from support.obstacle_scenes import SCENES, write_request, write_scene
from support.patience import EVER

from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import save_primitive

POST = ("post", "box", [0.04, 0.04, 1.2], [0.384, -0.399, 0.14])
FAR = ("far", "sphere", [0.1], [3.0, 0.0, 0.0])


def benchmark(capsys, *options: str) -> dict:
    assert main(["benchmark", *options, "--time-limit", str(EVER), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def scenes(tmp_path):
    """One problem with a post in the way and one without, and the primitive to use."""
    (tmp_path / "human_arm.urdf").write_bytes(config_file("human_arm.urdf").read_bytes())
    folder, primitive = tmp_path / "posts", arm_primitive()
    folder.mkdir()
    start, goal = primitive.boundary_states[0, [0, 3]]
    for number, obstacle in (("0001", POST), ("0002", FAR)):
        write_scene(folder / f"scene{number}.yaml", [obstacle], "human_arm")
        write_request(folder / f"request{number}.yaml", JOINTS, start, goal)
    save_primitive(primitive, tmp_path / "arm.npz")
    return tmp_path


def test_planner_solves_problems_by_the_referee(capsys, scenes):
    options = ["--scenes", str(scenes), "--primitives", str(scenes / "arm.npz"), "--peers", "none"]
    facts = benchmark(capsys, *options)
    assert facts["n_problems"] == 2
    around, free = facts["problems"]
    for found in (around["pca"], free["pca"]):
        assert found["solved"] and found["feasible"]
        assert found["collision"] == ""
        assert found["clearance"] > 0.0
    assert free["pca"]["clearance"] > 1.0
    assert around["pca"]["path_length"] > free["pca"]["path_length"]
    summary = facts["summary"]["posts"]["pca"]
    assert summary["solved_share"] == 1.0
    assert summary["n_collisions"] == 0
    paths = [around["pca"]["path_length"], free["pca"]["path_length"]]
    assert summary["path_length"] == pytest.approx(np.median(paths))


def test_table_names_methods_and_missing_peers(capsys, scenes):
    options = ["--primitives", str(scenes / "arm.npz"), "--problems", "1", "--time-limit", "0.1"]
    assert main(["benchmark", "--scenes", str(scenes), *options]) == 0
    printed = capsys.readouterr().out
    assert "1 problems of 'human_arm', 4 joints, within 0.1 s" in printed
    assert "solved [%]" in printed
    assert "ompl_toppra" in printed  # in the table, or absent with a reason
    assert "vamp_toppra is absent: " in printed  # missing, or without this robot
    assert "roboplan" in printed
    assert "pca_default: " in printed and "timing 'auto' (default), within 0.1 s" in printed
    assert "pca_shortest: " in printed and "timing 'shortest', within 0.1 s" in printed


def test_roboplan_reaches_the_goals(capsys, scenes):
    pytest.importorskip("roboplan.core", reason="the extra 'roboplan' is not installed")
    options = ["--scenes", str(scenes), "--primitives", str(scenes / "arm.npz")]
    facts = benchmark(capsys, *options, "--peers", "roboplan")
    for problem in facts["problems"]:
        found = problem["roboplan"]
        assert found["status"] == "solved" and found["end_error"] < 1e-3
        assert 0.0 < found["path_time_s"] < found["solve_time_s"]


def test_ratios_to_ompl_are_those_of_problems_that_both_solve(capsys, scenes):
    for module, extra in (("ompl", "ompl"), ("toppra", "peers")):
        pytest.importorskip(module, reason=f"the extra '{extra}' is not installed")
    options = ["--scenes", str(scenes), "--primitives", str(scenes / "arm.npz")]
    facts = benchmark(capsys, *options, "--peers", "ompl_toppra")
    summary = facts["summary"]["posts"]
    both = [
        (found["pca_default"], found["ompl_toppra"])
        for found in facts["problems"]
        if found["pca_default"].get("solved") and found["ompl_toppra"].get("solved")
    ]
    assert both
    for fact in ("effort_cost", "duration"):
        expected = np.median([one[fact] / other[fact] for one, other in both])
        assert summary["pca_default"][f"{fact}_over_ompl_toppra"] == pytest.approx(expected)
        assert summary["ompl_toppra"][f"{fact}_over_ompl_toppra"] == 1.0


def test_unknown_peer_is_refused(capsys, scenes):
    assert main(["benchmark", "--scenes", str(scenes), "--peers", "drake"]) == 2
    assert "no peer is called 'drake'" in capsys.readouterr().err


def test_options_of_other_problems_are_refused(capsys, scenes):
    assert main(["benchmark", "--scenes", str(scenes), "--random-ends"]) == 2
    assert "--random-ends are not accepted with --scenes" in capsys.readouterr().err


@pytest.mark.skipif(not SCENES.is_dir(), reason=f"no problems in {SCENES}")
@pytest.mark.parametrize("group", ["table_pick_panda", "bookshelf_small_panda"])
def test_problems_of_motion_bench_maker_are_solved(capsys, group):
    pytest.importorskip("ompl", reason="the extra ompl is not installed")
    folder = SCENES / "problems" / group
    facts = benchmark(capsys, "--scenes", str(folder), "--problems", "2", "--peers", "none")
    assert facts["robot"] == "panda"
    assert facts["summary"][group]["pca"]["solved_share"] == 1.0
    assert facts["summary"][group]["pca"]["limits_kept_share"] == 1.0


@pytest.mark.skipif(not SCENES.is_dir(), reason=f"no problems in {SCENES}")
def test_vamp_and_time_optimal_parametrisation_reach_the_goals(capsys):
    for module, extra in (("vamp.constants", "vamp"), ("toppra", "peers")):
        pytest.importorskip(module, reason=f"the extra '{extra}' is not installed")
    folder = SCENES / "problems" / "table_pick_panda"
    facts = benchmark(capsys, "--scenes", str(folder), "--problems", "2", "--peers", "vamp_toppra")
    for problem in facts["problems"]:
        found = problem["vamp_toppra"]
        assert found["status"] == "solved" and found["end_error"] < 1e-3
        assert 0.0 < found["path_time_s"] < found["solve_time_s"]
        assert found["worst_limit"].split()[0] in ("", "jerk", "effort")
