# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee of planned motions, against a pendulum's closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.dense import minimum_jerk_motion
from support.motion_referee import RigidArm, judge
from support.problems import Problem

from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.robot.model import Robot

MASS, LENGTH, GRAVITY = 2.0, 0.5, 9.81
WAY, DURATION = 0.8, 1.5

# A point mass on a rod without mass: the efforts are m l² a + m g l sin q.
PENDULUM = f"""
<robot name="pendulum">
  <link name="base"/>
  <link name="rod">
    <inertial><origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
  </link>
  <joint name="hinge" type="{{kind}}">
    <parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="100" effort="1000"/>
  </joint>
</robot>
"""


@pytest.fixture(params=["revolute", "continuous"])
def pendulum(request, tmp_path) -> RigidArm:
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM.format(kind=request.param), encoding="utf-8")
    return RigidArm(path, ["hinge"])


def limits(**values: float) -> JointLimits:
    return JointLimits(["hinge"], {"hinge": values})


def motion(n_points: int = 16) -> Trajectory:
    return minimum_jerk_motion(["hinge"], [0.0], [WAY], DURATION, n_points)


def efforts(n: int = 100_001) -> np.ndarray:
    """Of the motion, by the formula."""
    q, _, a = (x[:, 0] for x in motion(n).states)
    return MASS * LENGTH**2 * a + MASS * GRAVITY * LENGTH * np.sin(q)


PROBLEM = Problem(np.zeros(1), np.array([WAY]), DURATION)


def test_costs_are_those_of_the_pendulums_efforts(pendulum):
    still = Trajectory(["hinge"], [0.0, 2.0], [[0.4], [0.4]], np.zeros((2, 1)), np.zeros((2, 1)))
    verdict = judge(still, Problem(np.array([0.4]), np.array([0.4]), 2.0), pendulum, limits())
    weight = MASS * GRAVITY * LENGTH * np.sin(0.4)
    assert verdict.effort_cost == pytest.approx(0.5 * weight**2 * 2.0, rel=1e-12)
    assert verdict.feasible
    expected = 0.5 * np.mean(efforts() ** 2) * DURATION
    found = judge(motion(), PROBLEM, pendulum, limits()).effort_cost
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("key", "peak"),
    [
        ("max_velocity", 15 / 8 * WAY / DURATION),
        ("max_acceleration", 10 / np.sqrt(3) * WAY / DURATION**2),
        ("max_jerk", 60 * WAY / DURATION**3),
        ("max_effort", np.abs(efforts()).max()),
    ],
)
def test_violation_is_the_relative_excess_of_the_known_peak(pendulum, key, peak):
    for excess in (1e-5, 0.1):
        # Of three points, the peaks are between them.
        verdict = judge(motion(3), PROBLEM, pendulum, limits(**{key: peak / (1 + excess)}))
        assert verdict.limit_violation == pytest.approx(excess, rel=0.03)
        assert key.removeprefix("max_") in verdict.worst_limit
        assert not verdict.feasible
    verdict = judge(motion(), PROBLEM, pendulum, limits(**{key: peak * 1.0001}))
    assert verdict.limit_violation == 0.0 and verdict.feasible
    # The jerk and the effort peak at the ends.
    assert verdict.limits_active == (key in ("max_velocity", "max_acceleration"))


def test_missed_ends_and_end_velocities_are_not_feasible(pendulum):
    beside = replace(PROBLEM, start=np.array([0.01]))
    verdict = judge(motion(), beside, pendulum, limits())
    assert verdict.end_error == pytest.approx(0.01) and not verdict.feasible
    m = motion()
    moving = Trajectory(m.joint_names, m.times, m.positions, m.velocities + 0.05, m.accelerations)
    verdict = judge(moving, PROBLEM, pendulum, limits())
    assert verdict.end_velocity == pytest.approx(0.05) and not verdict.feasible


def test_referee_and_robot_agree_on_a_real_arm_with_joints_in_any_order():
    path = Path(__file__).parents[3] / "config/human_arm.urdf"
    names = ("elbow", "shoulder2", "shoulder1", "shoulder3")
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 4))
    expected = Robot.from_file(path, names).inverse_dynamics(q, v, a)
    np.testing.assert_allclose(RigidArm(path, names).efforts(q, v, a), expected, rtol=1e-9)
