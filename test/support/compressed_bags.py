# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings in every compression."""

from __future__ import annotations

from pathlib import Path

from support.bags import EPOCH, JOINT_STATE, Message, Messages, S, storage_file, write_messages

__all__ = ["compressed_bag", "storage_file"]
_OF_ROS2 = {"zstd": "storage", "zstd file": "file", "zstd message": "message"}


def compressed_bag(folder: Path, compression: str, n_messages: int) -> Path:
    """Write joint states that count up; ROS 1 for bz2 and lz4, mcap for zstd."""
    mode = _OF_ROS2.get(compression, compression)
    bag_format = (
        "mcap" if mode == "storage" else "sqlite3" if compression in _OF_ROS2 else "rosbag1"
    )
    messages = Messages(bag_format)
    stamps = [EPOCH + k * (S // 1000) for k in range(n_messages)]
    entries = [
        ("/joint_states", JOINT_STATE, stamp, messages.joint_state(Message(["a"], [k], stamp)))
        for k, stamp in enumerate(stamps)
    ]
    path = write_messages(folder / "x", messages, entries, compression=mode)
    return storage_file(path) if compression == "zstd" else path
