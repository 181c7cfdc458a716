# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `benchmark` and the methods it compares."""

import json
import sys
from dataclasses import replace

import pytest
from support.arm import arm_primitive
from support.patience import EVER

from mp_pca_planner.cli.main import main
from mp_pca_planner.evaluation.methods import (
    Method,
    PeerResult,
    minimum_jerk_method,
    planner_methods,
)
from mp_pca_planner.evaluation.problems import (
    Problem,
    Scene,
    demonstrations_of,
    held_out_problems,
    robot_file,
)
from mp_pca_planner.evaluation.referee import RigidArm, judge
from mp_pca_planner.evaluation.run import PEERS, compare, ratios, set_up, unsolved
from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.robot.model import Robot

PEER_MODULES = {
    "promp": "movement_primitives.promp",
    "dmp": "movement_primitives.dmp",
    "fddp": "crocoddyl",
    "box_fddp": "crocoddyl",
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    name, urdf, joints = robot_file("human_arm")
    robot = Robot.from_file(urdf, joints)
    limits = robot.limits()
    return Scene(name, urdf, robot, limits, tuple(demonstrations_of(name, robot, limits, 12, 1)))


@pytest.fixture(scope="module")
def problem(scene) -> Problem:
    return held_out_problems(scene, 1, 2)[0]


def benchmark(capsys, *options: str) -> dict:
    assert main(["benchmark", *options, "--time-limit", str(EVER), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


# The methods


@pytest.mark.parametrize("name", PEERS)
def test_peer_goes_from_start_to_goal(scene, problem, name):
    pytest.importorskip(PEER_MODULES[name], reason="the extra 'peers' is not installed")
    answer = PEERS[name](scene, EVER).solve(problem)
    assert answer.status == "solved" and answer.solve_time > 0.0
    verdict = judge(
        answer.trajectory, problem, RigidArm(scene.urdf, scene.robot.joint_names), scene.limits
    )
    assert verdict.end_error < 1e-3
    assert verdict.end_velocity < 0.2
    assert verdict.duration == pytest.approx(problem.duration)


def test_planners_methods_keep_the_limits_for_the_referee(scene, problem):
    arm = RigidArm(scene.urdf, scene.robot.joint_names)
    costs = {}
    for method in planner_methods(scene, EVER):
        verdict = judge(method.solve(problem).trajectory, problem, arm, scene.limits)
        assert verdict.feasible and verdict.end_error == 0.0
        costs[method.name] = verdict.effort_cost
    assert costs["bspline"] < costs["pca_arm_effort_only"] < costs["pca_arm"]


def test_method_that_takes_too_long_is_stopped(scene, problem):
    pytest.importorskip("crocoddyl", reason="the extra 'peers' is not installed")
    answer = PEERS["fddp"](scene, 1e-9).solve(problem)
    assert answer.trajectory is None and "not converged" in answer.status


def test_missing_peer_is_named_and_the_others_are_run(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "movement_primitives.promp", None)
    monkeypatch.setitem(PEERS, "other", lambda scene, _: recorder(scene, "other", False, []))
    methods, absent = set_up(scene, ["promp", "other"], 1.0)
    assert [m.name for m in methods][-1] == "other"
    assert list(absent) == ["promp"] and "mp_pca_planner[peers]" in absent["promp"]


def test_example_robot_without_its_package_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "example_robot_data.robots_loader", None)
    with pytest.raises(MissingDependencyError, match=r"robot 'panda' .*\[example\]"):
        robot_file("panda")


# The comparison


def recorder(scene: Scene, name: str, slow: bool, calls: list[str]) -> Method:
    """A method that notes when it is called."""
    usual = minimum_jerk_method(scene)

    def solve(problem: Problem) -> PeerResult:
        calls.append(name)
        return usual.solve(problem)

    return Method(name, usual.about, solve, slow)


def test_order_alternates_and_slow_methods_get_some_problems(scene):
    calls: list[str] = []
    methods = [recorder(scene, "a", False, calls), recorder(scene, "b", True, calls)]
    results = compare(scene, methods, held_out_problems(scene, 3, 2), repeats=2, n_slow=2)
    assert calls == ["a", "b", "b", "a", "a", "a", "a", "b", "b", "a"]
    assert [set(r) for r in results] == [{"a", "b"}, {"a"}, {"a", "b"}]


def test_ratios_are_medians_over_what_both_solve(scene, problem):
    method = minimum_jerk_method(scene)
    arm = RigidArm(scene.urdf, scene.robot.joint_names)
    answer = method.solve(problem)
    verdict = judge(answer.trajectory, problem, arm, scene.limits)

    def result(time: float, solved: bool = True) -> PeerResult:
        return replace(answer, solve_time=time, verdict=verdict if solved else None)

    results = [
        {"ours": result(1.0), "other": result(2.0)},
        {"ours": result(1.0), "other": result(4.0)},
        {"ours": result(1.0), "other": result(8.0)},
        {"ours": result(9.0), "other": result(1.0, solved=False)},
        {"ours": result(9.0, solved=False), "other": result(1.0)},
        {"ours": result(9.0)},
    ]
    assert ratios(results, "ours", "other") == {"time_ratio": 0.25, "cost_ratio": 1.0}
    assert ratios(results[3:], "ours", "other") == {"time_ratio": None, "cost_ratio": None}
    assert unsolved(results, "ours", "other") == [4]


# The command


def test_json_holds_every_method_and_the_ratios(capsys):
    facts = benchmark(capsys, "--problems", "2", "--peers", "none", "--repeats", "1")
    assert facts["n_problems"] == len(facts["problems"]) == 2
    for found in facts["problems"]:
        assert {"pca_arm", "pca_joint", "bspline", "minimum_jerk"} <= set(found)
        for result in found.values():
            assert {"effort_cost", "solve_time_s", "iterations", "feasible"} <= set(result)
        assert found["pca_arm"]["feasible"] and found["pca_arm"]["limit_violation"] <= 1e-6
    for other in ("bspline", "minimum_jerk"):
        assert facts[f"time_ratio_pca_over_{other}"] > 0.0
        assert facts[f"cost_ratio_pca_over_{other}"] > 0.0
    assert facts["solved_by_bspline_only"]["pca_arm"] == []
    assert "ρ = 1, less for in-span scores above 3 (default)" in facts["methods"]["pca_arm"]


def test_random_ends_have_no_demonstration_to_be_near_to(capsys):
    facts = benchmark(
        capsys, "--problems", "1", "--peers", "none", "--repeats", "1", "--random-ends"
    )
    assert facts["random_ends"]
    assert facts["problems"][0]["bspline"]["demo_distance_deg"] is None


def test_primitive_file_gives_components_and_problems(capsys, tmp_path):
    save_primitive(arm_primitive("joint"), tmp_path / "arm.npz")
    facts = benchmark(
        capsys,
        *("--primitives", str(tmp_path / "arm.npz"), "--problems", "2", "--repeats", "1"),
        *("--peers", "none"),
    )
    assert "pca_joint" in facts["summary"] and "pca_arm" not in facts["summary"]
    assert facts["time_ratio_pca_over_bspline"] > 0.0


def test_table_states_naturalness_and_picture_is_drawn(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    picture = tmp_path / "cost.png"
    options = ["--problems", "1", "--peers", "none", "--repeats", "1", "--plot", str(picture)]
    assert main(["benchmark", *options]) == 0
    text = capsys.readouterr().out
    assert "naturalness ρ = 1, less for in-span scores above 3 (default)\n" in text
    assert "naturalness ρ = 0\n" in text
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["benchmark", *options]) == 2
    assert "exists already" in capsys.readouterr().err


def test_example_robots_get_made_up_reaches(capsys):
    pytest.importorskip("example_robot_data", reason="the extra 'peers' is not installed")
    options = ["--robot", "ur5", "--problems", "1", "--peers", "none", "--repeats", "1"]
    facts = benchmark(capsys, *options)
    assert facts["robot"] == "ur5" and facts["n_joints"] == 6


def test_one_arm_of_a_robot_is_chosen_by_its_joints(capsys):
    pytest.importorskip("example_robot_data", reason="the extra 'peers' is not installed")
    from example_robot_data.robots_loader import getModelPath

    path = "icub_description/robots/icub.urdf"
    options = ["--robot", f"{getModelPath(path)}/{path}", "--problems", "1", "--peers", "none"]
    arm = "l_shoulder_pitch,l_shoulder_roll,l_shoulder_yaw,l_elbow"
    assert benchmark(capsys, *options, "--repeats", "1", "--joints", arm)["n_joints"] == 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--robot", "nobody"], "neither a URDF file nor one of 'human_arm', 'panda'"),
        (["--peers", "box_fdp"], "did you mean 'box_fddp'?"),
        (["--problems", "0"], "'0' is not a whole number from 1"),
        (["--seed", "1"], "not be 1, which chooses the demonstrations"),
        (["--time-limit", "0"], "is not a number from"),
        (["--primitives", "nothing.npz"], "nothing.npz"),
        (["--primitives", "any.npz", "--joints", "elbow"], "--joints is not accepted with"),
        (["--joints", "elbo"], "did you mean 'elbow'?"),
    ],
)
def test_wrong_options_are_refused_in_one_line(capsys, options, message):
    try:
        status = main(["benchmark", *options])
    except SystemExit as refusal:  # of the parser
        status = refusal.code
    output = capsys.readouterr()
    assert status == 2 and output.out == ""
    assert message in output.err and output.err.count("\n") == 1
