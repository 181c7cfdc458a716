# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Slicing many messages gives what deserialising each of them gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from mp_pca_planner.recordings.bags.serialisation import decoder, known_types
from mp_pca_planner.recordings.joint_states import RawJointStates, read_layout, slice_joint_states

JOINT_STATE = "sensor_msgs/msg/JointState"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
WAYS = ("ros1", "cdr little endian", "cdr big endian")

names = st.lists(st.text(max_size=6), max_size=4)
numbers = st.lists(st.floats(width=64), max_size=4)


@st.composite
def publishers(draw: st.DrawFn) -> list[dict[str, Any]]:
    """Publishers of joint states; what they publish is mostly well-formed."""
    kinds = []
    for _ in range(draw(st.integers(1, 3))):
        listed = draw(names)
        exact = st.lists(st.floats(width=64), min_size=len(listed), max_size=len(listed))
        kinds.append(
            {
                "frame": draw(st.text(max_size=5)),
                "name": listed,
                "position": draw(exact | numbers),
                "velocity": draw(exact | numbers),
                "effort": draw(numbers),
            }
        )
    order = draw(st.lists(st.integers(0, len(kinds) - 1), min_size=1, max_size=30))
    return [kinds[index] for index in order]


def serialised(kinds: list[dict[str, Any]], way: str, seed: int) -> list[bytes]:
    """Serialise a message of each kind, with a stamp and noise of its own."""
    generator = np.random.default_rng(seed)
    store = ROS1 if way == "ros1" else ROS2
    messages = []
    for index, kind in enumerate(kinds):
        seconds, nanoseconds = generator.integers(-(2**31), 2**31), generator.integers(2**32)
        stamp = store.types["builtin_interfaces/msg/Time"](int(seconds), int(nanoseconds))
        extra = (index,) if way == "ros1" else ()
        header = store.types["std_msgs/msg/Header"](*extra, stamp, kind["frame"])
        fields = [
            np.array(kind[field], dtype=np.float64) * generator.normal()
            for field in ("position", "velocity", "effort")
        ]
        message = store.types[JOINT_STATE](header, kind["name"], *fields)
        if way == "ros1":
            messages.append(bytes(ROS1.serialize_ros1(message, JOINT_STATE)))
        else:
            little = way == "cdr little endian"
            messages.append(bytes(ROS2.serialize_cdr(message, JOINT_STATE, little_endian=little)))
    return messages


def deserialiser(way: str) -> Callable[[bytes], Any]:
    bag_format = "rosbag1" if way == "ros1" else "mcap"
    decode = decoder(known_types(bag_format), bag_format)
    return lambda data: decode(data, JOINT_STATE)


def sliced(messages: list[bytes], way: str, part: int = 4096) -> RawJointStates:
    stored = ((None, stamp, message) for stamp, message in enumerate(messages))
    return slice_joint_states("/x", stored, ros1=way == "ros1", part_messages=part)


def assert_same_as_deserialised(raw: RawJointStates, messages: list[bytes], way: str) -> None:
    expected: dict[tuple[str, ...], list[tuple[int, Any]]] = {}
    stamps, n_malformed = [], 0
    for index, data in enumerate(messages):
        message = deserialiser(way)(data)
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        own = tuple(message.name)
        if len(message.position) != len(own) or len(set(own)) != len(own):
            n_malformed += 1
        else:
            expected.setdefault(own, []).append((index, message))
    np.testing.assert_array_equal(raw.header_stamps, stamps)
    np.testing.assert_array_equal(raw.receive_stamps, np.arange(len(messages)))
    assert raw.n_malformed == n_malformed
    assert [layout.joint_names for layout in raw.layouts] == list(expected)
    for layout in raw.layouts:
        rows = expected[layout.joint_names]
        np.testing.assert_array_equal(layout.messages, [index for index, _ in rows])
        for row, (_, message) in enumerate(rows):
            np.testing.assert_array_equal(layout.positions[row], message.position)
            with np.errstate(over="ignore"):
                velocity = np.asarray(message.velocity).astype(np.float32)
            if layout.velocities is None:
                assert velocity.size != len(layout.joint_names) or np.isnan(velocity).all()
            elif velocity.size == len(layout.joint_names):
                np.testing.assert_array_equal(layout.velocities[row], velocity)
            else:
                assert np.isnan(layout.velocities[row]).all()


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("way", WAYS)
@given(kinds=publishers(), seed=st.integers(0, 99), part=st.sampled_from([1, 3, 1000]))
def test_slicing_equals_deserialising(
    way: str, kinds: list[dict[str, Any]], seed: int, part: int
) -> None:
    messages = serialised(kinds, way, seed)
    assert_same_as_deserialised(sliced(messages, way, part), messages, way)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.filterwarnings("ignore:invalid value")
@settings(max_examples=100)
@given(kinds=publishers(), seed=st.integers(0, 99), data=st.data())
def test_damaged_messages_are_read_as_the_deserialiser_reads_them_or_not_at_all(
    way: str, kinds: list[dict[str, Any]], seed: int, data: st.DataObject
) -> None:
    messages = serialised(kinds, way, seed)
    for _ in range(data.draw(st.integers(1, 4))):
        which = data.draw(st.integers(0, len(messages) - 1))
        damaged = bytearray(messages[which])
        if damaged and data.draw(st.booleans()):
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        else:
            damaged = damaged[: data.draw(st.integers(0, len(damaged)))]
        messages[which] = bytes(damaged)
    try:
        for message in messages:
            deserialiser(way)(message)
    except Exception:
        # Whatever rosbags raises, the collector must not hide it.
        with pytest.raises(Exception):  # noqa: B017, PT011
            sliced(messages, way)
    else:
        assert_same_as_deserialised(sliced(messages, way), messages, way)


@pytest.mark.parametrize("way", WAYS)
def test_messages_of_many_kinds_and_one_size_are_all_sliced(way: str) -> None:
    kinds = [
        {"frame": "", "name": [f"{i:03}"], "position": [i], "velocity": [], "effort": []}
        for i in range(100)
    ]
    messages = serialised(kinds + kinds, way, 0)
    assert_same_as_deserialised(sliced(messages, way), messages, way)


def test_padding_may_hold_anything() -> None:
    kind = {"frame": "abc", "name": ["a"], "position": [1.0], "velocity": [2.0], "effort": []}
    messages = serialised([kind] * 3, "cdr little endian", 1)
    layout = read_layout(messages[0], ros1=False)
    assert layout.velocity is not None
    same = np.zeros(len(messages[0]), dtype=bool)
    for part in layout.fixed:
        same[part] = True
    for start, size in ((layout.stamp, 8), (layout.position, 8), (layout.velocity, 8)):
        same[start : start + size] = True
    padded = np.frombuffer(messages[1], dtype=np.uint8).copy()
    padded[~same] = 0xAA
    assert np.count_nonzero(~same) > 0
    assert layout.fits(padded[np.newaxis]).all()
    assert deserialiser("cdr little endian")(padded.tobytes()).name == ["a"]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("share", np.linspace(0.0, 0.99, 12))
def test_cut_off_message_has_no_layout(way: str, share: float) -> None:
    kind = {"frame": "f", "name": ["a", "b"], "position": [1, 2], "velocity": [], "effort": [1]}
    (message,) = serialised([kind], way, 0)
    with pytest.raises(ValueError):  # noqa: PT011  # Any part of it may be missing.
        read_layout(message[: int(share * len(message))], ros1=way == "ros1")
