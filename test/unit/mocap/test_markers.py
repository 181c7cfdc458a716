# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Marker recordings in every way in which mocap systems send them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.bags import EPOCH, S
from support.marker_bags import (
    MARKER_ARRAY,
    OLD_TF,
    POINT,
    POSE,
    TF,
    UPRIGHT,
    Messages,
    write_marker_arrays,
    write_messages,
)

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.mocap.markers import MarkerPlacement, read_markers

STEP = S // 100
N = 20
PATHS = np.random.default_rng(1).normal(size=(3, N, 3))


def placed(*names: str, **options: object) -> list[MarkerPlacement]:
    return [MarkerPlacement(name, "link", (0.0, 0.0, 0.0), **options) for name in names]


def test_marker_arrays_are_read_by_namespace(tmp_path: Path, bag_format: str) -> None:
    path = write_marker_arrays(
        tmp_path / "bag", {"elbow": PATHS[0], "wrist": PATHS[1]}, bag_format=bag_format
    )
    found = read_markers(path, "/markers", placed("wrist", "elbow"))
    assert found.names == ("wrist", "elbow")
    np.testing.assert_array_equal(found.positions, PATHS[[1, 0]].transpose(1, 0, 2))
    expected = EPOCH + STEP * np.arange(N)
    np.testing.assert_array_equal(found.header_stamps, expected)
    np.testing.assert_array_equal(found.receive_stamps, expected)


def test_markers_of_one_namespace_are_told_apart_by_id(tmp_path: Path) -> None:
    messages = Messages()
    entries = []
    for k in range(N):
        stamp = EPOCH + k * STEP
        array = messages.marker_array(
            messages.marker("arm", 1, PATHS[0, k], stamp),
            messages.marker("arm", 7, PATHS[1, k], stamp),
            messages.marker("", 3, PATHS[2, k], stamp),
        )
        entries.append(("/markers", MARKER_ARRAY, stamp, array))
    path = write_messages(tmp_path / "bag", messages, entries)
    found = read_markers(path, "/markers", placed("arm/7", "3", "arm/1"))
    np.testing.assert_array_equal(found.positions, PATHS[[1, 2, 0]].transpose(1, 0, 2))


def test_markers_that_are_deleted_or_drawn_as_lines_are_no_places(tmp_path: Path) -> None:
    messages = Messages()
    array = messages.marker_array(
        messages.marker("good", 0, (1, 2, 3), EPOCH),
        messages.marker("gone", 1, (0, 0, 0), EPOCH, action=2),
        messages.marker("line", 2, (0, 0, 0), EPOCH, type=4),
    )
    path = write_messages(tmp_path / "bag", messages, [("/markers", MARKER_ARRAY, EPOCH, array)])
    with pytest.raises(RecordingError, match="no recorded marker is called 'gone'.*names: 'good'$"):
        read_markers(path, "/markers", placed("gone"))


def test_a_marker_that_is_absent_nan_or_absurdly_far_is_missing(tmp_path: Path) -> None:
    absent = PATHS[0].copy()
    absent[4:7] = np.nan
    messages = Messages()
    entries = []
    for k in range(N):
        stamp = EPOCH + k * STEP
        bad = {9: (0, np.nan, 0), 11: (0, 0, 1e300), 12: (np.inf, 0, 0)}
        markers = [messages.marker("b", 1, bad.get(k, PATHS[1, k]), stamp)]
        if np.isfinite(absent[k, 0]):
            markers.append(messages.marker("a", 0, absent[k], stamp))
        entries.append(("/markers", MARKER_ARRAY, stamp, messages.marker_array(*markers)))
    path = write_messages(tmp_path / "bag", messages, entries)
    found = read_markers(path, "/markers", placed("a", "b"))
    np.testing.assert_array_equal(found.positions[:, 0], absent)
    assert np.flatnonzero(np.isnan(found.positions[:, 1]).any(axis=1)).tolist() == [9, 11, 12]
    assert np.isnan(found.positions[9, 1]).all()


@pytest.mark.parametrize(("pattern", "suffix"), [("/mocap", ""), ("/mocap/*/point", "/point")])
def test_points_on_a_topic_for_each_marker_are_frames(
    tmp_path: Path, bag_format: str, pattern: str, suffix: str
) -> None:
    messages = Messages(bag_format)
    entries = []
    for k in range(N):
        stamp = EPOCH + k * STEP
        for name, places in (("elbow", PATHS[0]), ("wrist", PATHS[1])):
            topic = f"/mocap/{name}{suffix}"
            entries.append((topic, POINT, stamp + 1000, messages.point(places[k], stamp)))
    path = write_messages(tmp_path / "bag", messages, entries)
    found = read_markers(path, pattern, placed("elbow", "wrist"))
    np.testing.assert_array_equal(found.positions, PATHS[:2].transpose(1, 0, 2))
    np.testing.assert_array_equal(found.header_stamps, EPOCH + STEP * np.arange(N))


def test_markers_with_stamps_of_their_own_are_interpolated_over_small_steps(
    tmp_path: Path,
) -> None:
    messages = Messages()
    entries = []
    for k in range(40):
        stamp = EPOCH + k * STEP
        entries.append(("/m/fast", POINT, stamp, messages.point((k, 0, 0), stamp)))
    for k in range(20):
        stamp = EPOCH + 2 * k * STEP + STEP // 2
        if not 8 <= k < 12:
            place = (0.0, 2 * k + 0.5, 0.0)
            entries.append(("/m/slow", POINT, stamp, messages.point(place, stamp)))
    path = write_messages(tmp_path / "bag", messages, sorted(entries, key=lambda e: e[2]))
    found = read_markers(path, "/m", placed("fast", "slow"))
    frames = np.arange(40.0)
    known = ((frames > 0.5) & (frames < 14.5)) | ((frames > 24.5) & (frames < 38.5))
    np.testing.assert_allclose(found.positions[known, 1, 1], frames[known], atol=1e-6)
    assert np.isnan(found.positions[~known, 1]).all()


def test_a_body_with_an_orientation_gives_points_on_it(tmp_path: Path) -> None:
    turns = Rotation.random(N, random_state=2)
    messages = Messages()
    entries = []
    for k in range(N):
        stamp = EPOCH + k * STEP
        message = messages.pose_stamped(PATHS[0, k], turns[k].as_quat(), stamp)
        entries.append(("/vicon/hand", POSE, stamp, message))
    path = write_messages(tmp_path / "bag", messages, entries)
    tip = MarkerPlacement("tip", "link", (0, 0, 0), body="hand", offset=(0.1, 0.0, -0.2))
    found = read_markers(path, "/vicon", [tip, *placed("hand")])
    expected = PATHS[0] + turns.apply([0.1, 0.0, -0.2])
    np.testing.assert_allclose(found.positions[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(found.positions[:, 1], PATHS[0])


def test_quaternions_between_samples_turn_the_short_way_whatever_their_signs(
    tmp_path: Path,
) -> None:
    messages, entries = Messages(), []
    for k in range(2 * N):
        stamp = EPOCH + k * STEP
        entries.append(("/m/clock", POSE, stamp, messages.pose_stamped((0, 0, 0), UPRIGHT, stamp)))
    for k in range(N):
        stamp = EPOCH + 2 * k * STEP + STEP // 2
        turn = (-1.0) ** k * Rotation.from_euler("z", 0.1 * (2 * k + 0.5)).as_quat()
        entries.append(("/m/hand", POSE, stamp, messages.pose_stamped((0, 0, 0), turn, stamp)))
    path = write_messages(tmp_path / "bag", messages, sorted(entries, key=lambda e: e[2]))
    tip = MarkerPlacement("tip", "link", (0, 0, 0), body="hand", offset=(1.0, 0.0, 0.0))
    found = read_markers(path, "/m", [tip, *placed("clock")]).positions[1 : 2 * N - 2, 0]
    angles = 0.1 * np.arange(1, 2 * N - 2)
    expected = np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    np.testing.assert_allclose(found, expected, atol=1e-4)


def tf_bag(path: Path, hand_parent: str = "room", bag_format: str = "mcap", kind: str = TF) -> Path:
    """A marker and a hand in a room, whose parent changes on the way."""
    messages = Messages(bag_format)
    entries = []
    for k in range(N):
        stamp = EPOCH + k * STEP
        frames = [
            messages.transform("/room", "marker", PATHS[1, k], stamp),
            messages.transform("room" if k < N // 2 else hand_parent, "/hand", PATHS[2, k], stamp),
        ]
        entries.append(("/tf", kind, stamp, messages.make(kind, transforms=frames)))
    return write_messages(path, messages, entries)


@pytest.mark.parametrize(
    ("bag_format", "kind"),
    [("rosbag1", TF), ("rosbag1", OLD_TF), ("sqlite3", TF), ("mcap", TF)],
)
def test_frames_are_read_by_name(tmp_path: Path, bag_format: str, kind: str) -> None:
    path = tf_bag(tmp_path / "bag", bag_format=bag_format, kind=kind)
    found = read_markers(path, "/tf", placed("marker", "hand"))
    np.testing.assert_allclose(found.positions, np.stack([PATHS[1], PATHS[2]], axis=1), atol=1e-12)


def test_a_marker_in_two_frames_is_refused_by_name(tmp_path: Path) -> None:
    path = tf_bag(tmp_path / "bag", hand_parent="elsewhere")
    with pytest.raises(RecordingError, match="'hand' is given in two frames in '/tf', 'room' and"):
        read_markers(path, "/tf", placed("hand"))


def test_markers_in_different_frames_are_refused_by_name(tmp_path: Path) -> None:
    messages = Messages()
    entries = [
        ("/m/a", POINT, EPOCH, messages.point((0, 0, 0), EPOCH, "world")),
        ("/m/b", POINT, EPOCH, messages.point((0, 0, 0), EPOCH, "camera")),
    ]
    path = write_messages(tmp_path / "bag", messages, entries)
    with pytest.raises(RecordingError, match=r"different frames \('world': 'a'; 'camera': 'b'\)"):
        read_markers(path, "/m", placed("a", "b"))


def test_a_topic_without_markers_is_refused_with_those_that_would_do(tmp_path: Path) -> None:
    path = write_marker_arrays(tmp_path / "bag", {"a": PATHS[0]}, topic="/mocap/all")
    expected = f"no markers on '/joint_states'.*'/mocap/all' \\({MARKER_ARRAY}\\)"
    with pytest.raises(RecordingError, match=expected):
        read_markers(path, "/joint_states", placed("a"))


def test_a_marker_that_is_not_recorded_is_refused_with_those_that_are(tmp_path: Path) -> None:
    path = write_marker_arrays(tmp_path / "bag", {"elbow": PATHS[0], "wrist": PATHS[1]})
    with pytest.raises(RecordingError, match="'wrists' .did you mean 'wrist'.*'elbow', 'wrist'"):
        read_markers(path, "/markers", placed("elbow", "wrists"))


def test_a_marker_without_any_finite_position_is_refused_by_name(tmp_path: Path) -> None:
    messages = Messages()
    marker = messages.marker("a", 0, (np.nan, 0, 0), EPOCH)
    entries = [("/markers", MARKER_ARRAY, EPOCH, messages.marker_array(marker))]
    path = write_messages(tmp_path / "bag", messages, entries)
    with pytest.raises(RecordingError, match="marker 'a' has no finite position"):
        read_markers(path, "/markers", placed("a"))
