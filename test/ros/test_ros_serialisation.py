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
from mp_pca_planner.recordings.load import load_recordings

NAMES = ["a", "bc", "d"]
NUMBERS = [0.1, 0.2, 0.3]


def write(path, topic, messages):
    kind = f"{type(messages[0]).__module__.split('.')[0]}/msg/{type(messages[0]).__name__}"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        connection = writer.add_connection(topic, kind, typestore=store)
        for i, message in enumerate(messages):
            message.header.stamp.sec = 100 + i
            writer.write(connection, 10**18 + i * 10**9, bytes(serialize_message(message)))
    return path


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
    path = write(tmp_path / "bag", "/joint_states", [state] * 5)
    with open_bag(path) as bag:
        assert bag.joint_states("/joint_states").n_messages == 5


def test_a_length_that_was_damaged_is_no_spare_room(tmp_path):
    state = JointState(name=NAMES, position=NUMBERS, velocity=NUMBERS, effort=NUMBERS)
    data = bytearray(serialize_message(state))
    efforts = data.rindex(len(NAMES).to_bytes(4, "little"))
    data[efforts : efforts + 4] = bytes(4)
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        connection = writer.add_connection(
            "/joint_states", "sensor_msgs/msg/JointState", typestore=store
        )
        writer.write(connection, 10**18, bytes(data))
    found = load_recordings([path])
    (refusal,) = found.refused
    assert "size mismatch" in refusal.reason
