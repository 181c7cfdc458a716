# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags whose joint states are a field of messages that only the bag defines."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.bags import Message, Messages, write_messages

TOPIC, FIELD, KIND = "/multi", "arm.jointStates", "my_msgs/msg/Multi"
_LINE = "=" * 80 + "\nMSG: "
_TYPES = {
    "my_msgs/Arm": "string label\nsensor_msgs/JointState jointStates\n",
    "sensor_msgs/JointState": "std_msgs/Header header\nstring[] name\n"
    "float64[] position\nfloat64[] velocity\nfloat64[] effort\n",
}
_OF_ROS1 = {"std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id\n"}
_OF_ROS2 = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
}


def write_embedded_bag(path: Path, bag_format: str, states: Iterable[Message]) -> Path:
    """Write states into the field FIELD of messages on TOPIC; return the path with its suffix."""
    parts = _TYPES | (_OF_ROS1 if bag_format == "rosbag1" else _OF_ROS2)
    text = "std_msgs/Header header\nmy_msgs/Arm arm\n"
    text += "".join(f"{_LINE}{name}\n{fields}" for name, fields in parts.items())
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, KIND))
    messages = Messages(bag_format, store)
    entries = []
    for state in states:
        joints = messages.joint_state(state)
        arm = messages.make("my_msgs/msg/Arm", label="left", jointStates=joints)
        message = messages.make(KIND, header=joints.header, arm=arm)
        entries.append((TOPIC, KIND, state.received, message))
    return write_messages(path, messages, entries)
