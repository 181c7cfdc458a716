# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The offline commands, run as their users run them."""

import json
import re

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from support.arm import JOINTS, arm_primitive
from support.bags import EPOCH, S
from support.commands import GOAL, START, URDF, refusal, result, run

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """One long recording of the arm."""
    path = tmp_path_factory.mktemp("bags") / "session"
    made = continuous_recording(generate_motions(8, 3), 100.0, (0.8, 1.2), seed=3)
    stamps = EPOCH + np.round(made.times * S).astype(np.int64)
    write_joint_states(path, "mcap", made.joint_names, stamps, made.positions)
    return path, made


@pytest.fixture(scope="module")
def primitive(tmp_path_factory):
    path = tmp_path_factory.mktemp("primitive") / "arm.npz"
    save_primitive(arm_primitive(), path)
    return path


# build_primitives and inspect


def test_build_primitives_learns_the_motions_of_a_bag(recording, tmp_path):
    path, made = recording
    output = tmp_path / "arm.npz"
    options = ["--joints", ",".join(JOINTS), "--coupling", "joint", "--components", "4"]
    facts = result("build_primitives", path, "--output", output, *options, "--align", "linear")
    assert facts["n_recordings"] == 1 and facts["refused"] == []
    assert facts["n_motions"] == len(made.motion_spans) + len(made.return_spans)
    assert facts["n_components"] == 16
    assert facts["joint_names"] == list(JOINTS)
    assert set(facts["explained_variance_ratio"]) == set(JOINTS)
    assert all(sum(shares) > 0.95 for shares in facts["explained_variance_ratio"].values())
    assert len(facts["durations"]) == facts["n_motions"]
    assert not any(facts["repairs"]["session"].values())
    built = load_primitive(output)
    assert built.metadata["demonstrations"][0]["recording"] == "session"
    assert np.allclose(built.warps, np.linspace(0.0, 1.0, built.warps.shape[1]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--output", "p.txt"], "must end in .npz"),
        (["--output", "p.npz", "--joints", "shoulder1,hand"], "no joint is called 'hand'"),
        (["--output", "p.npz", "--topic", "/states"], "/states"),
        (["--output", "no/such/folder/p.npz"], "no/such/folder"),
        ([], "--output"),
        (["--output", "p.npz", "--scale", "joint1"], "'joint1' is neither JOINT=FACTOR nor"),
    ],
)
def test_build_primitives_refuses_in_one_line(recording, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    assert message in refusal("build_primitives", recording[0], *options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_output_is_kept_without_force(recording, tmp_path):
    output = tmp_path / "p.npz"
    output.write_bytes(b"precious")
    line = refusal("build_primitives", recording[0], "--output", output)
    assert "--force, in Python overwrite=True" in line
    assert output.read_bytes() == b"precious"
    run("build_primitives", recording[0], "--output", output, "--force", ok=True)
    load_primitive(output)


def test_inspect_shows_what_it_can_and_refuses_the_rest(recording, primitive, tmp_path):
    (facts,) = result("inspect", primitive)["files"]
    assert facts["name"] == "arm_arm_4" and facts["n_components"] == 4
    assert len(facts["metadata"]["demonstrations"]) == 20
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    done = run("inspect", empty)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "empty.csv" in done.stderr
    broken = tmp_path / "broken.npz"
    broken.write_bytes(primitive.read_bytes()[:-100])
    done = run("inspect", broken, primitive, recording[0])
    assert done.returncode == 2
    assert "broken.npz' is rejected" in done.stderr
    assert "4 components of 20 demonstrations" in done.stdout
    assert "left-out motions: " in done.stdout
    assert "name=/joint_states, type=sensor_msgs/msg/JointState" in done.stdout
    assert "shoulder1, shoulder2, shoulder3, elbow" in done.stdout
    assert re.search("^rate +100$", done.stdout, re.MULTILINE)


# plan


def plan(*options, ok=True, goal=("--goal", GOAL)):
    arguments = ("--robot", URDF, "--start", START, *goal, "--json")
    return json.loads(run("plan", *options, *arguments, ok=ok).stdout)


def test_plan_prints_the_public_keys_and_writes_them(primitive, tmp_path):
    facts = plan(primitive, "--output", tmp_path / "m.json")
    keys = {
        *("status", "joint_names", "duration", "times", "positions", "velocities"),
        *("accelerations", "efforts", "effort_cost", "solve_time_s", "iterations", "primitive"),
        *("in_span_score", "limit_violation", "start_error", "goal_error"),
    }
    assert keys <= set(facts)
    assert facts["status"] == "solved"
    assert facts["positions"][0] == [-0.2, 0.1, 0.5, -0.4]
    assert facts["positions"][-1] == [-1.2, 0.1, 0.5, -0.9]
    assert facts["velocities"][-1] == [0.0, 0.0, 0.0, 0.0]
    assert facts["times"][-1] == facts["duration"]
    # NaN is no JSON: other readers than Python's refuse it.
    written = json.loads((tmp_path / "m.json").read_text(), parse_constant=pytest.fail)
    assert written.keys() == facts.keys() - {"written"}
    assert written["positions"] == facts["positions"]
    facts = plan(primitive, "--output", tmp_path / "m.mcap")
    with AnyReader([tmp_path / "m.mcap"]) as reader:
        ((connection, _, raw),) = reader.messages()
        found = [p.positions for p in reader.deserialize(raw, connection.msgtype).points]
    np.testing.assert_array_equal(found, facts["positions"])


def test_plan_takes_duration_basis_and_limits(primitive, tmp_path):
    options = ("--duration", 1.5, "--basis", "bspline")
    facts = plan(primitive, *options, "--naturalness", 0, ok=None)
    assert facts["duration"] == 1.5 and len(facts["times"]) == 151
    assert len(facts["weights"]) == 24
    assert plan(primitive, "--via", "elbow=-0.6", "--duration", 3)["duration"] == pytest.approx(3.0)
    limits = tmp_path / "joint_limits.yaml"
    text = "joint_limits: {shoulder1: {max_velocity: 0.9, max_effort: 60}}\n"
    limits.write_text(text + "default_velocity_scaling_factor: 0.1\n")
    facts = plan(primitive, "--limits", limits)
    assert max(abs(v[0]) for v in facts["velocities"]) <= 0.9
    assert facts["limit_violation"] <= 1e-6
    said = "velocity_scaling_factor 0.1 are not applied"
    assert any(said in remark for remark in facts["remarks"])
    limits.write_text(text)
    assert not any("scaling" in remark for remark in plan(primitive, "--limits", limits)["remarks"])


def test_plan_fails_honestly_when_the_duration_is_too_short(primitive, tmp_path):
    output = tmp_path / "motion.csv"
    facts = plan(primitive, "--duration", 0.05, "--output", output, ok=False)
    assert facts["status"] == "infeasible" and facts["limit_violation"] > 0.0
    assert not output.exists()


def test_plan_says_that_efforts_are_unknown_without_inertias(primitive, tmp_path):
    urdf, limits = tmp_path / "bare.urdf", tmp_path / "limits.yaml"
    text = config_file("human_arm.urdf").read_text()
    urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    free = ", ".join(f"{name}: {{max_effort: .inf}}" for name in JOINTS)
    limits.write_text(f"joint_limits: {{{free}}}")
    ends = ("--robot", urdf, "--start", START, "--goal", GOAL, "--limits", limits)
    text = run("plan", primitive, *ends, "--objective", "jerk=1", ok=True).stdout
    assert "effort_cost" not in text and "nan" not in text.split()


def test_plan_reaches_a_pose_in_the_shortest_time_and_through_a_via(primitive, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    goal = ["--goal-pose", "0.35 -0.1 0.1", "--frame", "wrist"]
    goal += ["--objective", "effort=1,jerk=1e-5"]
    picture = tmp_path / "motion.png"
    ways = ([], ["--timing", "shortest"], ["--via", "elbow=-0.8", "--plot", picture])
    usual, short, passing = (plan(primitive, *way, goal=goal) for way in ways)
    for found in (usual, short, passing):
        assert found["goal_error"] <= 1e-6 and found["via_error"] <= 1e-6
        assert found["limit_violation"] <= 1e-6
    assert short["duration"] < usual["duration"]
    assert passing["mode"] == "optimal" and len(passing["vias"]) == 1
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 10_000


ENDS = ["--start", START, "--goal", GOAL]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--start", "1,2,3", "--goal", GOAL], "3 values, expected 4: "),
        (["--start", "shoulder1=0", "--goal", GOAL], "--start lacks a position for shoulder2"),
        (["--start", START, "--goal", "elbow=9"], "in radians; in degrees, 515.66"),
        (["--start", START], "--goal"),
        (["--start", START, "--goal-pose", "0.3 0 0 1 1 1 1"], "quaternion"),
        (["--start", START, "--goal-pose", "0.3 0 0", "--frame", "hand"], "called 'hand'"),
        ([*ENDS, "--goal-pose", "1 2 3"], "not allowed with"),
        ([*ENDS, "--frame", "wrist"], "--frame is for --goal-pose"),
        ([*ENDS, "--via", "elbow=-1", "--timing", "free"], "--timing free can't be given with"),
        ([*ENDS, "--via", "hand: 0.3 0 0"], "called 'hand'"),
        ([*ENDS, "--objective", "jerk=-1"], "expected one from 1e-12"),
        ([*ENDS, "--primitive", "leg"], "no primitive is called 'leg'"),
        ([*ENDS, "--output", "m.xyz"], "must end in .csv"),
        ([*ENDS, "--package-dirs", "nothere"], "there is no folder 'nothere'"),
        ([*ENDS, "--limits", URDF], "limits file"),
        ([*ENDS, "--naturalness", "2"], "not a number from 0 to 1"),
        (
            [*ENDS, "--constraint", "upright:wrist"],
            "upright:FRAME:DEGREES, or with the axis",
        ),
        (["--start", START, "--goal", "0.4 0.1 0.6"], "a pose is --goal-pose 'X Y Z …'"),
        ([*ENDS, "--margin", "0.1"], "also pass --obstacles"),
        ([*ENDS, "--no-collision", "--srdf", "x.srdf"], "remove --no-collision"),
    ],
)
def test_plan_refuses_in_one_line(primitive, options, message):
    assert message in refusal("plan", primitive, "--robot", URDF, *options)


def test_shapes_that_are_missing_are_remarked_and_refused_where_they_were_asked_for(
    primitive, tmp_path
):
    urdf = tmp_path / "arm.urdf"
    text = config_file("human_arm.urdf").read_text()
    mesh = '<collision><geometry><mesh filename="package://arm/hand.stl"/></geometry></collision>'
    urdf.write_text(re.sub("<collision.*?</collision>", mesh, text, count=1, flags=re.DOTALL))
    words = ("plan", primitive, "--robot", urdf, *ENDS)
    assert any("self-collision is not checked" in x for x in result(*words)["remarks"])
    line = refusal(*words, "--collision")
    assert "hand.stl" in line and "--package-dirs" in line
    urdf.write_text(re.sub("<collision.*?</collision>", "", text, flags=re.DOTALL))
    assert "no collision geometry" in refusal(*words, "--collision")
