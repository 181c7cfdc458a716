# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Serialised joint states are read as if each of them had been deserialised."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.ros import state_reader
from mp_pca_planner.ros.messages import to_state
from mp_pca_planner.ros.state_reader import SerializedStateReader

WANTED = ("elbow", "shoulder")
NUMBERS = st.floats(-1e3, 1e3) | st.sampled_from([np.nan, np.inf])


@st.composite
def joint_states(draw):
    """Of a few publishers, some of whose messages can't be used."""
    names = draw(
        st.sampled_from(
            [
                ["shoulder", "elbow"],
                ["gripper", "elbow", "shoulder"],
                ["elbow", "elbow", "shoulder"],
                ["elbow"],
            ]
        )
    )
    lengths = st.sampled_from([len(names), len(names), 0, 1])
    position, velocity, effort = (
        draw(st.lists(NUMBERS, min_size=n, max_size=n)) for n in (draw(lengths) for _ in range(3))
    )
    message = JointState(name=names, position=position, velocity=velocity, effort=effort)
    message.header.stamp.sec = draw(st.integers(0, 1000))
    message.header.frame_id = draw(st.sampled_from(["", "base", "base_link"]))
    return bytes(serialize_message(message))


def outcome(read, *arguments):
    try:
        state = read(*arguments)
    except GoalError as error:
        return str(error)
    return state.joint_names, state.positions.tolist(), state.velocities.tolist()


@given(st.lists(joint_states(), min_size=1, max_size=8))
def test_slicing_equals_deserialising(messages):
    reader = SerializedStateReader()
    for message in messages * 2:
        expected = outcome(to_state, deserialize_message(message, JointState), WANTED)
        assert outcome(reader.read, message, WANTED) == expected


def test_messages_that_are_alike_are_not_deserialised(monkeypatch):
    reader, n_read = SerializedStateReader(), []

    def deserialize(message, kind):
        n_read.append(message)
        return deserialize_message(message, kind)

    monkeypatch.setattr(state_reader, "deserialize_message", deserialize)
    for k in range(5):
        state = JointState(
            name=["a", *WANTED], position=[9.0, 0.1 * k, 0.2], velocity=[9.0, 1.0, k]
        )
        state.header.stamp.sec = k
        found = reader.read(bytes(serialize_message(state)), WANTED)
        assert found.positions.tolist() == [0.1 * k, 0.2]
        assert found.velocities.tolist() == [1.0, k]
    assert len(n_read) == 1


@given(joint_states(), st.data())
def test_damaged_messages_are_ignored_or_refused(message, data):
    reader = SerializedStateReader()
    if data.draw(st.booleans()):
        reader.names_all(message, WANTED)
    size = data.draw(st.integers(0, len(message)))
    damaged = bytearray(message[:size])
    for _ in range(data.draw(st.integers(0, 5)) if size else 0):
        damaged[data.draw(st.integers(0, size - 1))] = data.draw(st.integers(0, 255))
    if reader.names_all(bytes(damaged), WANTED):
        outcome(reader.read, bytes(damaged), WANTED)


def test_message_that_is_far_too_large_is_ignored():
    state = JointState(name=[*WANTED, *map(str, range(100_000))], position=[0.0] * 100_002)
    assert not SerializedStateReader().names_all(bytes(serialize_message(state)), WANTED)
