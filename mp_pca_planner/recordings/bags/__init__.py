# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bag files of ROS 1 and ROS 2: find, read and write them."""

from ..byte_layout import NS_PER_S
from ..joint_states import IntArray
from .bag import Bag, Stored, Topic, choose_topic, list_topics, open_bag, read_joint_states
from .discovery import (
    FORMAT_OF_SUFFIX,
    BagFormat,
    checksum,
    find_recordings,
    recording_format,
    recording_names,
    stored_size,
)
from .serialisation import JOINT_STATE, JOINT_TRAJECTORY, MARKER_ARRAY
from .writing import write_joint_states, write_joint_trajectory, write_markers

__all__ = [
    "FORMAT_OF_SUFFIX",
    "JOINT_STATE",
    "JOINT_TRAJECTORY",
    "MARKER_ARRAY",
    "NS_PER_S",
    "Bag",
    "BagFormat",
    "IntArray",
    "Stored",
    "Topic",
    "checksum",
    "choose_topic",
    "find_recordings",
    "list_topics",
    "open_bag",
    "read_joint_states",
    "recording_format",
    "recording_names",
    "stored_size",
    "write_joint_states",
    "write_joint_trajectory",
    "write_markers",
]
