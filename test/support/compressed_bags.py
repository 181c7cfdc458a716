# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings in every compression."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from support.bags import EPOCH, S


def storage_file(path: Path) -> Path:
    if path.is_file():
        return path
    return next(file for file in path.iterdir() if file.suffix != ".yaml")


def compressed_bag(folder: Path, compression: str, n_messages: int) -> Path:
    """Write joint states that count up; ROS 1 for bz2 and lz4, mcap for zstd."""
    ros1 = compression in ("bz2", "lz4")
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    writer: Writer1 | Writer2
    if ros1:
        writer = Writer1(folder / "x.bag")
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    else:
        mode = {"zstd": "STORAGE", "zstd file": "FILE", "zstd message": "MESSAGE"}[compression]
        plugin = StoragePlugin.MCAP if mode == "STORAGE" else StoragePlugin.SQLITE3
        writer = Writer2(folder / "x", version=9, storage_plugin=plugin)
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for index in range(n_messages):
            stamp = EPOCH + index * (S // 1000)
            time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, S))
            header = store.types["std_msgs/msg/Header"](*((0,) if ros1 else ()), time, "")
            numbers = np.array([float(index)])
            message = store.types[kind](header, ["a"], numbers, np.empty(0), np.empty(0))
            serialise = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connection, stamp, serialise(message, kind))
    if ros1:
        return folder / "x.bag"
    return storage_file(folder / "x") if compression == "zstd" else folder / "x"
