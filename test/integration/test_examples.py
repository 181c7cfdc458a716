# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The examples run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from patience import HANG

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_learning_loop_plans_executes_records_learns_and_plans_again(tmp_path):
    for module, extra in (("rclpy", "ros"), ("cmaes", "learn"), ("matplotlib", "plot")):
        pytest.importorskip(module, reason=f"{module} (extra '{extra}') is not installed")
    done = subprocess.run(
        [sys.executable, EXAMPLES / "learning_loop.py", "--output", tmp_path, "--trials", "2"],
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
        cwd=EXAMPLES.parent,
        env=os.environ | {"PYTHONPATH": str(EXAMPLES.parent), "MPLBACKEND": "Agg"},
    )
    assert done.returncode == 0, done.stderr
    planned, best, again = (float(x) for x in re.findall(r"cost ([\d.]+)", done.stdout))
    assert best < planned and again < planned
    assert {p.name for p in (tmp_path / "bags").iterdir()} == {
        f"{name}.mcap" for name in ("planned", "trial_1", "trial_2", "planned_again")
    }
    assert (tmp_path / "cost_over_trials.png").stat().st_size > 1000
