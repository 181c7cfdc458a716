# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states of messages as arrays: what was serialised comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from mp_pca_planner.recordings.bags.serialisation import decoder, known_types
from mp_pca_planner.recordings.joint_states import collect_joint_states

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


def serialised(kinds: list[dict[str, Any]], way: str, seed: int) -> tuple[list[Any], list[bytes]]:
    """A message of each kind, with a stamp and noise of its own, and all serialised."""
    generator = np.random.default_rng(seed)
    store = ROS1 if way == "ros1" else ROS2
    messages, written = [], []
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
        messages.append(message)
        if way == "ros1":
            written.append(bytes(ROS1.serialize_ros1(message, JOINT_STATE)))
        else:
            little = way == "cdr little endian"
            written.append(bytes(ROS2.serialize_cdr(message, JOINT_STATE, little_endian=little)))
    return messages, written


@pytest.mark.parametrize("way", WAYS)
@given(kinds=publishers(), seed=st.integers(0, 99), share=st.floats(0.0, 1.0))
def test_what_was_serialised_comes_back(
    way: str, kinds: list[dict[str, Any]], seed: int, share: float
) -> None:
    bag_format = "rosbag1" if way == "ros1" else "mcap"
    decode = decoder(known_types(bag_format), bag_format)
    messages, written = serialised(kinds, way, seed)
    states = [(stamp, decode(data, JOINT_STATE)) for stamp, data in enumerate(written)]
    part = round(share * len(states))
    first, second = (collect_joint_states("/x", some) for some in (states[:part], states[part:]))
    raw = first.followed_by(second)
    names = [tuple(message.name) for message in messages]
    is_good = [
        len(message.position) == len(own) == len(set(own))
        for message, own in zip(messages, names, strict=True)
    ]
    good = [index for index, fits in enumerate(is_good) if fits]
    stamps = [messages[index].header.stamp for index in good]
    np.testing.assert_array_equal(raw.header_stamps, [x.sec * 10**9 + x.nanosec for x in stamps])
    np.testing.assert_array_equal(raw.receive_stamps, good)
    assert raw.n_malformed == len(messages) - len(good)
    for row, index in enumerate(good):
        own, message = names[index], messages[index]
        columns, others = raw.columns(own), [x for x in raw.joint_names if x not in own]
        np.testing.assert_array_equal(raw.positions[row, columns], message.position)
        assert np.isnan(raw.positions[row, raw.columns(others)]).all()
        assert raw.listed[row].sum() == raw.listed[row, columns].sum() == len(own)
