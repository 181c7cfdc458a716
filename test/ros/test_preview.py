# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot in the preview: its visual shapes in the last pose of the motion."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from scipy.spatial.transform import Rotation
from support.arm import URDF, arm_demonstrations, arm_robot
from visualization_msgs.msg import Marker

from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.ros.preview import shape_markers, to_preview

MESHES = """
<robot name="r">
  <link name="wrist">
    <visual><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><geometry>
      <mesh filename="package://arm/hand.dae" scale="2 2 2"/></geometry></visual>
    <visual><geometry><mesh filename="/tmp/tool.stl"/></geometry></visual>
    <visual><geometry><sphere radius="0.05"/></geometry></visual>
    <visual><geometry><cylinder radius="0.05" length="0.3"/></geometry></visual>
    <visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
    <visual><origin xyz="0 0"/><geometry><sphere radius="0.05"/></geometry></visual>
    <visual><geometry><sphere radius="wide"/></geometry></visual>
    <visual><geometry><sphere radius="nan"/></geometry></visual>
    <visual><geometry><capsule radius="0.1"/></geometry></visual>
    <visual/>
  </link>
  <link name="elsewhere"><visual><geometry><sphere radius="1"/></geometry></visual></link>
</robot>"""
MOTION = arm_demonstrations()[0]


def numbers(message: object, fields: str) -> list[float]:
    return [getattr(message, field) for field in fields]


def test_shapes_stand_where_their_links_are_and_wrong_ones_are_left_out() -> None:
    robot, q = arm_robot(), MOTION.positions[-1]
    first, *others = shape_markers(robot, MESHES, q)
    origin = Rotation.from_euler("xyz", [0.4, -0.5, 0.6]).as_matrix()
    corners = np.array([0.1, 0.2, 0.3]) + np.vstack([np.zeros(3), origin.T])
    points = robot.attach_points(["wrist"] * 4, corners)
    ((expected,), _) = points.positions_and_jacobians(q[None])
    np.testing.assert_allclose(numbers(first.pose.position, "xyz"), expected[0], atol=1e-12)
    turn = Rotation.from_quat(numbers(first.pose.orientation, "xyzw")).as_matrix()
    np.testing.assert_allclose(turn, (expected[1:] - expected[0]).T, atol=1e-12)
    markers = [first, *others]
    assert [marker.id for marker in markers] == list(range(5))
    found = [(one.type, one.mesh_resource, *numbers(one.scale, "xyz")) for one in markers]
    assert found == [
        (Marker.MESH_RESOURCE, "package://arm/hand.dae", 2.0, 2.0, 2.0),
        (Marker.MESH_RESOURCE, "file:///tmp/tool.stl", 1.0, 1.0, 1.0),
        (Marker.SPHERE, "", 0.1, 0.1, 0.1),
        (Marker.CYLINDER, "", 0.1, 0.1, 0.3),
        (Marker.CUBE, "", 0.1, 0.2, 0.3),
    ]


def test_preview_shows_every_shape_in_the_base_frame() -> None:
    motion = Trajectory(
        MOTION.joint_names, MOTION.times, MOTION.positions, MOTION.velocities, MOTION.accelerations
    )
    preview = to_preview(motion, arm_robot(), "wrist", URDF)
    shapes = [marker for marker in preview.markers if marker.ns == "last_pose"]
    n_visuals = len(ET.fromstring(URDF).findall("link/visual"))
    assert n_visuals > 0
    assert len(shapes) == n_visuals
    assert {marker.header.frame_id for marker in preview.markers} == {"chest"}
