# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The bag that grows: readable after every write, and continued by the next process."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from support.bags import EPOCH, S

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.bags import open_bag
from mp_pca_planner.teaching.session import GrowingBag

TOPIC = "/joint_states"
STORE = get_typestore(Stores.ROS2_JAZZY)
KIND = "sensor_msgs/msg/JointState"


def states(first: int, n: int) -> list[tuple[int, bytes]]:
    """Joint states as they come from the middleware; their first position is their number."""
    found = []
    for number in range(first, first + n):
        stamp = EPOCH + number * S // 100
        time = STORE.types["builtin_interfaces/msg/Time"](*divmod(stamp, S))
        header = STORE.types["std_msgs/msg/Header"](time, "")
        rows = (np.array([number, -1.0]), np.empty(0), np.empty(0))
        message = STORE.types[KIND](header, ["a", "b"], *rows)
        found.append((stamp, bytes(STORE.serialize_cdr(message, KIND))))
    return found


def write(path: Path, *batches: Sequence[tuple[int, bytes]]) -> None:
    bag = GrowingBag(path, TOPIC)
    for batch in batches:
        bag.append(batch)
    bag.close()


def numbers(path: Path) -> list[float]:
    """Numbers of the stored joint states, by this package's reader."""
    with open_bag(path, salvage=True) as bag:
        layouts = bag.joint_states(TOPIC).layouts
    return layouts[0].positions[:, 0].tolist() if layouts else []


def test_an_independent_reader_finds_what_was_written(tmp_path: Path) -> None:
    path, given = tmp_path / "growing.mcap", states(0, 7)
    write(path, given[:3], given[3:])
    with AnyReader([path]) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == (TOPIC, KIND)
        assert [(stamp, data) for _, stamp, data in reader.messages()] == given
        assert reader.deserialize(given[4][1], KIND).position[0] == 4.0


def test_the_file_is_readable_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "growing.mcap"
    bag = GrowingBag(path, TOPIC)
    assert numbers(path) == []
    bag.append(states(0, 2))
    assert numbers(path) == [0.0, 1.0]
    bag.append(states(2, 1))
    assert numbers(path) == [0.0, 1.0, 2.0]
    bag.close()


@given(share=st.floats(0.0, 1.0))
def test_a_process_killed_within_a_write_loses_messages_of_that_write_only(share: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "growing.mcap")
        write(path, states(0, 3))
        before = path.read_bytes()
        write(path, states(3, 2))
        after = path.read_bytes()
        # A kill leaves what was written up to it, and what stood behind it before.
        n = int(share * len(after))
        path.write_bytes(after[:n] + before[n:])
        write(path, states(5, 1))
        found = numbers(path)
        assert found[:3] == [0.0, 1.0, 2.0]
        assert found[3:-1] == [3.0, 4.0][: len(found) - 4]
        assert found[-1] == 5.0


def test_a_file_killed_at_its_start_is_started_again(tmp_path: Path) -> None:
    path = tmp_path / "growing.mcap"
    write(path)
    complete = path.read_bytes()
    for n in range(len(complete)):
        path.write_bytes(complete[:n])
        write(path)
        assert path.read_bytes() == complete


def test_only_one_process_records_into_a_file(tmp_path: Path) -> None:
    path = tmp_path / "growing.mcap"
    bag = GrowingBag(path, TOPIC)
    with pytest.raises(RecordingError, match="being recorded by another process"):
        GrowingBag(path, TOPIC)
    bag.close()
    write(path, states(0, 1))


def test_files_of_others_and_of_other_topics_are_left_alone(tmp_path: Path) -> None:
    own, other = tmp_path / "own.mcap", tmp_path / "other.mcap"
    write(own, states(0, 1))
    other.write_bytes(b"\x89MCAP0\r\nanother program's")
    before = own.read_bytes(), other.read_bytes()
    with pytest.raises(RecordingError, match="recorded from the topic '/joint_states', not '/x'"):
        GrowingBag(own, "/x")
    with pytest.raises(RecordingError, match="was not recorded by 'teach'"):
        GrowingBag(other, TOPIC)
    with pytest.raises(RecordingError, match="can't be written: No such file"):
        GrowingBag(tmp_path / "none" / "new.mcap", TOPIC)
    assert (own.read_bytes(), other.read_bytes()) == before
