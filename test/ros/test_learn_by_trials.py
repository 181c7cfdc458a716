# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The example learn_by_trials.py beside a node and a simulated robot with an unknown load."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("cmaes", reason="cmaes (extra 'learn') is not installed")

from support.arm import JOINTS, arm_primitive, arm_robot
from support.domains import set_domain
from support.nodes import running_node
from support.patience import HANG

from mp_pca_planner.files import config_file
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.file import load_primitive, save_primitive
from mp_pca_planner.simulation.robot import Plant

pytestmark = pytest.mark.slow
EXAMPLE = Path(__file__).parents[2] / "examples" / "learn_by_trials.py"
URDF = str(config_file("human_arm.urdf"))


PAYLOAD, N_TRIALS = 0.8, 13


def test_trials_save_effort_on_a_robot_with_an_unknown_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 68)
    primitive = tmp_path / "arm.npz"
    save_primitive(arm_primitive(), primitive)
    robot = [sys.executable, "-m", "mp_pca_planner", "simulate", "--robot", URDF]
    arguments = ("-p", f"primitives:=['{primitive}']", "-p", f"max_solve_time:={HANG}")
    with (
        running_node(tmp_path / "node.txt", *arguments),
        subprocess.Popen([*robot, "--payload", str(PAYLOAD)], stdout=subprocess.DEVNULL) as arm,
    ):
        try:
            done = subprocess.run(
                [sys.executable, EXAMPLE, primitive, URDF, str(N_TRIALS)],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                timeout=HANG,
                check=False,
            )
        finally:
            arm.kill()
    assert done.returncode == 0, done.stderr
    costs = re.fullmatch(r"planned: (\S+), learned: (\S+) ± (\S+) N²m²s\n", done.stdout)
    assert costs is not None, done.stdout
    planned, learned, noise = map(float, costs.groups())
    assert learned < planned and noise < 0.05 * planned
    learned_primitive = load_primitive(tmp_path / "learned.npz")
    assert learned_primitive.joint_names == tuple(JOINTS)
    # By the dynamics of the loaded arm, the planned motion costs what was measured, and the motion
    # of the new primitive less. A measurement includes up to half a second of rest at both ends.
    ends = arm_primitive().boundary_states[0, [0, 3]]
    motions = [
        Planner(arm_robot(), [one]).plan(start=ends[0], goal=ends[1]).trajectory
        for one in (arm_primitive(), learned_primitive)
    ]
    held = sum(effort(np.tile(q, (2, 1)), np.zeros((2, 4)), np.zeros((2, 4)), 0.5) for q in ends)
    costs = [effort(*one.states, one.duration) for one in motions]
    assert costs[0] < planned < costs[0] + held
    assert costs[1] < 0.98 * costs[0]


def effort(q: np.ndarray, v: np.ndarray, a: np.ndarray, duration: float) -> float:
    """½∫‖τ‖²dt of the loaded arm with its drives, at evenly spaced times."""
    plain = arm_robot()
    inertias = zip(plain.joint_names, Plant(plain, q[0]).inertia, strict=True)
    drives = {name: {"armature": float(x)} for name, x in inertias}
    tau = plain.with_payload(PAYLOAD).with_drives(drives).inverse_dynamics(q, v, a)
    return 0.5 * float(trapezoid(np.sum(tau**2, axis=1), dx=duration / (len(q) - 1)))
