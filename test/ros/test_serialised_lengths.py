# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages whose lengths are damaged are rejected before there is room for their items."""

import resource

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import reading
from mp_pca_planner.ros.serialised import read_message

NAMES = ["shoulder", "elbow", "a"]
POINTS = [
    JointTrajectoryPoint(positions=[1.0, 2.0, 3.0], velocities=[4.0], effort=[5.0] * k)
    for k in range(3)
]
POSE = PoseStamped()
POSE.header.frame_id, POSE.pose.position.x = "base", 1.0
STATUS = DiagnosticStatus(
    level=b"\1", name="n", message="m", hardware_id="hh", values=[KeyValue(key="k", value="vvv")]
)
MESSAGES = [
    JointState(name=NAMES, position=[0.1, 0.2, 0.3], velocity=[0.4] * 3, effort=[0.5]),
    JointState(),
    JointTrajectory(joint_names=NAMES, points=POINTS),
    POSE,
    String(data="<robot/>"),
    Float64(data=2.0),
    Empty(),
    Clock(),
    DiagnosticArray(status=[STATUS, STATUS]),
    MarkerArray(markers=[Marker(ns="n", type=Marker.CUBE), Marker(text="text")]),
]


def is_read(content, kind):
    """Whether a message is read; any other error than that of a malformed one is raised."""
    try:
        with reading("it", PlannerError):
            read_message(bytes(content), kind)
    except PlannerError:
        return False
    return True


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: type(one).__name__)
def test_valid_messages_are_read(message):
    assert read_message(bytes(serialize_message(message)), type(message)) == message


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: type(one).__name__)
def test_damaged_lengths_take_no_memory(message):
    good = bytes(serialize_message(message))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    n_rejected = 0
    for place in range(4, len(good) - 3, 4):
        for length in (2**24, 2**27, 2**31 - 1, 2**32 - 1):
            damaged = bytearray(good)
            damaged[place : place + 4] = length.to_bytes(4, "little")
            n_rejected += not is_read(damaged, type(message))
    has_lengths = not isinstance(message, Float64 | Empty | Clock)
    assert (n_rejected > 0) == has_lengths
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: type(one).__name__)
def test_truncated_and_garbled_messages_are_read_or_rejected(message):
    good, random = bytes(serialize_message(message)), np.random.default_rng(1)
    for size in range(len(good)):
        is_read(good[:size], type(message))
    for _ in range(300):
        damaged = bytearray(good)
        for place in random.integers(0, len(good), 4):
            damaged[place] = random.integers(256)
        is_read(damaged, type(message))


def test_other_encodings_are_rejected():
    """Their lengths are at other places."""
    good = bytes(serialize_message(MESSAGES[0]))
    with pytest.raises(ValueError, match="plain CDR"):
        read_message(b"\0\7" + good[2:], JointState)
