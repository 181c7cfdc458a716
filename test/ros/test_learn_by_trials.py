# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The example learn_by_trials.py beside a node and a simulated robot with an unknown load."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")

from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import running_node
from support.patience import HANG

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import load_primitive, save_primitive

pytestmark = pytest.mark.slow
EXAMPLE = Path(__file__).parents[2] / "examples" / "learn_by_trials.py"
URDF = str(config_file("human_arm.urdf"))


def test_trials_are_executed_and_their_efforts_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 68)
    primitive = tmp_path / "arm.npz"
    save_primitive(arm_primitive(), primitive)
    robot = [sys.executable, "-m", "mp_pca_planner", "simulate", "--robot", URDF]
    arguments = ("-p", f"primitives:=['{primitive}']", "-p", f"max_solve_time:={HANG}")
    with (
        running_node(tmp_path / "node.txt", *arguments),
        subprocess.Popen([*robot, "--payload", "0.8"], stdout=subprocess.DEVNULL) as simulated,
    ):
        try:
            done = subprocess.run(
                [sys.executable, EXAMPLE, primitive, URDF, "4"],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                timeout=HANG,
                check=False,
            )
        finally:
            simulated.kill()
    assert done.returncode == 0, done.stderr
    planned, n_trials, best = map(float, re.findall(r" ([\d.]+)", done.stdout))
    assert n_trials == 4 and 0.0 < best <= planned
    assert load_primitive(tmp_path / "learned.npz").joint_names == tuple(JOINTS)
