# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The offline commands, run as their users run them."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from support.arm import JOINTS, arm_primitive
from support.bags import EPOCH, S
from support.commands import GOAL, START, URDF, refusal, run

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


@pytest.fixture
def primitive(tmp_path):
    path = tmp_path / "arm.npz"
    save_primitive(arm_primitive(), path)
    return path


def test_build_primitives_learns_the_motions_of_a_bag(recording, tmp_path):
    path, made = recording
    output = tmp_path / "arm.npz"
    options = ["--joints", ",".join(JOINTS), "--coupling", "joint", "--components", "4", "--json"]
    facts = json.loads(run("build_primitives", path, "--output", output, *options, ok=True).stdout)
    assert facts["n_recordings"] == 1 and facts["refused"] == []
    assert facts["n_motions"] == len(made.motion_spans) + len(made.return_spans)
    assert facts["n_components"] == 16
    assert facts["joint_names"] == list(JOINTS)
    assert set(facts["explained_variance_ratio"]) == set(JOINTS)
    assert all(sum(shares) > 0.95 for shares in facts["explained_variance_ratio"].values())
    assert len(facts["durations"]) == facts["n_motions"]
    assert facts["repairs"] == {"session": {}} or not any(facts["repairs"]["session"].values())
    assert load_primitive(output).metadata["demonstrations"][0]["recording"] == "session"


def test_build_primitives_cuts_where_a_table_says(recording, tmp_path):
    path, made = recording
    table = tmp_path / "cuts.csv"
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["recording", "start_time_s", "end_time_s", "label"])
        for start, end in made.motion_spans:
            writer.writerow(["session", start, end, "raise"])
    output = tmp_path / "arm.npz"
    run("build_primitives", path, "--segments", table, "--output", output, ok=True)
    spans = [
        (d["start_time_s"], d["end_time_s"], d["label"])
        for d in load_primitive(output).metadata["demonstrations"]
    ]
    assert [label for *_, label in spans] == ["raise"] * 8
    np.testing.assert_allclose([s[:2] for s in spans], made.motion_spans, atol=0.02)


@pytest.mark.parametrize("way", ["linear", "arc_length"])
def test_build_primitives_aligns_as_it_is_told(recording, tmp_path, way):
    output = tmp_path / "a.npz"
    run("build_primitives", recording[0], "--output", output, "--align", way, ok=True)
    built = load_primitive(output)
    assert built.metadata["options"]["align"] == way
    evenly = np.allclose(built.warps, np.linspace(0.0, 1.0, built.warps.shape[1]))
    assert evenly == (way == "linear")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--output", "p.txt"], "must end in .npz"),
        (["--output", "p.npz", "--joints", "shoulder1,hand"], "no joint is called 'hand'"),
        (["--output", "p.npz", "--topic", "/states"], "/states"),
        (["--output", "p.npz", "--variance", "2"], "variance must be a number"),
        (["--output", "p.npz", "--robot", "nowhere.urdf"], "nowhere.urdf"),
        (["--output", "p.npz", "--segments", "nowhere.csv"], "nowhere.csv"),
        (["--output", "p.npz", "--min-rest", "1e308"], "number from 1e-06 to 1e+06 s"),
        (["--output", "p.npz", "--coupling", "leg"], "invalid choice: 'leg'"),
        (["--output", "no/such/folder/p.npz"], "no/such/folder"),
        ([], "--output"),
    ],
)
def test_build_primitives_refuses_in_one_line(recording, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    assert message in refusal("build_primitives", recording[0], *options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_output_is_kept_without_force(recording, tmp_path):
    output = tmp_path / "p.npz"
    output.write_bytes(b"precious")
    assert "--force" in refusal("build_primitives", recording[0], "--output", output)
    assert output.read_bytes() == b"precious"
    run("build_primitives", recording[0], "--output", output, "--force", ok=True)
    load_primitive(output)


@pytest.mark.slow
def test_killing_build_primitives_leaves_the_whole_file_or_none(recording, tmp_path):
    old, new = tmp_path / "old.npz", tmp_path / "new.npz"
    command = [sys.executable, "-m", "mp_pca_planner", "build_primitives", str(recording[0])]
    subprocess.run([*command, "--output", old], check=True, capture_output=True)
    before = old.read_bytes()
    for delay in (0.0, 0.003):
        for output, force in ((old, ["--force"]), (new, [])):
            there = set(tmp_path.iterdir())
            with subprocess.Popen(
                [*command, "--output", output, *force], stdout=subprocess.DEVNULL
            ) as process:
                # The result is written beside its place first: that is the moment to be killed.
                while process.poll() is None and set(tmp_path.iterdir()) <= there:
                    time.sleep(0.0005)
                time.sleep(delay)
                process.send_signal(signal.SIGKILL)
            assert old.read_bytes() == before
            if new.exists():
                load_primitive(new)
                new.unlink()


def test_inspect_shows_topics_joints_and_rate_of_a_bag(recording):
    done = run("inspect", recording[0], ok=True)
    assert "name=/joint_states, type=sensor_msgs/msg/JointState" in done.stdout
    assert "shoulder1, shoulder2, shoulder3, elbow" in done.stdout
    assert re.search("^rate +100$", done.stdout, re.MULTILINE)


def test_inspect_shows_the_content_of_a_primitive(primitive):
    (facts,) = json.loads(run("inspect", primitive, "--json", ok=True).stdout)["files"]
    assert facts["name"] == "arm_arm_4" and facts["n_components"] == 4
    assert len(facts["metadata"]["demonstrations"]) == 20
    text = run("inspect", primitive, ok=True).stdout
    assert "4 components of 20 demonstrations" in text and "left-out motions: " in text


def test_inspect_shows_what_it_can_and_refuses_the_rest(primitive, tmp_path):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(primitive.read_bytes()[:-100])
    done = run("inspect", broken, primitive)
    assert done.returncode == 2
    assert "broken.npz' is rejected" in done.stderr
    assert "arm_arm_4" in done.stdout


def test_ctrl_c_while_a_command_loads_is_told_in_one_line():
    script = (
        "import os, signal, sys, mp_pca_planner.cli.main as program\n"
        # In a shell's background, from where CI may run this, the signal is ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "program.run_command = lambda *_: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.exit(program.main(['plan']))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (1, "mp-pca plan: interrupted\n")


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_output_to_a_full_disk_is_told_in_one_line(primitive):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "mp_pca_planner", "inspect", primitive],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "can't be written: No space left" in line


def plan(*options, ok=True):
    arguments = ("--robot", URDF, "--start", START, "--goal", GOAL, "--json")
    return json.loads(run("plan", *options, *arguments, ok=ok).stdout)


def test_plan_prints_the_public_keys(primitive):
    facts = plan(primitive)
    keys = {
        "status",
        "joint_names",
        "duration",
        "times",
        "positions",
        "velocities",
        "accelerations",
        "efforts",
        "effort_cost",
        "solve_time_s",
        "iterations",
        "primitive",
        "in_span_score",
        "limit_violation",
        "start_error",
        "goal_error",
    }
    assert keys <= set(facts)
    assert facts["status"] == "solved"
    assert facts["positions"][0] == [-0.2, 0.1, 0.5, -0.4]
    assert facts["positions"][-1] == [-1.2, 0.1, 0.5, -0.9]
    assert facts["velocities"][-1] == [0.0, 0.0, 0.0, 0.0]
    assert facts["times"][-1] == facts["duration"]


def test_plan_takes_duration_and_basis(primitive):
    options = ("--duration", 1.5, "--basis", "bspline")
    facts = plan(primitive, *options, "--naturalness", 0, ok=None)
    assert facts["duration"] == 1.5 and len(facts["times"]) == 151
    assert len(facts["weights"]) == 24
    assert plan(primitive, "--via", "elbow=-0.6", "--duration", 3)["duration"] == pytest.approx(3.0)


def test_plan_keeps_limits_from_a_file(primitive, tmp_path):
    limits = tmp_path / "joint_limits.yaml"
    limits.write_text("joint_limits: {shoulder1: {max_velocity: 0.9, max_effort: 60}}")
    facts = plan(primitive, "--limits", limits)
    assert max(abs(v[0]) for v in facts["velocities"]) <= 0.9
    assert facts["limit_violation"] <= 1e-6


def test_plan_fails_honestly_when_the_duration_is_too_short(primitive, tmp_path):
    output = tmp_path / "motion.csv"
    facts = plan(primitive, "--duration", 0.05, "--output", output, ok=False)
    assert facts["status"] == "infeasible" and facts["limit_violation"] > 0.0
    assert not output.exists()


@pytest.mark.parametrize("name", ["m.csv", "m.json", "m.npz", "m.mcap", "m.db3", "m.bag", "m"])
def test_plan_writes_the_motion_in_every_format(primitive, tmp_path, name):
    output = tmp_path / name
    facts = plan(primitive, "--output", output)
    wanted = np.array(facts["positions"])
    if name == "m.csv":
        rows = np.genfromtxt(output, delimiter=",", names=True, deletechars="")
        found = np.column_stack([rows[f"{joint}.positions"] for joint in JOINTS])
        np.testing.assert_array_equal(rows["time"], facts["times"])
    elif name == "m.json":
        # NaN is no JSON: other readers than Python's refuse it.
        written = json.loads(output.read_text(), parse_constant=pytest.fail)
        assert written.keys() == facts.keys() - {"written"}
        found = written["positions"]
    elif name == "m.npz":
        with np.load(output) as content:
            found = content["positions"]
    else:
        with AnyReader([output]) as reader:
            ((connection, _, raw),) = reader.messages()
            found = [p.positions for p in reader.deserialize(raw, connection.msgtype).points]
    np.testing.assert_array_equal(found, wanted)


def request(command, primitive, *options, ok=True, goal=("--goal", GOAL)):
    """The lines that a planning command prints."""
    ends = ("--robot", URDF, "--start", START, *goal)
    return run(command, primitive, *ends, *options, ok=ok).stdout.splitlines()


@pytest.mark.parametrize("command", ["plan", "sequence"])
def test_scaling_factors_of_moveit_are_said_not_to_be_applied(command, primitive, tmp_path):
    limits = tmp_path / "joint_limits.yaml"
    text = "default_velocity_scaling_factor: 0.1\njoint_limits: {elbow: {max_velocity: 9.0}}\n"
    limits.write_text(text)
    lines = request(command, primitive, "--limits", limits)
    (remark,) = (line for line in lines if "scaling_factor" in line)
    assert remark.startswith("remarks ") and "velocity_scaling_factor 0.1 are not applied" in remark
    limits.write_text(text.replace("0.1", "1.0"))
    assert not any("scaling" in line for line in request(command, primitive, "--limits", limits))


def test_plan_says_that_efforts_are_unknown_without_inertias(primitive, tmp_path):
    urdf, limits = tmp_path / "bare.urdf", tmp_path / "limits.yaml"
    text = config_file("human_arm.urdf").read_text()
    urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    free = ", ".join(f"{name}: {{max_effort: .inf}}" for name in JOINTS)
    limits.write_text(f"joint_limits: {{{free}}}")
    ends = ("--robot", urdf, "--start", START, "--goal", GOAL, "--limits", limits)
    text = run("plan", primitive, *ends, "--objective", "jerk=1", ok=True).stdout
    assert "effort_cost" not in text and "nan" not in text.split()


def test_plan_reaches_a_pose_in_the_shortest_time_and_through_a_via(primitive):
    options = ["--start", START, "--goal-pose", "0.35 -0.1 0.1", "--frame", "wrist"]
    options += ["--objective", "effort=1,jerk=1e-5"]
    usual, short, passing = (
        json.loads(run("plan", primitive, "--robot", URDF, *options, *more, "--json").stdout)
        for more in ([], ["--timing", "shortest"], ["--via", "elbow=-0.8"])
    )
    for plan in (usual, short, passing):
        assert plan["goal_error"] <= 1e-6 and plan["via_error"] <= 1e-6
        assert plan["limit_violation"] <= 1e-6
    assert short["duration"] < usual["duration"]
    assert passing["mode"] == "optimal" and len(passing["vias"]) == 1


def test_plan_draws_the_motion(primitive, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    picture = tmp_path / "motion.png"
    plan(primitive, "--plot", picture)
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--start", "1,2,3", "--goal", GOAL], "3 values, but there are 4 joints"),
        (["--start", "shoulder1=0", "--goal", GOAL], "--start lacks a position for shoulder2"),
        (["--start", START, "--goal", "hand=1"], "no joint is called 'hand'"),
        (["--start", START, "--goal", "elbow=nan"], "only finite numbers"),
        (["--start", START, "--goal", "elbow=x"], "'x', not a number"),
        (["--start", START, "--goal", "elbow=-1,elbow=-2"], "given more than once"),
        (["--start", START, "--goal", "elbow=-1,2"], "no joint is called '2'"),
        (["--start", START, "--goal", ""], "must be name=value"),
        (["--start", START, "--goal", "elbow=9"], "in radians; in degrees, 515.66"),
        (
            ["--start", START, "--goal", GOAL, "--duration", "-1"],
            "number from 0.001 to 600 s",
        ),
        (["--start", START, "--goal", GOAL, "--naturalness", "-1"], "naturalness"),
        (["--start", START, "--goal", GOAL, "--primitive", "leg"], "no primitive is called 'leg'"),
        (["--start", START, "--goal", GOAL, "--output", "m.xyz"], "must end in .csv"),
        (["--start", START], "--goal"),
        (["--start", START, "--goal", GOAL, "--goal-pose", "1 2 3"], "not allowed with"),
        (["--start", START, "--goal-pose", "1 2"], "has 2 numbers, but a position has 3"),
        (["--start", START, "--goal-pose", "0.3 0 x"], "'x', not a number"),
        (["--start", START, "--goal-pose", "0.3 0 0 1 1 1 1"], "quaternion"),
        (["--start", START, "--goal-pose", "9 0 0"], "the nearest one found is"),
        (["--start", START, "--goal-pose", "0.3 0 0", "--frame", "hand"], "called 'hand'"),
        (["--start", START, "--goal", GOAL, "--via", "elbow=-1@soon"], "after @, 'soon'"),
        (["--start", START, "--goal", GOAL, "--goal", GOAL], "--goal is given more than once"),
        (
            ["--start", START, "--goal", GOAL, "--via", "elbow=-1", "--timing", "free"],
            "--timing free can't be given with --via",
        ),
        (["--start", START, "--goal", GOAL, "--via", "hand: 0.3 0 0"], "called 'hand'"),
        (["--start", START, "--goal", GOAL, "--duration", "soon"], "number from 0.001 to 600 s"),
        (["--start", START, "--goal", GOAL, "--duration", "1e-300"], "number from 0.001 to 600 s"),
        (["--start", START, "--goal", GOAL, "--naturalness", "1e308"], "number from 0 to 1"),
        (["--start", START, "--goal", GOAL, "--objective", "effort=1e308"], "to 1e+12"),
        (["--start", START, "--goal", GOAL, "--objective", "speed=1"], "objective is called"),
        (["--start", START, "--goal", GOAL, "--objective", "jerk=-1"], "expected one from 1e-12"),
    ],
)
def test_plan_refuses_in_one_line(primitive, options, message):
    assert message in refusal("plan", primitive, "--robot", URDF, *options)


def test_real_gestures_of_a_robot_become_a_primitive(shared_data, tmp_path):
    joints = ",".join(f"arm_right_{i}_joint" for i in range(1, 8))
    output = tmp_path / "reem.npz"
    options = ("--joints", joints, "--output", output)
    run("build_primitives", shared_data / "reem_gestures", *options, ok=True)
    found = {d["recording"] for d in load_primitive(output).metadata["demonstrations"]}
    assert found == {"wave", "salute", "crowd_salute", "handshake", "question"}


def test_real_human_motions_are_explained_by_four_components_a_joint(shared_data, tmp_path):
    human = shared_data / "human_arm"
    options = ["--segments", human / "motions.csv", "--coupling", "joint", "--components", "4"]
    done = run(
        "build_primitives",
        human / "joint_states",
        *options,
        "--output",
        tmp_path / "h.npz",
        "--json",
        ok=True,
    )
    facts = json.loads(done.stdout)
    assert facts["n_motions"] == 141
    assert all(sum(shares) > 0.99 for shares in facts["explained_variance_ratio"].values())
    # Figures of the table in the README of the recordings, from another program.
    np.testing.assert_allclose(
        facts["angle_variance_ratio"]["shoulder1"], [0.560, 0.420, 0.017, 0.002], atol=1e-3
    )


def test_real_recordings_without_usable_time_are_refused_with_a_sentence(shared_data, tmp_path):
    options = ("--output", tmp_path / "u.npz")
    assert "time" in refusal("build_primitives", shared_data / "unstamped", *options)
