# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee of motions among obstacles, against closed forms."""

import numpy as np
import pytest
from support.dense import minimum_jerk_motion
from support.motion_referee import RigidArm, SceneReferee, judge
from support.obstacle_scenes import write_scene
from support.problems import Problem

from mp_pca_planner.robot.limits import JointLimits

LENGTH, RADIUS, TURN, DURATION = 0.8, 0.05, 1.2, 1.5

# A ball on an arm without shape that turns about the vertical.
BALL = f"""
<robot name="ball">
  <link name="base"/>
  <link name="arm">
    <inertial><origin xyz="{LENGTH} 0 0"/><mass value="1"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
    <collision><origin xyz="{LENGTH} 0 0"/>
      <geometry><sphere radius="{RADIUS}"/></geometry></collision>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="100" effort="1000"/>
  </joint>
</robot>
"""


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "ball.urdf"
    path.write_text(BALL, encoding="utf-8")
    return path


def verdict(urdf, obstacle):
    scene = write_scene(urdf.with_name("scene0001.yaml"), [obstacle])
    motion = minimum_jerk_motion(["turn"], [0.0], [TURN], DURATION)
    arm = RigidArm(urdf, ["turn"])
    problem = Problem(np.zeros(1), np.array([TURN]), DURATION, scene=scene)
    surroundings = SceneReferee(arm, urdf, scene)
    return judge(motion, problem, arm, JointLimits(["turn"], {}), surroundings)


def test_clearance_is_that_of_two_balls(urdf):
    # The obstacle is on the arm's circle's radius, further out: nearest where the arm points at it.
    direction = np.array([np.cos(0.6), np.sin(0.6), 0.0])
    found = verdict(urdf, ("ball", "sphere", [0.1], 1.1 * direction))
    assert found.collision == ""
    assert found.clearance == pytest.approx(1.1 - LENGTH - RADIUS - 0.1, abs=1e-4)


@pytest.mark.parametrize(("kind", "sizes"), [("box", [0.2, 0.2, 0.3]), ("cylinder", [0.3, 0.1])])
def test_dimensions_of_solids_are_those_of_planning_scenes(urdf, kind, sizes):
    # Nearest above the obstacle's middle; its half-height is 0.15.
    found = verdict(urdf, ("solid", kind, sizes, [LENGTH, 0.0, -0.4]))
    assert found.clearance == pytest.approx(0.4 - 0.15 - RADIUS, abs=1e-6)


def test_first_contact_is_found_to_a_millisecond(urdf):
    angle, radius = 0.9, 0.06
    place = LENGTH * np.array([np.cos(angle), np.sin(angle), 0.0])
    found = verdict(urdf, ("stone", "sphere", [radius], place))
    # The chord between the centres is the sum of the radii.
    met = angle - 2.0 * np.arcsin((RADIUS + radius) / (2.0 * LENGTH))
    s = np.linspace(0.0, 1.0, 100_001)
    time = DURATION * np.interp(met, TURN * (10 * s**3 - 15 * s**4 + 6 * s**5), s)
    pair, _, moment = found.collision.partition(" at ")
    assert pair == "arm_0 and stone"
    assert float(moment.removesuffix(" s")) == pytest.approx(time, abs=1.1e-3)
    assert found.clearance < 0.0
