# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags with any content, made without the package's own writer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from mp_pca_planner.recordings.bags import Topic, open_bag
from mp_pca_planner.recordings.joint_states import JointStates

FORMATS = ("rosbag1", "sqlite3", "mcap")
S = 1_000_000_000
EPOCH = 1_700_000_000 * S
"""Some time of day [ns]."""


@dataclass
class Message:
    """A joint state as it goes into a bag."""

    names: Sequence[str]
    positions: Sequence[float] | NDArray[np.float64]
    stamp: int
    receive: int | None = None
    topic: str = "/joint_states"
    velocities: Sequence[float] | NDArray[np.float64] = ()


def list_topics(path: Path, *, salvage: bool = False) -> tuple[Topic, ...]:
    with open_bag(path, salvage=salvage) as bag:
        return bag.topics


def read_joint_states(
    path: Path, topic: str, *, field: str | None = None, salvage: bool = False
) -> JointStates:
    with open_bag(path, salvage=salvage) as bag:
        return bag.joint_states(topic, field=field)


def bag_writer(path: Path, bag_format: str) -> tuple[Path, Writer1 | Writer2]:
    """A writer of a format, and the path with the format's suffix, where it writes."""
    if bag_format == "rosbag1":
        path = path.with_suffix(".bag")
        return path, Writer1(path)
    plugin = StoragePlugin.MCAP if bag_format == "mcap" else StoragePlugin.SQLITE3
    return path, Writer2(path, version=9, storage_plugin=plugin)


def write_bag(
    path: Path, bag_format: str, messages: Iterable[Message], *, unknown_type: bool = False
) -> Path:
    """Write messages in the order given; return the path with the suffix of the format."""
    store = get_typestore(Stores.ROS1_NOETIC if bag_format == "rosbag1" else Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    path, writer = bag_writer(path, bag_format)
    if bag_format == "rosbag1":
        digest = {"md5sum": "0" * 32}
        serialize, extra = store.serialize_ros1, (0,)
    else:
        digest = {"rihs01": "RIHS01_" + "0" * 64}
        serialize, extra = store.serialize_cdr, ()
    with writer:
        if unknown_type:
            strange = writer.add_connection(
                "/strange", "nobody_msgs/msg/Strange", msgdef="nobody_msgs/Missing x\n", **digest
            )
            writer.write(strange, EPOCH, b"\x01\x02\x03")
        connections = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, kind, typestore=store
                )
            stamp = store.types["builtin_interfaces/msg/Time"](*divmod(message.stamp, S))
            header = store.types["std_msgs/msg/Header"](*extra, stamp, "")
            content = store.types[kind](
                header,
                list(message.names),
                np.ascontiguousarray(message.positions, dtype=np.float64),
                np.ascontiguousarray(message.velocities, dtype=np.float64),
                np.empty(0),
            )
            receive = message.stamp if message.receive is None else message.receive
            writer.write(connections[message.topic], receive, serialize(content, kind))
    return path


def minimum_jerk(start: float, goal: float, n_steps: int) -> NDArray[np.float64]:
    """Positions of a reach from rest to rest, shape (n_steps,)."""
    s = np.linspace(0.0, 1.0, n_steps)
    return start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)


def reaching(
    goals: Sequence[float], *, rate: float = 100.0, reach: float = 1.0, rest: float = 1.0
) -> NDArray[np.float64]:
    """Two joints that rest and reach in turn, first and last at rest, shape (n_steps, 2)."""
    parts = [np.full(round(rest * rate), goals[0])]
    for start, goal in pairwise(goals):
        parts.append(minimum_jerk(start, goal, round(reach * rate)))
        parts.append(np.full(round(rest * rate), goal))
    first = np.concatenate(parts)
    return np.column_stack([first, -0.5 * first])


def stamped(
    positions: NDArray[np.float64],
    *,
    names: Sequence[str] = ("a", "b"),
    rate: float = 100.0,
    start: int = EPOCH,
) -> list[Message]:
    """Make a message of each row, at a constant rate."""
    return [
        Message(names, row, start + round(index * S / rate)) for index, row in enumerate(positions)
    ]
