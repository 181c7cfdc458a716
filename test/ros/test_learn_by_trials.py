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

from support.arm import JOINTS
from support.domains import set_domain
from support.nodes import GOAL, arm_node, simulated_robot
from support.patience import HANG

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import load_primitive

pytestmark = pytest.mark.slow
EXAMPLE = Path(__file__).parents[2] / "examples" / "learn_by_trials.py"
URDF = str(config_file("human_arm.urdf"))
PAYLOAD, N_TRIALS = 0.8, 13


def test_trials_save_effort_on_a_robot_with_an_unknown_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 68)
    with (
        arm_node(max_solve_time=HANG) as (_, folder),
        simulated_robot(folder / "robot.txt", GOAL, "--payload", str(PAYLOAD)),
    ):
        primitive = folder / "primitives" / "arm_0.npz"
        done = subprocess.run(
            [sys.executable, EXAMPLE, primitive, URDF, str(N_TRIALS)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=HANG,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    costs = re.fullmatch(r"planned: (\S+), learned: (\S+) ± (\S+) N²m²s\n", done.stdout)
    assert costs is not None, done.stdout
    planned, learned, noise = map(float, costs.groups())
    assert learned < planned and noise < 0.05 * planned
    learned_primitive = load_primitive(tmp_path / "learned.npz")
    assert learned_primitive.joint_names == tuple(JOINTS)
