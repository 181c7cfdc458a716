# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The examples run; that with a node is run by test/ros/test_learn_by_trials.py."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from support.patience import HANG

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["own_objective", "several_targets"])
def test_example_runs(name, tmp_path):
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
