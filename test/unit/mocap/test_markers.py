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
    write_messages,
)

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.mocap.markers import MarkerPlacement, read_markers

STEP = S // 100
N = 20
PATHS = np.random.default_rng(1).normal(size=(3, N, 3))


def placed(*names: str, **options: object) -> list[MarkerPlacement]:
    return [MarkerPlacement(name, "link", (0.0, 0.0, 0.0), **options) for name in names]


def test_marker_arrays_are_read_by_namespace_and_id(tmp_path: Path, bag_format: str) -> None:
    messages, entries = Messages(bag_format), []
    for k in range(N):
        stamp = EPOCH + k * STEP
        array = messages.marker_array(
            messages.marker("arm", 1, PATHS[0, k], stamp),
            messages.marker("arm", 7, PATHS[1, k], stamp),
            messages.marker("", 3, PATHS[2, k], stamp),
            messages.marker("elbow", 0, PATHS[0, k], stamp),
            messages.marker("gone", 1, (0, 0, 0), stamp, action=2),
            messages.marker("line", 2, (0, 0, 0), stamp, type=4),
        )
        entries.append(("/markers", MARKER_ARRAY, stamp + 5, array))
    path = write_messages(tmp_path / "bag", messages, entries)
    found = read_markers(path, "/markers", placed("arm/7", "3", "arm/1", "elbow"))
    np.testing.assert_array_equal(found.positions, PATHS[[1, 2, 0, 0]].transpose(1, 0, 2))
    np.testing.assert_array_equal(found.header_stamps, EPOCH + STEP * np.arange(N))
    np.testing.assert_array_equal(found.receive_stamps, found.header_stamps + 5)
    with pytest.raises(RecordingError, match="'arms/7' .did you mean 'arm/7'.*'arm/7', 'elbow'$"):
        read_markers(path, "/markers", placed("arms/7"))


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


def stream_bag(path: Path, messages: Messages, *streams: tuple[str, str, list, list]) -> Path:
    """Streams are topics, types, stamps and places, with quaternions where they are poses."""
    entries = []
    for topic, kind, stamps, places in streams:
        for stamp, place in zip(map(int, stamps), places, strict=True):
            make = messages.point if kind == POINT else messages.pose_stamped
            entries.append((topic, kind, stamp, make(*place, stamp)))
    return write_messages(path, messages, sorted(entries, key=lambda entry: entry[2]))


@pytest.mark.parametrize(("pattern", "suffix"), [("/mocap", ""), ("/mocap/*/point", "/point")])
def test_points_on_a_topic_for_each_marker_are_frames(
    tmp_path: Path, pattern: str, suffix: str
) -> None:
    stamps = EPOCH + STEP * np.arange(N)
    named = (("elbow", PATHS[0]), ("wrist", PATHS[1]))
    streams = [(f"/mocap/{n}{suffix}", POINT, stamps, [(p,) for p in path]) for n, path in named]
    path = stream_bag(tmp_path / "bag", Messages(), *streams)
    found = read_markers(path, pattern, placed("elbow", "wrist"))
    np.testing.assert_array_equal(found.positions, PATHS[:2].transpose(1, 0, 2))
    np.testing.assert_array_equal(found.header_stamps, stamps)


def test_markers_with_stamps_of_their_own_are_interpolated_over_small_steps(
    tmp_path: Path,
) -> None:
    slow = np.array([k for k in range(20) if not 8 <= k < 12])
    late, places = EPOCH + 2 * slow * STEP + STEP // 2, [((0, 2 * k + 0.5, 0),) for k in slow]
    path = stream_bag(
        tmp_path / "bag",
        Messages(),
        ("/m/fast", POINT, EPOCH + STEP * np.arange(40), [((k, 0, 0),) for k in range(40)]),
        ("/m/slow", POINT, late, places),
    )
    found = read_markers(path, "/m", placed("fast", "slow"))
    frames = np.arange(40.0)
    known = ((frames > 0.5) & (frames < 14.5)) | ((frames > 24.5) & (frames < 38.5))
    np.testing.assert_allclose(found.positions[known, 1, 1], frames[known], atol=1e-6)
    assert np.isnan(found.positions[~known, 1]).all()


def test_bodies_with_orientations_give_points_on_them_and_turn_the_short_way(
    tmp_path: Path,
) -> None:
    """Also between samples, whatever the signs of their quaternions."""
    fast, slow = np.arange(2 * N), 2 * np.arange(N)
    turns = [
        (-1.0) ** k * Rotation.from_euler("z", 0.1 * (2 * k + 0.5)).as_quat() for k in range(N)
    ]
    path = stream_bag(
        tmp_path / "bag",
        Messages(),
        ("/m/clock", POSE, EPOCH + fast * STEP, [((0, 0, 0), UPRIGHT)] * 2 * N),
        ("/m/hand", POSE, EPOCH + slow * STEP + STEP // 2, [((0, 0, 3), turn) for turn in turns]),
    )
    tip = MarkerPlacement("tip", "link", (0, 0, 0), body="hand", offset=(1.0, 0.0, -0.5))
    found = read_markers(path, "/m", [tip, *placed("clock", "hand")]).positions[1 : 2 * N - 2]
    angles = 0.1 * fast[1:-2]
    expected = np.column_stack([np.cos(angles), np.sin(angles), np.full(2 * N - 3, 2.5)])
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-4)
    np.testing.assert_allclose(found[:, 2], np.tile([0.0, 0.0, 3.0], (2 * N - 3, 1)))


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
    [("rosbag1", OLD_TF), ("mcap", TF)],
)
def test_frames_are_read_by_name(tmp_path: Path, bag_format: str, kind: str) -> None:
    path = tf_bag(tmp_path / "bag", bag_format=bag_format, kind=kind)
    found = read_markers(path, "/tf", placed("marker", "hand"))
    np.testing.assert_allclose(found.positions, np.stack([PATHS[1], PATHS[2]], axis=1), atol=1e-12)


def test_markers_that_can_not_be_placed_are_refused_by_name(tmp_path: Path) -> None:
    path = tf_bag(tmp_path / "tf", hand_parent="elsewhere")
    with pytest.raises(RecordingError, match="'hand' is given in two frames in '/tf', 'room' and"):
        read_markers(path, "/tf", placed("hand"))
    messages = Messages()
    nowhere = messages.marker_array(messages.marker("a", 0, (np.nan, 0, 0), EPOCH))
    entries = [
        ("/m/a", POINT, EPOCH, messages.point((0, 0, 0), EPOCH, "world")),
        ("/m/b", POINT, EPOCH, messages.point((0, 0, 0), EPOCH, "camera")),
        ("/all", MARKER_ARRAY, EPOCH, nowhere),
    ]
    path = write_messages(tmp_path / "bag", messages, entries)
    for topic, message in (
        ("/m", r"different frames \('world': 'a'; 'camera': 'b'\)"),
        ("/all", "marker 'a' has no finite position"),
        ("/joint_states", rf"no markers on '/joint_states'.*'/all' \({MARKER_ARRAY}\)"),
    ):
        with pytest.raises(RecordingError, match=message):
            read_markers(path, topic, placed("a", *(["b"] if topic == "/m" else [])))
