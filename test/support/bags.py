# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags with any content, made without the package's own writer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from mp_pca_planner.recordings.bags import Topic, open_bag
from mp_pca_planner.recordings.joint_states import JointStates

FORMATS = ("rosbag1", "sqlite3", "mcap")
S = 1_000_000_000
EPOCH = 1_700_000_000 * S
"""Some time of day [ns]."""
JOINT_STATE = "sensor_msgs/msg/JointState"

Entry = tuple[str, str, int, Any]
"""Topic, type, time of reception [ns], and a message or its bytes."""


@dataclass
class Message:
    """A joint state as it goes into a bag."""

    names: Sequence[str]
    positions: Sequence[float] | NDArray[np.float64]
    stamp: int
    receive: int | None = None
    topic: str = "/joint_states"
    velocities: Sequence[float] | NDArray[np.float64] = ()

    @property
    def received(self) -> int:
        return self.stamp if self.receive is None else self.receive


class Messages:
    """Makes messages of one ROS version."""

    def __init__(self, bag_format: str = "mcap", store: Typestore | None = None) -> None:
        self.format, self.is_ros1 = bag_format, bag_format == "rosbag1"
        usual = Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_JAZZY
        self.store = store or get_typestore(usual)
        self.serialise: Any = (
            self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        )

    def make(self, kind: str, **values: Any) -> Any:
        """A message whose other fields are zero or empty."""
        types = self.store.fielddefs[kind][1]
        return self.store.types[kind](
            **{name: values[name] if name in values else self._empty(*of) for name, of in types}
        )

    def _empty(self, node: Any, of: Any) -> Any:
        if node.name == "NAME":
            return self.make(of)
        if node.name == "BASE":
            return {"string": "", "bool": False}.get(of[0], 0)
        (inner, kind), _ = of
        is_number = inner.name == "BASE" and kind[0] != "string"
        return np.empty(0, dtype=kind[0]) if is_number else []

    def header(self, stamp: int, frame: str = "world") -> Any:
        seconds, rest = divmod(stamp, S)
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def joint_state(self, state: Message) -> Any:
        return self.make(
            JOINT_STATE,
            header=self.header(state.stamp, ""),
            name=list(state.names),
            position=np.array(state.positions, dtype=float),
            velocity=np.array(state.velocities, dtype=float),
        )


def write_messages(
    path: Path, messages: Messages, entries: Iterable[Entry], *, compression: str = ""
) -> Path:
    """Write messages in the order given; return the path with the suffix of the format.

    `compression` is 'bz2' or 'lz4' of ROS 1, or what is compressed: 'file', 'message' or 'storage'.
    """
    writer: Any
    if messages.is_ros1:
        path = path.with_suffix(".bag")
        writer = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    else:
        plugin = StoragePlugin.MCAP if messages.format == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    unknown = {"md5sum": "0" * 32} if messages.is_ros1 else {"rihs01": "RIHS01_" + "0" * 64}
    connections: dict[tuple[str, str], Any] = {}
    with writer:
        for topic, kind, receive, message in entries:
            if (topic, kind) not in connections:
                how: dict[str, Any] = {"typestore": messages.store}
                if kind not in messages.store.types:
                    how = {"msgdef": "nobody_msgs/Missing x\n", **unknown}
                connections[topic, kind] = writer.add_connection(topic, kind, **how)
            is_raw = isinstance(message, bytes)
            content = message if is_raw else messages.serialise(message, kind)
            writer.write(connections[topic, kind], receive, content)
    return path


def storage_file(path: Path) -> Path:
    """The file of a bag that holds its messages."""
    if path.is_file():
        return path
    return next(file for file in path.iterdir() if file.suffix != ".yaml")


def write_bag(
    path: Path, bag_format: str, states: Iterable[Message], *, unknown_type: bool = False
) -> Path:
    """Write joint states in the order given; return the path with the suffix of the format."""
    messages = Messages(bag_format)
    strange = [("/strange", "nobody_msgs/msg/Strange", EPOCH, b"\x01\x02\x03")] * unknown_type
    entries = ((x.topic, JOINT_STATE, x.received, messages.joint_state(x)) for x in states)
    return write_messages(path, messages, [*strange, *entries])


def list_topics(path: Path, *, salvage: bool = False) -> tuple[Topic, ...]:
    with open_bag(path, salvage=salvage) as bag:
        return bag.topics


def read_joint_states(
    path: Path, topic: str, *, field: str | None = None, salvage: bool = False
) -> JointStates:
    with open_bag(path, salvage=salvage) as bag:
        return bag.joint_states(topic, field)


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
