# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of markers in all the ways that mocap systems send them, and motions to put into them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from support.bags import EPOCH, S, bag_writer

MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
OLD_TF = "tf/msg/tfMessage"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)

Entry = tuple[str, str, int, Any]
"""Topic, type, time of reception [ns], message."""


class Messages:
    """Makes messages of one ROS version."""

    def __init__(self, bag_format: str = "mcap") -> None:
        self.format = bag_format
        ros1 = bag_format == "rosbag1"
        self.store: Typestore = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
        if ros1:
            for kind in (TF, OLD_TF):
                definition = "geometry_msgs/TransformStamped[] transforms"
                self.store.register(get_types_from_msg(definition, kind))
        self._sequence = {"seq": 0} if ros1 else {}

    def make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def header(self, stamp: int, frame: str = "world") -> Any:
        time = self.make("builtin_interfaces/msg/Time", *divmod(stamp, S))
        fields = {**self._sequence, "stamp": time, "frame_id": frame}
        return self.store.types["std_msgs/msg/Header"](**fields)

    def pose(self, position: Iterable[float], orientation: Iterable[float] = UPRIGHT) -> Any:
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *map(float, position)),
            self.make("geometry_msgs/msg/Quaternion", *map(float, orientation)),
        )

    def marker(
        self, space: str, number: int, position: Iterable[float], stamp: int, **changes: Any
    ) -> Any:
        kind = "visualization_msgs/msg/Marker"
        nothing = {
            "color": self.make("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 1.0),
            "scale": self.make("geometry_msgs/msg/Vector3", 0.1, 0.1, 0.1),
            "lifetime": self.make("builtin_interfaces/msg/Duration", 0, 0),
            "frame_locked": False,
            "points": [],
            "colors": [],
            "text": "",
            "mesh_resource": "",
            "mesh_use_embedded_materials": False,
        }
        if self.format != "rosbag1":
            image = self.make(
                "sensor_msgs/msg/CompressedImage", self.header(0), "", np.empty(0, dtype=np.uint8)
            )
            nothing |= {
                "texture_resource": "",
                "texture": image,
                "uv_coordinates": [],
                "mesh_file": self.make(
                    "visualization_msgs/msg/MeshFile", "", np.empty(0, dtype=np.uint8)
                ),
            }
        values = {
            "header": self.header(stamp),
            "ns": space,
            "id": number,
            "type": 2,
            "action": 0,
            "pose": self.pose(position),
            **nothing,
            **changes,
        }
        return self.store.types[kind](**values)

    def marker_array(self, *markers: Any) -> Any:
        return self.make(MARKER_ARRAY, list(markers))

    def point(self, position: Iterable[float], stamp: int, frame: str = "world") -> Any:
        point = self.make("geometry_msgs/msg/Point", *map(float, position))
        return self.make(POINT, self.header(stamp, frame), point)

    def pose_stamped(
        self, position: Iterable[float], orientation: Iterable[float], stamp: int
    ) -> Any:
        return self.make(POSE, self.header(stamp), self.pose(position, orientation))

    def transform(
        self,
        parent: str,
        child: str,
        position: Iterable[float],
        stamp: int,
        orientation: Iterable[float] = UPRIGHT,
    ) -> Any:
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            self.header(stamp, parent),
            child,
            self.make(
                "geometry_msgs/msg/Transform",
                self.make("geometry_msgs/msg/Vector3", *map(float, position)),
                self.make("geometry_msgs/msg/Quaternion", *map(float, orientation)),
            ),
        )


def write_messages(path: Path, messages: Messages, entries: Iterable[Entry]) -> Path:
    """Write messages in the order given; return the path with the suffix of the format."""
    store = messages.store
    path, writer = bag_writer(path, messages.format)
    serialize = store.serialize_ros1 if messages.format == "rosbag1" else store.serialize_cdr
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for topic, kind, receive, message in entries:
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic, kind], receive, serialize(message, kind))
    return path


def write_marker_arrays(
    path: Path,
    trajectories: Mapping[str, np.ndarray],
    *,
    rate: float = 100.0,
    bag_format: str = "mcap",
    topic: str = "/markers",
) -> Path:
    """Write a MarkerArray for each frame, markers by namespace; those that are NaN left out."""
    messages = Messages(bag_format)
    entries = []
    for k in range(len(next(iter(trajectories.values())))):
        stamp = EPOCH + round(k * S / rate)
        markers = [
            messages.marker(name, i, places[k], stamp)
            for i, (name, places) in enumerate(trajectories.items())
            if np.isfinite(places[k]).all()
        ]
        entries.append((topic, MARKER_ARRAY, stamp, messages.marker_array(*markers)))
    return write_messages(path, messages, entries)
