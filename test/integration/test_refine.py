# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `refine`."""

import json
import resource

import numpy as np
import pytest
from support.arm import arm_primitive, arm_robot
from support.obstacle_scenes import write_scene
from support.worlds import plain_distances
from test_commands import GOAL, START, URDF, refusal, run

from mp_pca_planner.cli.main import load_command
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.robot.world import World


@pytest.fixture
def primitive(tmp_path):
    path = tmp_path / "reach.npz"
    save_primitive(arm_primitive(), path)
    return path


def refine(primitive, *options, ok=True):
    request = ("--robot", URDF, "--start", START, "--goal", GOAL, "--json")
    done = run("refine", primitive, *request, *options, ok=ok)
    return json.loads(done.stdout)


def test_refined_motion_keeps_clear_of_obstacles(primitive, tmp_path):
    bare = np.array(refine(primitive, "--time-price", "3")["positions"])
    hand = arm_robot().frame_positions(bare, [arm_robot().frame_names[-1]])[:, 0]
    ball = ("ball", "sphere", [0.02], hand[len(hand) // 2])
    scene = write_scene(tmp_path / "scene.yaml", [ball])
    facts = refine(primitive, "--time-price", "3", "--obstacles", scene, "--margin", "0.01")
    assert facts["collision"].startswith("none")
    world = World.from_file(scene)
    assert plain_distances(world, bare).min() < 0.0
    assert plain_distances(world, np.array(facts["positions"])).min() >= 0.01


# By the model


def test_refined_motion_is_written_and_kept_as_a_primitive(primitive, tmp_path):
    new, motion = tmp_path / "new.npz", tmp_path / "motion.json"
    facts = refine(primitive, "--output", new, "--trajectory", motion, "--name", "better")
    assert facts["cost"] < 0.99 * facts["original_cost"]
    assert facts["kept"] and facts["limit_violation"] == 0.0
    family = load_primitive(new)
    assert family.name == "better"
    assert family.metadata["refined_from"]["name"] == arm_primitive().name
    assert family.metadata["refined_from"]["cost"] == pytest.approx(facts["cost"])
    written = json.loads(motion.read_text())
    assert written["positions"] == facts["positions"]
    request = ("--robot", URDF, "--start", START, "--goal", GOAL, "--json")
    before, after = (
        json.loads(run("plan", path, *request, ok=True).stdout)["effort_cost"]
        for path in (primitive, new)
    )
    assert after < before


def test_motion_that_gains_too_little_is_not_kept(primitive, tmp_path):
    new = tmp_path / "new.npz"
    facts = refine(primitive, "--output", new, "--min-gain", "0.9", ok=False)
    assert not facts["kept"]
    assert not new.exists()


def test_text_says_what_was_gained(primitive):
    request = ("--robot", URDF, "--start", START, "--goal", GOAL)
    lines = run("refine", primitive, *request, ok=True).stdout.splitlines()
    (cost,) = (line for line in lines if line.startswith("cost "))
    assert "% less" in cost
    assert lines[-1].endswith("not kept (pass --output to keep it)")


def joint_list(q):
    return ",".join(map(str, q))


def test_sequence_is_refined_and_kept_segment_by_segment(primitive, tmp_path):
    via = arm_primitive().boundary_states[1][3]
    new = tmp_path / "new.npz"
    facts = refine(primitive, "--via", joint_list(via), "--output", new)
    assert facts["cost"] < 0.99 * facts["original_cost"]
    assert facts["kept"] and facts["limit_violation"] == 0.0
    assert len(facts["parameters"]) == 2
    times, q, v = (np.array(facts[key]) for key in ("times", "positions", "velocities"))
    # It goes through the via, and not from rest to rest.
    passed = np.abs(q - via).max(axis=1)
    moment = int(passed.argmin())
    speed = np.abs(v[moment]).max()
    assert passed[moment] <= speed * np.diff(times).max()
    assert speed > 0.05
    assert q[-1].tolist() == [-1.2, via[1], via[2], -0.9]
    families = [load_primitive(tmp_path / f"new_{k}.npz") for k in (1, 2)]
    assert [family.name for family in families] == [
        f"{arm_primitive().name}_refined_{k}" for k in (1, 2)
    ]
    ends = [family.metadata["refined_from"] for family in families]
    assert ends[0]["goal"] == ends[1]["start"] == via.tolist()
    assert not new.exists()


def test_pose_on_the_way_is_still_passed_after_refinement(primitive):
    wrist = arm_robot().frame_positions(arm_primitive().boundary_states[1][3:4], ["wrist"])[0, 0]
    facts = refine(primitive, "--via", "wrist: {} {} {}".format(*wrist))
    assert facts["gain"] > 0.0
    q, v = np.array(facts["positions"]), np.array(facts["velocities"])
    way = arm_robot().frame_positions(q, ["wrist"])[:, 0]
    missed = np.linalg.norm(way - wrist, axis=1)
    # Points are 10 ms apart, and the arm is less than a metre long.
    assert missed.min() < 0.01 * np.abs(v).sum(axis=1).max()


# By trials


def test_trials_go_on_from_call_to_call_until_one_is_kept(primitive, tmp_path):
    pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")
    state, motion, new = tmp_path / "t.json", tmp_path / "trial.csv", tmp_path / "new.npz"
    options = ("--trials", state, "--trajectory", motion, "--force")
    first = refine(primitive, *options)
    assert first["n_trials"] == 0 and not state.exists()
    assert refine(primitive, *options)["positions"] == first["positions"]
    second = refine(primitive, *options, "--cost", "10.0")
    assert second["n_trials"] == 1
    assert second["positions"] != first["positions"]
    third = refine(primitive, *options, "--cost", "8.0", "--output", new, ok=False)
    assert third["n_trials"] == 2
    # Nothing is kept until the planned motion and the best one are repeated.
    assert third["gain"] is None and not third["kept"] and not new.exists()
    fourth = refine(primitive, *options, "--cost", "10.0")
    assert fourth["positions"] == second["positions"]
    fifth = refine(primitive, *options, "--cost", "8.0", "--output", new)
    assert fifth["gain"] == pytest.approx(0.2) and fifth["gain_error"] == 0.0
    assert fifth["kept"] and load_primitive(new).metadata["refined_from"]["cost"] == 8.0


def test_cost_is_not_counted_if_the_next_trial_could_not_be_written(primitive, tmp_path):
    pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")
    state, motion = tmp_path / "t.json", tmp_path / "trial.csv"
    request = ("--robot", URDF, "--start", START, "--goal", GOAL, "--trials", state)
    options = [str(word) for word in (primitive, *request, "--trajectory", motion, "--force")]
    main = load_command("refine")
    assert main(options) == 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    limit = 4096  # between the sizes of the trials and of the motion
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        with pytest.raises(PlannerError, match="can't be written"):
            main([*options, "--cost", "10"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not state.exists()
    assert main([*options, "--cost", "10"]) == 0
    assert len(json.loads(state.read_text())["trials"]) == 1
    assert state.stat().st_size < limit < motion.stat().st_size


def test_trials_of_a_sequence_pass_its_vias(primitive, tmp_path):
    pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")
    via = arm_primitive().boundary_states[1][3]
    options = ("--via", joint_list(via), "--trials", tmp_path / "t.json")
    for cost in (None, "10.0", "9.0", "8.0"):
        facts = refine(primitive, *options, *(() if cost is None else ("--cost", cost)))
        q, v = np.array(facts["positions"]), np.array(facts["velocities"])
        assert np.abs(q - via).max(axis=1).min() < 0.01 * np.abs(v).max()
    assert facts["n_trials"] == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--cost", "3"), "also pass --trials"),
        (("--min-gain", "2"), "--min-gain: '2' is not a number from 0"),
        (("--time-price", "-1"), "--time-price: '-1' is not a number from 0"),
        (("--trajectory", "motion.docx"), "must end in"),
        (("--trials", "t.json", "--cost", "nan"), "--cost: 'nan' is not a number"),
        (("--limits", "{tight}"), "no motion to refine"),
        (("--via", GOAL, "--duration", "3"), "--duration can't be given with --via"),
        (("--via", f"{GOAL}@0.5"), "times (@) are not accepted"),
    ],
)
def test_nonsense_is_refused_in_one_line(primitive, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    tight = tmp_path / "tight.yaml"
    tight.write_text("joint_limits: {elbow: {max_effort: 1.0e-6}}")
    options = [option.format(tight=tight) for option in options]
    line = refusal("refine", primitive, "--robot", URDF, "--start", START, "--goal", GOAL, *options)
    assert words in line
    assert not (tmp_path / "t.json").exists()


def test_existing_files_are_not_lost(primitive, tmp_path):
    kept = tmp_path / "new.npz"
    kept.write_text("precious")
    request = ("--robot", URDF, "--start", START, "--goal", GOAL)
    assert "exists already" in refusal("refine", primitive, *request, "--output", kept)
    assert kept.read_text() == "precious"
