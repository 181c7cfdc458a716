# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The examples run, and the whole loop of recording, planning and learning with a node."""

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from support.patience import HANG

EXAMPLES = Path(__file__).parents[2] / "examples"
LOOP = Path(__file__).with_name("learning_loop.py")


def test_learning_loop_plans_executes_records_learns_and_plans_again(tmp_path):
    for module, extra in (("rclpy", "ros"), ("cmaes", "learn"), ("matplotlib", "plot")):
        pytest.importorskip(module, reason=f"{module} (extra '{extra}') is not installed")
    path = os.pathsep.join(map(str, (EXAMPLES.parent, EXAMPLES.parent / "benchmarks")))
    done = subprocess.run(
        [sys.executable, LOOP, "--output", tmp_path, "--trials", "2"],
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
        cwd=EXAMPLES.parent,
        env=os.environ | {"PYTHONPATH": path, "MPLBACKEND": "Agg"},
    )
    assert done.returncode == 0, done.stderr
    planned, best, again = (float(x) for x in re.findall(r"cost ([\d.]+)", done.stdout))
    assert best <= 1.01 * planned and again < 1.1 * planned
    assert {p.name for p in (tmp_path / "bags").iterdir()} == {
        f"{name}.mcap" for name in ("planned", "trial_1", "trial_2", "planned_again")
    }
    assert (tmp_path / "cost_over_trials.png").stat().st_size > 1000


def test_notebook_goes_from_a_recording_to_a_motion(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib (extra 'plot') is not installed")
    (tmp_path / "motion.csv").touch()  # of an earlier run
    done = subprocess.run(
        [sys.executable, EXAMPLES / "notebook.py"],
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(EXAMPLES.parent), "MPLBACKEND": "Agg"},
    )
    assert done.returncode == 0, done.stderr
    assert "Plan: solved" in done.stdout
    made = {"motions.mcap", "raise_arm.npz", "motion.png", "motion.csv"}
    assert {path.name for path in tmp_path.iterdir()} == made


def test_notebook_holds_the_program():
    script = runpy.run_path(str(EXAMPLES.parent / "scripts/execute_notebook.py"))
    program = (EXAMPLES / "notebook.py").read_text(encoding="utf-8")
    notebook = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert ["".join(cell["source"]) for cell in code] == script["cells"](program)
    assert all(cell["execution_count"] for cell in code)


@pytest.mark.parametrize("name", ["own_objective", "several_targets", "learn_by_trials"])
def test_example_runs(name, tmp_path):
    if name == "learn_by_trials":
        pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"],
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(EXAMPLES.parent)},
    )
    assert done.returncode == 0, done.stderr
    assert "N²m²s" in done.stdout


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_example_is_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 40
