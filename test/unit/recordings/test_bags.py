# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from support.bags import (
    EPOCH,
    FORMATS,
    Message,
    S,
    list_topics,
    read_joint_states,
)
from support.compressed_bags import storage_file
from support.embedded_bags import write_embedded_bag

from mp_pca_planner.exceptions import PlannerError, RecordingError
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.recordings.bags import (
    checksum,
    find_recordings,
    recording_names,
    write_joint_states,
    write_joint_trajectory,
)
from mp_pca_planner.recordings.load import load_recordings


def own_bag(path: Path, bag_format: str, **options: object) -> Path:
    path = path.with_suffix(".bag") if bag_format == "rosbag1" else path
    stamps = EPOCH + np.arange(50) * 10_000_000
    positions = np.random.default_rng(1).normal(size=(50, 2))
    write_joint_states(path, bag_format, ("a", "b"), stamps, positions, **options)
    return path


@pytest.mark.parametrize("name", ["what?", "a#b", "50%41", "x y"])
def test_path_may_hold_any_letters(tmp_path: Path, bag_format: str, name: str) -> None:
    path = own_bag(tmp_path / "plain", bag_format)
    moved = path.rename(tmp_path / f"{name}{path.suffix}")
    if moved.is_dir():
        file = storage_file(moved)
        renamed = file.rename(file.with_name(f"{name}_0{file.suffix}"))
        metadata = moved / "metadata.yaml"
        metadata.write_text(metadata.read_text().replace(file.name, f"{renamed.name}"))
        assert read_joint_states(renamed, "/joint_states").n_messages == 50
    assert read_joint_states(moved, "/joint_states").n_messages == 50


@pytest.fixture
def multi(tmp_path: Path, bag_format: str) -> Path:
    """Joint states inside of messages that only the bag defines."""
    states = [Message(("a", "b"), (i, -i), 5 * S + i, EPOCH + i) for i in range(400)]
    return write_embedded_bag(tmp_path / "x", bag_format, states)


def test_joint_states_inside_of_other_messages_are_read(multi: Path) -> None:
    raw = read_joint_states(multi, "/multi", field="arm.jointStates")
    assert raw.joint_names == ("a", "b")
    np.testing.assert_array_equal(raw.positions, np.outer(np.arange(400), [1, -1]))
    np.testing.assert_array_equal(raw.header_stamps, 5 * S + np.arange(400))
    np.testing.assert_array_equal(raw.receive_stamps, EPOCH + np.arange(400))
    for topic, field, sentence in (
        ("/multi", "arm.states", "valid names: 'label', 'jointStates'"),
        ("/multi", "arm", "is a my_msgs/msg/Arm; expected a sensor_msgs/msg/JointState"),
        ("/multi", "arm.label.x", "valid names: none"),
        ("/other", "arm", "topics: '/multi'"),
    ):
        with pytest.raises(RecordingError, match=sentence):
            read_joint_states(multi, topic, field=field)


@pytest.mark.parametrize(("bag_format", "suffix"), [("sqlite3", ".db3"), ("mcap", ".mcap")])
@pytest.mark.parametrize("told", [True, False])
def test_split_bags_are_one_recording_with_or_without_metadata(
    tmp_path: Path, bag_format: str, suffix: str, told: bool
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    parts = [own_bag(tmp_path / f"part{number}", bag_format) for number in range(11)]
    names = [f"run_{number}{suffix}" for number in range(11)]
    for number, (part, name) in enumerate(zip(parts, names, strict=True)):
        stamps = EPOCH + number * S + np.arange(50) * 10_000_000
        positions = np.full((50, 2), float(number))
        write_joint_states(part, bag_format, ("a", "b"), stamps, positions, overwrite=True)
        storage_file(part).rename(folder / name)
    if told:
        metadata = yaml.safe_load((parts[0] / "metadata.yaml").read_text())
        about = metadata["rosbag2_bagfile_information"]
        about["relative_file_paths"] = [*names, *names]  # each is read once
        about["topics_with_message_count"][0]["message_count"] = 550
        (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    for part in parts:
        shutil.rmtree(part)
    assert find_recordings([tmp_path]) == (folder,)
    raw = read_joint_states(folder, "/joint_states")
    np.testing.assert_array_equal(raw.positions[:, 0], np.repeat(np.arange(11.0), 50))
    assert raw.notes == (
        ()
        if told
        else ("metadata.yaml is missing: the files are read in the order of their numbers",)
    )


def test_paths_expand_to_single_recordings(tmp_path: Path) -> None:
    deep = tmp_path / "deep"
    deep.mkdir()
    paths = [own_bag(deep / name, name) for name in FORMATS]
    bare = own_bag(deep / "bare.db3", "sqlite3")
    (deep / "notes.txt").write_text("not a bag")
    (deep / "round").symlink_to(tmp_path)
    assert read_joint_states(bare, "/joint_states").n_messages == 50
    places = {path.resolve() for path in find_recordings([tmp_path, paths[0], f"{tmp_path}/de*"])}
    assert places == {bare, *paths}
    assert find_recordings([deep / "*.bag"]) == (paths[0],)
    (tmp_path / "empty").mkdir()
    for name in ("missing.bag", "*.mcap", "empty"):
        with pytest.raises(RecordingError, match="no recording at"):
            find_recordings([tmp_path / name])
    (tmp_path / "loop.bag").symlink_to(tmp_path / "loop.bag")
    (refused,) = load_recordings([tmp_path / "loop.bag"]).refused
    assert "loop.bag' can't be read" in refused.reason


def test_recordings_of_the_same_name_are_told_apart_by_their_folder(tmp_path: Path) -> None:
    paths = [tmp_path / "left" / "x.bag", tmp_path / "right" / "x.bag", tmp_path / "y.bag"]
    assert recording_names(paths) == ("left/x", "right/x", "y")
    paths = [tmp_path / x for x in ("a/1/x.bag", "b/1/x.bag", "b/2/x.bag", "x.mcap", "x.db3")]
    assert recording_names(paths) == ("a/1/x", "b/1/x", "2/x", "x.mcap", "x.db3")


@pytest.mark.parametrize("content", ["Dear reader, ", "[", "rosbag2_bagfile_information: 3"])
def test_what_is_no_bag_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = own_bag(tmp_path / "broken", "mcap")
    (path / "metadata.yaml").write_text(content)
    for suffix in (".bag", ".db3", ".mcap", ".txt"):
        path.with_suffix(suffix).write_text(content)
        with pytest.raises(RecordingError, match=f"broken{suffix}"):
            list_topics(path.with_suffix(suffix))
    with pytest.raises(RecordingError, match="broken"):
        list_topics(path)


def test_counts_of_metadata_do_not_matter_but_those_of_the_index_do(tmp_path: Path) -> None:
    path = own_bag(tmp_path / "x", "mcap")
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 50", "message_count: 7"))
    assert read_joint_states(path, "/joint_states").n_messages == 50
    file = storage_file(path)
    content = file.read_bytes()
    # The statistics in the summary: of 50 messages on channel 1.
    told = (1).to_bytes(2, "little") + (50).to_bytes(8, "little")
    assert content.count(told) == 1
    file.write_bytes(content.replace(told, told[:2] + (60).to_bytes(8, "little")))
    with pytest.raises(RecordingError, match="60 messages on the topic, 50 can be read"):
        read_joint_states(path, "/joint_states")


def test_bags_are_written_whole_and_replaced_on_request_only(
    tmp_path: Path, bag_format: str
) -> None:
    for values, where in (([[0.0], [np.nan]], "x"), ([[0.0], [1.0]], "no/x")):
        with pytest.raises(PlannerError):
            write_joint_states(tmp_path / where, bag_format, ("a",), [1, 2], values)
    if bag_format == "sqlite3":  # its writer takes the path for a URL
        with pytest.raises(RecordingError, match=r"without '\?'"):
            own_bag(tmp_path / "what?", bag_format)
    assert list(tmp_path.iterdir()) == []
    path = own_bag(tmp_path / "x", bag_format)
    before = checksum(path)
    with pytest.raises(PlannerError, match="exists already"):
        own_bag(tmp_path / "x", bag_format)
    assert checksum(path) == before
    own_bag(path, bag_format, overwrite=True)
    assert read_joint_states(path, "/joint_states").n_messages == 50
    with AnyReader([path]) as reader:
        connection, _, data = next(reader.messages())
        message = reader.deserialize(data, connection.msgtype)
    assert (message.velocity.size, message.effort.size) == (0, 0)
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(RecordingError, match="is a folder, but not a recording"):
        own_bag(tmp_path, "mcap", overwrite=True)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["t.bag", "t", "t.mcap", "t.db3"])
def test_trajectory_comes_back_as_one_message(tmp_path: Path, name: str) -> None:
    times = np.linspace(0.0, 1.5, 16)
    values = np.random.default_rng(2).normal(size=(4, 16, 2))
    trajectory = Trajectory(("a", "b"), times, *values)
    path = tmp_path / name
    write_joint_trajectory(path, trajectory)
    with AnyReader([path]) as reader:
        ((connection, _, data),) = reader.messages()
        message = reader.deserialize(data, connection.msgtype)
    assert connection.topic == "/joint_trajectory"
    assert message.joint_names == ["a", "b"]
    assert message.header.stamp.sec == message.header.stamp.nanosec == 0
    for field, expected in zip(
        ("positions", "velocities", "accelerations", "effort"), values, strict=True
    ):
        np.testing.assert_array_equal([getattr(p, field) for p in message.points], expected)
    stamps = [p.time_from_start.sec * S + p.time_from_start.nanosec for p in message.points]
    np.testing.assert_allclose(stamps, times * S, atol=1)
    with pytest.raises(PlannerError, match="exists already"):
        write_joint_trajectory(path, trajectory)
