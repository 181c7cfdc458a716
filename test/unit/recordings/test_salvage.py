# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is before the damage of a file is read on request, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.bags import EPOCH, S, list_topics, read_joint_states, stamped, write_bag
from support.compressed_bags import compressed_bag, storage_file

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.bags import find_recordings
from mp_pca_planner.recordings.joint_states import JointStates

N = 1000
POSITIONS = np.random.default_rng(5).normal(size=(N, 2))


@pytest.fixture
def file(tmp_path: Path, bag_format: str) -> Path:
    path = storage_file(write_bag(tmp_path / "x", bag_format, stamped(POSITIONS)))
    moved = path.with_name(f"y{path.suffix}")
    path.rename(moved)
    return moved


def test_log_of_a_recorder_that_was_killed_is_named_with_what_to_do(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "x", "sqlite3", stamped(POSITIONS))
    Path(f"{storage_file(folder)}-wal").write_bytes(b"samples")
    with pytest.raises(RecordingError, match=r"left 'x.db3-wal': complete it with sqlite3 x.db3"):
        read_joint_states(folder, "/joint_states")


def test_bag_of_ros_1_that_its_recorder_did_not_finish_is_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "rosbag1", stamped(POSITIONS))
    content = path.read_bytes()
    active = tmp_path / "y.bag.active"
    # The recorder writes the index, and its place, last.
    active.write_bytes(content.replace(b"index_pos=", b"index_xxx=")[:-20])
    raw = read_joint_states(active, "/joint_states")
    np.testing.assert_array_equal(raw.positions, POSITIONS)
    assert f"only the {N} messages before the damage" in raw.notes[0]
    path.unlink()
    assert find_recordings([tmp_path]) == (active,)


@pytest.mark.parametrize("share", [0.4, 0.9])
@pytest.mark.parametrize("bag_format", ["mcap", "rosbag1"])
def test_messages_before_the_cut_are_salvaged(file: Path, share: float) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=file.name):
        read_joint_states(file, "/joint_states")
    (topic,) = list_topics(file, salvage=True)
    raw = read_joint_states(file, "/joint_states", salvage=True)
    assert 0.5 * share * N < raw.n_messages <= N
    assert topic.count == raw.n_messages
    np.testing.assert_array_equal(raw.positions, POSITIONS[: raw.n_messages])
    np.testing.assert_array_equal(raw.header_stamps, EPOCH + np.arange(raw.n_messages) * (S // 100))
    (note,) = raw.notes
    assert "damaged" in note
    assert f"only the {raw.n_messages} messages" in note


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd", "zstd file", "zstd message"])
def test_compressed_bags_are_read_and_salvaged_or_refused_by_name(
    tmp_path: Path, compression: str
) -> None:
    path = compressed_bag(tmp_path, compression, 40_000 if compression == "zstd" else 300)
    whole = read_joint_states(path, "/joint_states")
    np.testing.assert_array_equal(whole.positions[:, 0], np.arange(whole.n_messages))
    assert whole.n_messages >= 300
    if path.is_dir():
        (path / "metadata.yaml").unlink()
        assert read_joint_states(path, "/joint_states").n_messages == whole.n_messages
    file = storage_file(path) if path.is_dir() else path
    content = file.read_bytes()
    file.write_bytes(content[: int(0.8 * len(content))])
    with pytest.raises(RecordingError, match=path.name):
        read_joint_states(path, "/joint_states")
    raw = read_unless_refused_by_name(path, salvage=True)
    if compression == "zstd":
        assert raw is not None and 1000 < raw.n_messages < whole.n_messages
        np.testing.assert_array_equal(raw.positions[:, 0], np.arange(raw.n_messages))


def read_unless_refused_by_name(file: Path, *, salvage: bool) -> JointStates | None:
    reason = file.name
    try:
        list_topics(file, salvage=salvage)
        return read_joint_states(file, "/joint_states", salvage=salvage)
    except RecordingError as error:
        reason = str(error)
    assert file.name in reason
    return None
