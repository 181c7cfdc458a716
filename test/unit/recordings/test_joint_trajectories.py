# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commanded motions become demonstrations as the controller would move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.interpolate import BPoly, CubicHermiteSpline
from support.bags import EPOCH, S, list_topics, stamped, write_bag

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.motion.interpolation import interpolate_at, segment_ends
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.recordings.bags import open_bag, write_joint_trajectory
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.reading import (
    inspect_recording,
    read_trajectories,
    repair_trajectories,
)
from mp_pca_planner.recordings.repair import CleanRecording

KIND = "trajectory_msgs/msg/JointTrajectory"
TIMES = np.array([0.0, 0.4, 1.0, 1.2])
POINTS = np.array([[0.0, 1.0], [0.5, 0.8], [1.0, -0.2], [1.2, -0.3]])
RATES = np.array([[0.0, 0.0], [1.0, -1.0], [1.0, -1.0], [0.0, 0.0]])
ZEROS = np.zeros((4, 2))


@dataclass
class Command:
    """A trajectory as it goes into a bag."""

    times: Sequence[float] = tuple(TIMES)
    positions: Any = None
    velocities: Any = None
    accelerations: Any = None
    stamp: int = 0
    receive: int = EPOCH
    names: Sequence[str] = ("a", "b")


def write_commands(path: Path, bag_format: str, commands: Sequence[Command]) -> Path:
    ros1 = bag_format == "rosbag1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    make = store.types
    plugin = StoragePlugin.MCAP if bag_format == "mcap" else StoragePlugin.SQLITE3
    path = path.with_suffix(".bag") if ros1 else path
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        connection = writer.add_connection("/command", KIND, typestore=store)
        for command in commands:
            positions = POINTS if command.positions is None else command.positions
            points = []
            for index, time in enumerate(command.times):
                rows = (positions, command.velocities, command.accelerations)
                given = [
                    np.empty(0) if row is None else np.array(row[index], float) for row in rows
                ]
                since = make["builtin_interfaces/msg/Duration"](*divmod(round(time * S), S))
                point = make["trajectory_msgs/msg/JointTrajectoryPoint"]
                points.append(point(*given, np.empty(0), since))
            stamp = make["builtin_interfaces/msg/Time"](*divmod(command.stamp, S))
            header = make["std_msgs/msg/Header"](*((0,) if ros1 else ()), stamp, "")
            message = make[KIND](header, list(command.names), points)
            serialise = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connection, command.receive, serialise(message, KIND))
    return path


def cleaned(path: Path, joints: Sequence[str] | None = None) -> CleanRecording:
    with open_bag(path) as bag:
        return repair_trajectories(read_trajectories(bag, bag.topics[0]), joints)


def positions_at(instants: np.ndarray, times: np.ndarray, *points: np.ndarray) -> np.ndarray:
    return interpolate_at(instants, times, segment_ends(times, *points))[0]


def test_points_are_joined_by_what_they_hold() -> None:
    asked = np.linspace(0.0, 1.2, 77)
    missing = np.full((4, 2), np.nan)
    straight = positions_at(asked, TIMES, POINTS, missing, missing)
    for joint in range(2):
        expected = np.interp(asked, TIMES, POINTS[:, joint])
        np.testing.assert_allclose(straight[:, joint], expected, atol=1e-12)
    cubic = positions_at(asked, TIMES, POINTS, RATES, missing)
    np.testing.assert_allclose(cubic, CubicHermiteSpline(TIMES, POINTS, RATES)(asked), atol=1e-12)
    accelerations = np.random.default_rng(1).normal(size=(4, 2))
    quintic = positions_at(asked, TIMES, POINTS, RATES, accelerations)
    curve = BPoly.from_derivatives(TIMES, np.stack([POINTS, RATES, accelerations], axis=1))
    np.testing.assert_allclose(quintic, curve(asked), atol=1e-12)


def test_a_segment_has_only_what_both_of_its_points_hold() -> None:
    velocities = RATES.copy()
    velocities[2] = np.nan
    asked = np.array([0.2, 0.7, 1.1])
    missing = np.full((4, 2), np.nan)
    found = positions_at(asked, TIMES, POINTS, velocities, missing)
    cubic = CubicHermiteSpline(TIMES, POINTS, RATES)(asked)
    np.testing.assert_allclose(found[0], cubic[0], atol=1e-12)
    np.testing.assert_allclose(found[1:], [(POINTS[1] + POINTS[2]) / 2, (POINTS[2:].mean(axis=0))])


@pytest.mark.parametrize(
    "fields", [{}, {"velocities": RATES}, {"velocities": RATES, "accelerations": ZEROS}]
)
def test_each_message_is_a_motion_as_the_controller_makes_it(
    tmp_path: Path, bag_format: str, fields: dict[str, Any]
) -> None:
    commands = [
        Command(**fields),
        Command(**fields, stamp=EPOCH + 5 * S, receive=EPOCH + 4 * S),
    ]
    clean = cleaned(write_commands(tmp_path / "x", bag_format, commands))
    assert clean.repairs == {}
    assert clean.n_messages == 2
    assert clean.joint_names == ("a", "b")
    missing = np.full((4, 2), np.nan)
    for piece, start in zip(clean.pieces, (0.0, 5.0), strict=True):
        assert (piece.times[0], piece.times[-1]) == pytest.approx((start, start + 1.2))
        expected = positions_at(
            piece.times - start,
            TIMES,
            POINTS,
            fields.get("velocities", missing),
            fields.get("accelerations", missing),
        )
        np.testing.assert_allclose(piece.positions, expected, atol=1e-9)


def test_a_replaced_motion_ends_where_the_next_one_starts(tmp_path: Path, bag_format: str) -> None:
    commands = [
        Command(),
        Command(receive=EPOCH + int(0.7 * S)),
        Command(times=(0.5,), positions=[[0, 0]], receive=EPOCH + int(1.4 * S)),
    ]
    clean = cleaned(write_commands(tmp_path / "x", bag_format, commands))
    assert clean.repairs == {"replaced": 2, "single_points": 1}
    spans = [(piece.times[0], piece.times[-1]) for piece in clean.pieces]
    np.testing.assert_allclose(spans, [(0.0, 0.7), (0.7, 1.4)], atol=1e-9)
    half = positions_at(np.array([0.7]), TIMES, POINTS, *np.full((2, 4, 2), np.nan))
    np.testing.assert_allclose(clean.pieces[0].positions[-1:], half, atol=1e-9)


def test_what_a_controller_would_refuse_is_counted_and_dropped(
    tmp_path: Path, bag_format: str
) -> None:
    bad = POINTS.copy()
    bad[1, 1] = np.nan
    commands = [
        Command(times=()),
        Command(times=(0.0, 0.4, 0.4, 1.2)),
        Command(positions=POINTS[:, :1]),
        Command(names=("a", "a")),
        Command(accelerations=ZEROS),
        Command(positions=bad),
        Command(velocities=bad),
        Command(names=("a", "x")),
        Command(),
    ]
    path = write_commands(tmp_path / "x", bag_format, commands)
    clean = cleaned(path, ["b", "a"])
    assert clean.repairs == {"malformed": 5, "missing_joints": 1, "non_finite": 2}
    (piece,) = clean.pieces
    np.testing.assert_allclose(piece.positions[[0, -1]], POINTS[[0, -1], ::-1], atol=1e-12)
    with pytest.raises(RecordingError, match="no joint 'c'|'c'"):
        cleaned(path, ["c"])


def test_commands_without_any_motion_are_refused(tmp_path: Path) -> None:
    path = write_commands(tmp_path / "x", "mcap", [Command(times=(1.0,), positions=[[0, 0]])] * 3)
    with pytest.raises(RecordingError, match="none of the 3 trajectories"):
        cleaned(path)
    path = write_commands(tmp_path / "y", "mcap", [Command(positions=np.ones((4, 2)))])
    with pytest.raises(RecordingError, match="nothing moves"):
        cleaned(path)


def test_commanded_motions_are_loaded_without_being_cut(tmp_path: Path, bag_format: str) -> None:
    dwelling = Command(
        times=(0.0, 1.0, 3.0, 4.0),
        positions=[[0, 0], [1, 1], [1, 1], [0, 2]],
        velocities=ZEROS,
        accelerations=ZEROS,
    )
    path = write_commands(tmp_path / "x", bag_format, [dwelling])
    loaded = load_recordings([path])
    (demonstration,) = loaded.demonstrations
    assert demonstration.duration == pytest.approx(4.0, abs=0.4)
    assert loaded.reports[0].topic == "/command"
    found = inspect_recording(path)
    assert (found.topic, found.n_messages, found.joint_names) == ("/command", 1, ("a", "b"))
    assert found.refusal is None


def test_joint_states_come_before_commands(tmp_path: Path) -> None:
    states = write_bag(tmp_path / "states", "mcap", stamped(np.ones((20, 2))))
    commands = write_commands(tmp_path / "commands", "mcap", [Command()])
    assert load_recordings([commands], topic="/command").demonstrations
    (refusal,) = load_recordings([states], topic="/command").refused
    assert "no joint states on '/command'" in refusal.reason
    assert [topic.type for topic in list_topics(commands)] == [KIND]


@pytest.mark.parametrize("name", ["t.bag", "t", "t.db3"])
def test_a_planned_motion_is_a_demonstration(tmp_path: Path, name: str) -> None:
    trajectory = Trajectory(("a", "b"), TIMES, POINTS, RATES, ZEROS)
    write_joint_trajectory(tmp_path / name, trajectory)
    (piece,) = cleaned(tmp_path / name).pieces
    np.testing.assert_allclose(piece.positions[[0, -1]], POINTS[[0, -1]], atol=1e-12)
    assert piece.times[-1] == pytest.approx(1.2)
