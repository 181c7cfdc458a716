# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The comparisons that users repeat: scripts in benchmarks/, with few problems."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ARM = """\
<mujoco><compiler angle="radian" autolimits="true"/>
<default><joint armature="0.1" axis="0 1 0"/></default>
<worldbody><body name="base"><inertial pos="0 0 0" mass="4" diaginertia="0.01 0.01 0.01"/>
<body name="a" pos="0 0 0.2"><inertial pos="0 0 0.1" mass="4" diaginertia="0.02 0.02 0.01"/>
<joint name="one" axis="0 0 1" range="-3 3"/><geom type="mesh" mesh="missing"/>
<body name="b" pos="0 0 0.2"><inertial pos="0 0 0.2" mass="3" diaginertia="0.05 0.05 0.01"/>
<joint name="two" range="-2 2"/>
<body name="c" pos="0 0 0.4"><inertial pos="0 0.05 0.1" mass="1" quat="1 1 0 0"
diaginertia="0.01 0.02 0.02"/>
<joint name="three" range="-2.5 2.5"/></body></body></body></body></worldbody>
<actuator><position joint="one" kp="2000" kv="200" forcerange="-80 80"/>
<position joint="two" kp="2000" kv="200" forcerange="-80 80"/>
<position joint="three" kp="2000" kv="200" forcerange="-30 30"/></actuator></mujoco>
"""
ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.slow


def facts_of(script: str, *options: str | Path) -> dict:
    command = [sys.executable, ROOT / "benchmarks" / script, *map(str, options), "--json"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_components_are_compared_with_bsplines_and_peers():
    facts = facts_of("compare.py", "--problems", "3", "--peer-problems", "1")
    assert len(facts["problems"]) == 3
    for problem in facts["problems"]:
        for name in ("pca_arm_effort_only", "bspline"):
            assert problem[name]["feasible"]
            for fact in ("effort_cost", "solve_time_s", "iterations"):
                assert problem[name][fact] > 0
    peers = {"promp", "dmp", "fddp"}
    assert peers <= set(facts["absent"]) | set(facts["methods"])
    (table,) = facts["tables"].values()
    rows = {row[0]: dict(zip(table["header"], row, strict=True)) for row in table["rows"]}
    assert {"bspline", "minimum_jerk", *peers} - set(facts["absent"]) <= set(rows)
    assert float(rows["bspline"]["cost ratio"]) > 1.0


def test_the_case_study_of_the_paper(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    options = ("--motions", "4", "--starts", "5", "--output", tmp_path)
    tables = facts_of("paper_case_study.py", *options)["tables"]
    shares = tables["Table 2: variance of the joint angles [%]"]
    column = shares["header"].index("sum")
    assert min(float(row[column]) for row in shares["rows"]) > 98.0
    raised = tables["Table 3: the arm-raising motion"]
    rows = {row[0]: dict(zip(raised["header"], row, strict=True)) for row in raised["rows"]}
    assert rows["paper: PCA"]["effort [N²m²s]"] == "9.588"
    assert rows["paper: PCA"]["time ratio"] == "0.648"
    every = tables["Table 3, all motions, each left out: medians"]
    errors = {
        row[0]: float(row[every["header"].index("angle error [deg]")]) for row in every["rows"]
    }
    assert errors["planned, ρ = 1"] < errors["least-effort B-splines"]
    for name in ("figure_2.png", "figures_3_4.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_efforts_that_mujoco_measures_are_those_that_plans_state(tmp_path):
    pytest.importorskip("mujoco", reason="MuJoCo (extra 'peers') is not installed")
    folder = tmp_path / "universal_robots_ur5e"
    folder.mkdir()
    (folder / "ur5e.xml").write_text(ARM, encoding="utf-8")
    options = ("--arms", "ur5e", "--models", tmp_path, "--goals", "3")
    (table,) = facts_of("mujoco_arms.py", *options)["tables"].values()
    exact, _ = (dict(zip(table["header"], row, strict=True)) for row in table["rows"])
    assert exact["arrived [%]"] == "100"
    ratios = (float(exact[name]) for name in ("effort / stated, median", "least", "most"))
    assert all(0.97 < ratio < 1.03 for ratio in ratios)
    assert float(exact["saved by ρ = 0 over ρ = 1 [%]"]) > 0.0
