# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages as ROS 2 itself serialises them are read from bags, whichever fields are empty."""

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from mp_pca_planner.recordings.bags import open_bag

NAMES = ["a", "bc", "d"]
NUMBERS = [0.1, 0.2, 0.3]


@pytest.mark.parametrize("velocity", [[], NUMBERS])
@pytest.mark.parametrize("effort", [[], NUMBERS])
@pytest.mark.parametrize("n_joints", [1, 2, 3])
def test_joint_states_are_read_whatever_is_empty(tmp_path, velocity, effort, n_joints):
    state = JointState(
        name=NAMES[:n_joints],
        position=NUMBERS[:n_joints],
        velocity=velocity[:n_joints],
        effort=effort[:n_joints],
    )
    store, path = get_typestore(Stores.ROS2_JAZZY), tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for k in range(5):
            state.header.stamp.sec = 100 + k
            writer.write(connection, 10**18 + k * 10**9, bytes(serialize_message(state)))
    with open_bag(path) as bag:
        assert bag.joint_states("/joint_states").n_messages == 5
