# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import shutil
import subprocess
import sys
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
    reaching,
    read_joint_states,
    stamped,
    write_bag,
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


def test_joint_states_come_back_exactly(tmp_path: Path, bag_format: str) -> None:
    stamps = EPOCH + np.arange(30) * 7_654_321
    positions = np.random.default_rng(0).normal(size=(30, 3))
    messages = [
        Message(("a", "b", "c"), row, stamp, stamp + 123)
        for row, stamp in zip(positions, stamps.tolist(), strict=True)
    ]
    path = write_bag(tmp_path / "x", bag_format, messages)
    raw = read_joint_states(path, "/joint_states")
    assert raw.joint_names == ("a", "b", "c") and raw.listed.all()
    np.testing.assert_array_equal(raw.positions, positions)
    np.testing.assert_array_equal(raw.header_stamps, stamps)
    np.testing.assert_array_equal(raw.receive_stamps, stamps + 123)


def test_velocities_and_efforts_are_written_where_given(tmp_path: Path, bag_format: str) -> None:
    velocities, efforts = np.full((50, 2), 2.0), np.full((50, 2), 3.0)
    path = own_bag(tmp_path / "x", bag_format, velocities=velocities, efforts=efforts)
    with AnyReader([path]) as reader:
        connection, _, data = next(reader.messages())
        message = reader.deserialize(data, connection.msgtype)
    np.testing.assert_array_equal(message.velocity, [2.0, 2.0])
    np.testing.assert_array_equal(message.effort, [3.0, 3.0])


@pytest.mark.parametrize(("bag_format", "suffix"), [("sqlite3", ".db3"), ("mcap", ".mcap")])
def test_bare_storage_file_is_a_recording(tmp_path: Path, bag_format: str, suffix: str) -> None:
    path = own_bag(tmp_path / f"bare{suffix}", bag_format)
    assert path.is_file()
    assert find_recordings([path]) == (path,)
    assert read_joint_states(path, "/joint_states").n_messages == 50


def test_folders_and_patterns_expand_to_single_recordings(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    paths = [own_bag(tmp_path / "deep" / name, name) for name in FORMATS]
    (tmp_path / "deep" / "notes.txt").write_text("not a bag")
    assert set(find_recordings([tmp_path])) == set(paths)
    assert set(find_recordings([tmp_path / "deep" / "*.bag"])) == {paths[0]}
    assert len(find_recordings([tmp_path, paths[0], str(tmp_path / "de*")])) == len(paths)


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


def test_sqlite_bag_is_not_written_where_its_writer_would_miss_the_path(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="without '\\?'"):
        own_bag(tmp_path / "what?", "sqlite3")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bag_format", ["sqlite3", "mcap"])
def test_all_messages_are_read_whatever_count_is_in_metadata(
    tmp_path: Path, bag_format: str
) -> None:
    path = own_bag(tmp_path / "x", bag_format)
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 50", "message_count: 7"))
    raw = read_joint_states(path, "/joint_states")
    assert raw.n_messages == 50


def test_fewer_messages_than_the_index_says_are_refused(tmp_path: Path) -> None:
    path = storage_file(own_bag(tmp_path / "x", "mcap"))
    content = path.read_bytes()
    # The statistics in the summary: of 50 messages on channel 1.
    told = (1).to_bytes(2, "little") + (50).to_bytes(8, "little")
    assert content.count(told) == 1
    path.write_bytes(content.replace(told, told[:2] + (60).to_bytes(8, "little")))
    with pytest.raises(RecordingError, match="60 messages on the topic, 50 can be read"):
        read_joint_states(path, "/joint_states")


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


@pytest.mark.parametrize(
    ("topic", "field", "sentence"),
    [
        ("/multi", "arm.states", "valid names: 'label', 'jointStates'"),
        ("/multi", "arm", "is a my_msgs/msg/Arm; expected a sensor_msgs/msg/JointState"),
        ("/multi", "arm.label.x", "valid names: none"),
        ("/other", "arm", "topics: '/multi'"),
    ],
)
def test_field_without_joint_states_is_refused_by_name(
    multi: Path, topic: str, field: str, sentence: str
) -> None:
    with pytest.raises(RecordingError, match=sentence):
        read_joint_states(multi, topic, field=field)


@pytest.mark.parametrize("bag_format", ["mcap"])
def test_joint_states_inside_of_messages_are_salvaged(multi: Path) -> None:
    file = storage_file(multi)
    content = file.read_bytes()
    file.write_bytes(content[: int(0.8 * len(content))])
    with pytest.raises(RecordingError, match=file.name):
        read_joint_states(file, "/multi", field="arm.jointStates")
    raw = read_joint_states(file, "/multi", field="arm.jointStates", salvage=True)
    assert 100 < raw.n_messages <= 400
    expected = np.outer(np.arange(raw.n_messages), [1, -1])
    np.testing.assert_array_equal(raw.positions, expected)
    assert "damaged" in raw.notes[0]


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
        about["relative_file_paths"] = names
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


def test_links_do_not_multiply_recordings(tmp_path: Path) -> None:
    path = own_bag(tmp_path / "x", "mcap")
    (tmp_path / "round").symlink_to(tmp_path)
    (found,) = find_recordings([tmp_path, path])
    assert found.resolve() == path.resolve()


@pytest.mark.parametrize("name", ["missing.bag", "*.bag", "empty"])
def test_path_without_recording_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="no recording at"):
        find_recordings([tmp_path / name])


def test_recordings_of_the_same_name_are_told_apart_by_their_folder(tmp_path: Path) -> None:
    paths = [tmp_path / "left" / "x.bag", tmp_path / "right" / "x.bag", tmp_path / "y.bag"]
    assert recording_names(paths) == ("left/x", "right/x", "y")
    paths = [tmp_path / x for x in ("a/1/x.bag", "b/1/x.bag", "b/2/x.bag", "x.mcap", "x.db3")]
    assert recording_names(paths) == ("a/1/x", "b/1/x", "2/x", "x.mcap", "x.db3")


def test_link_that_leads_to_itself_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "loop.bag").symlink_to(tmp_path / "loop.bag")
    (refused,) = load_recordings([tmp_path / "loop.bag"]).refused
    assert "loop.bag' can't be read" in refused.reason


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_cut_off_file_is_refused_by_name(tmp_path: Path, bag_format: str, share: float) -> None:
    file = storage_file(write_bag(tmp_path / "x", bag_format, stamped(reaching([0, 1]))))
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=file.name):
        read_joint_states(file, "/joint_states")


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap", ".txt"])
def test_file_that_is_no_bag_is_refused_by_name(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"letter{suffix}"
    path.write_text("Dear reader, " * 100)
    with pytest.raises(RecordingError, match="letter"):
        list_topics(path)


@pytest.mark.parametrize("content", ["", "[", "rosbag2_bagfile_information: 3", "{}"])
def test_folder_with_broken_metadata_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = own_bag(tmp_path / "broken", "mcap")
    (path / "metadata.yaml").write_text(content)
    with pytest.raises(RecordingError, match="broken"):
        list_topics(path)


def test_folder_without_its_storage_is_refused_by_name(tmp_path: Path) -> None:
    path = own_bag(tmp_path / "hollow", "mcap")
    storage_file(path).unlink()
    with pytest.raises(RecordingError, match="hollow"):
        list_topics(path)


def test_existing_file_is_replaced_only_on_request(tmp_path: Path, bag_format: str) -> None:
    path = own_bag(tmp_path / "x", bag_format)
    before = checksum(path)
    with pytest.raises(PlannerError, match="exists already"):
        own_bag(tmp_path / "x", bag_format)
    assert checksum(path) == before
    own_bag(tmp_path / "x", bag_format, velocities=np.ones((50, 2)), overwrite=True)
    assert checksum(path) != before
    assert read_joint_states(path, "/joint_states").n_messages == 50
    assert list(tmp_path.iterdir()) == [path]


def test_folder_of_other_things_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    own_bag(tmp_path / "thesis" / "bag", "mcap")
    with pytest.raises(RecordingError, match="thesis' is a folder, but not a recording"):
        own_bag(tmp_path / "thesis", "mcap", overwrite=True)
    assert (tmp_path / "thesis" / "bag" / "metadata.yaml").exists()


def test_failed_writing_leaves_nothing(tmp_path: Path, bag_format: str) -> None:
    with pytest.raises(RecordingError):
        write_joint_states(tmp_path / "x", bag_format, ("a",), [1, 2], [[0.0], [np.nan]])
    with pytest.raises(PlannerError, match="can't be written"):
        write_joint_states(tmp_path / "no" / "x", bag_format, ("a",), [1], [[0.0]])
    assert list(tmp_path.iterdir()) == []


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


def test_reading_needs_no_ros(tmp_path: Path) -> None:
    path = own_bag(tmp_path / "x", "mcap")
    code = (
        "import sys; from mp_pca_planner.recordings.reading import inspect_recording; "
        f"inspect_recording({str(path)!r}); "
        "sys.exit(any(m == 'rclpy' or m.endswith('_msgs') for m in sys.modules))"
    )
    root = Path(__file__).parents[3]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
