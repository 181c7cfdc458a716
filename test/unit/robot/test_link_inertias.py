# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inertias of links against models that Pinocchio builds from changed descriptions."""

import numpy as np

from mp_pca_planner.robot.model import Robot


def two_links(mass, tip_mass, tip, izz):
    """A hinge; on its rod a tip with a tilted inertia behind a fixed joint, and a locked one."""
    return f"""<robot name="rod"><link name="world"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="{mass!r}"/>
    <inertia ixx="0.2" iyy="0.3" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><origin xyz="0.1 0 0.2" rpy="0.3 0 0.5"/><mass value="{tip_mass!r}"/>
    <inertia ixx="{0.02 * tip!r}" iyy="{0.03 * tip!r}" izz="{0.02 * tip!r}"
      ixy="{0.005 * tip!r}" ixz="0" iyz="0"/></inertial></link>
  <link name="jaw"><inertial><mass value="0.3"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="world"/><child link="rod"/>
    <axis xyz="0.6 0 0.8"/><limit lower="-3" upper="3" velocity="10" effort="100"/></joint>
  <joint name="weld" type="fixed"><parent link="rod"/><child link="tip"/>
    <origin xyz="0.2 0.1 -1" rpy="0.1 0.2 0.3"/></joint>
  <joint name="grip" type="prismatic"><parent link="tip"/><child link="jaw"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.1" velocity="1" effort="10"/></joint>
</robot>"""


def efforts(robot):
    """Of random states."""
    q, v, a = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 8, robot.n_joints))
    return robot.inverse_dynamics(q, v, a)


def test_changed_links_move_as_a_robot_described_so():
    robot = Robot(two_links(2.0, 0.7, 1.0, 0.4), ["hinge"])
    # Also behind fixed and locked joints.
    assert tuple(robot.link_inertias) == ("rod", "tip", "jaw")
    factors = np.ones((3, 4))
    factors[0, 0] = 1.1
    # Principal moments are in increasing order: izz is the largest of the rod.
    factors[0, 3] = 0.7
    factors[1] = 0.8, 1.3, 1.3, 1.3
    expected = Robot(two_links(2.2, 0.56, 1.3, 0.28), ["hinge"])
    changed = robot.with_link_inertias(factors)
    np.testing.assert_allclose(efforts(changed), efforts(expected), rtol=1e-12)


def test_body_without_mass_keeps_its_moments_of_inertia():
    def massless(izz):
        urdf = two_links(0.0, 0.0, 0.0, izz).replace('value="0.3"', 'value="0.0"')
        return Robot(urdf, ["hinge"])

    factors = np.ones((3, 4))
    factors[0, 3] = 1.5
    changed = massless(0.4).with_link_inertias(factors)
    np.testing.assert_allclose(efforts(changed), efforts(massless(0.6)), rtol=1e-12)
