# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states are read, ignored or refused, whatever their bytes are."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from support.patience import HANG

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.ros import safety_thread
from mp_pca_planner.ros.messages import read_states, to_state

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
    message.header.stamp.nanosec = draw(st.integers(0, 999_999_999))
    message.header.frame_id = draw(st.sampled_from(["", "base", "base_link"]))
    return bytes(serialize_message(message))


@given(joint_states())
def test_states_are_read_as_rclpy_reads_them(message):
    assert repr(read_states(message)) == repr(deserialize_message(message, JointState))


@given(joint_states(), st.data())
def test_damaged_states_are_ignored_or_refused(message, data):
    size = data.draw(st.integers(0, len(message)))
    damaged = bytearray(message[:size])
    for _ in range(data.draw(st.integers(0, 5)) if size else 0):
        damaged[data.draw(st.integers(0, size - 1))] = data.draw(st.integers(0, 255))
    states = read_states(bytes(damaged))
    try:
        state = to_state(states, WANTED)
    except GoalError:
        return
    assert np.isfinite([state.positions, state.velocities]).all()


@pytest.mark.parametrize("n", [1_001, 3_000, 100_000])
def test_states_that_are_far_too_large_are_ignored(n):
    def read(n):
        names = [*WANTED, *map(str, range(n - len(WANTED)))]
        return read_states(bytes(serialize_message(JointState(name=names, position=[0.0] * n))))

    assert read(n).name == []
    assert len(read(1_000).name) == 1_000


def test_velocity_that_is_nan_was_not_measured():
    """joint_state_broadcaster publishes NaN where the hardware has none."""
    names = [*WANTED, "gripper"]
    velocity = [np.nan, 0.3, np.nan]
    message = JointState(name=names, position=[1.0, 2.0, np.nan], velocity=velocity)
    state = to_state(message, WANTED)
    assert state.positions.tolist() == [1.0, 2.0]
    assert state.velocities.tolist() == [0.0, 0.3]
    message.velocity = [np.nan, np.inf, np.nan]
    with pytest.raises(GoalError, match="velocity of joint 'shoulder' is inf"):
        to_state(message, WANTED)


@pytest.fixture
def arriving(monkeypatch):
    """States of the robot, and the messages that wait for them, with their times of receipt."""
    waiting = []

    class Subscription:
        def __init__(self, *_):
            pass

        def poll(self):
            found = [(bytes(serialize_message(x)), {"received_timestamp": t}) for x, t in waiting]
            waiting.clear()
            return found

    monkeypatch.setattr(safety_thread, "PolledSubscription", Subscription)
    states = safety_thread.RobotStates(SimpleNamespace(seconds=time.monotonic))
    states.measured.expect(WANTED)
    states.poll()
    return states, waiting


@pytest.mark.parametrize("clock_set", [-3600.0, 0.0, 3600.0])
def test_age_of_a_state_survives_that_the_wall_clock_is_set(arriving, clock_set):
    states, waiting = arriving
    began = time.monotonic()
    time.sleep(0.05)
    message = JointState(name=list(WANTED), position=[1.0, 2.0])
    waiting.append((message, time.time_ns() - 20_000_000 - round(1e9 * clock_set)))
    states.poll()
    age = states.measured.age
    assert (0.02 if clock_set >= 0.0 else 0.0) <= age <= time.monotonic() - began + 0.05


def test_all_states_that_wait_are_read_for_joints_may_come_in_several(arriving):
    states, waiting = arriving
    for name, position in (("shoulder", 0.5), ("elbow", 0.25)):
        waiting.append((JointState(name=[name], position=[position]), time.time_ns()))
    assert states.measured.newest(HANG).positions.tolist() == [0.25, 0.5]
