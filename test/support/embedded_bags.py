# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags whose joint states are a field of messages that only the bag defines."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.bags import Message, S, bag_writer

TOPIC, FIELD = "/multi", "arm.jointStates"

MULTI = """std_msgs/Header header
my_msgs/Arm arm
================================================================================
MSG: my_msgs/Arm
string label
sensor_msgs/JointState jointStates
================================================================================
MSG: sensor_msgs/JointState
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
{header}time stamp
string frame_id
"""


def write_embedded_bag(path: Path, bag_format: str, states: Iterable[Message]) -> Path:
    """Write states into the field FIELD of messages on TOPIC; return the path with its suffix."""
    ros1 = bag_format == "rosbag1"
    text = MULTI.format(header="uint32 seq\n" if ros1 else "builtin_interfaces/Time ")
    if not ros1:
        text = text.replace("Time time stamp", "Time stamp")
        text += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "my_msgs/msg/Multi"))
    types = store.types
    path, writer = bag_writer(path, bag_format)
    serialise = store.serialize_ros1 if ros1 else store.serialize_cdr
    nothing = np.empty(0)
    with writer:
        connection = writer.add_connection(TOPIC, "my_msgs/msg/Multi", typestore=store)
        for state in states:
            stamp = types["builtin_interfaces/msg/Time"](*divmod(state.stamp, S))
            header = types["std_msgs/msg/Header"](*((0,) if ros1 else ()), stamp, "")
            numbers = np.array(state.positions, dtype=float)
            joints = types["sensor_msgs/msg/JointState"](
                header, list(state.names), numbers, nothing, nothing
            )
            message = types["my_msgs/msg/Multi"](header, types["my_msgs/msg/Arm"]("left", joints))
            received = state.stamp if state.receive is None else state.receive
            writer.write(connection, received, serialise(message, "my_msgs/msg/Multi"))
    return path
