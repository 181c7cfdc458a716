# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of markers in all the ways that mocap systems send them, and motions to put into them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg
from support import bags
from support.bags import EPOCH, S, write_messages

MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
OLD_TF = "tf/msg/tfMessage"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
__all__ = ["write_messages"]


class Messages(bags.Messages):
    """Makes messages of one ROS version."""

    def __init__(self, bag_format: str = "mcap") -> None:
        super().__init__(bag_format)
        for kind in (TF, OLD_TF) if self.is_ros1 else ():
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, kind))

    def _of(self, kind: str, values: Iterable[float]) -> Any:
        names = "xyzw"
        numbers = map(float, values)
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip(names, numbers, strict=False)))

    def pose(self, position: Iterable[float], orientation: Iterable[float] = UPRIGHT) -> Any:
        place, turn = self._of("Point", position), self._of("Quaternion", orientation)
        return self.make("geometry_msgs/msg/Pose", position=place, orientation=turn)

    def marker(
        self, space: str, number: int, position: Iterable[float], stamp: int, **changes: Any
    ) -> Any:
        given = {
            "header": self.header(stamp),
            "ns": space,
            "id": number,
            "type": 2,
            "pose": self.pose(position),
            "scale": self._of("Vector3", [0.1] * 3),
        }
        return self.make("visualization_msgs/msg/Marker", **given | changes)

    def marker_array(self, *markers: Any) -> Any:
        return self.make(MARKER_ARRAY, markers=list(markers))

    def point(self, position: Iterable[float], stamp: int, frame: str = "world") -> Any:
        return self.make(POINT, header=self.header(stamp, frame), point=self._of("Point", position))

    def pose_stamped(
        self, position: Iterable[float], orientation: Iterable[float], stamp: int
    ) -> Any:
        return self.make(POSE, header=self.header(stamp), pose=self.pose(position, orientation))

    def transform(
        self,
        parent: str,
        child: str,
        position: Iterable[float],
        stamp: int,
        orientation: Iterable[float] = UPRIGHT,
    ) -> Any:
        place, turn = self._of("Vector3", position), self._of("Quaternion", orientation)
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self.make("geometry_msgs/msg/Transform", translation=place, rotation=turn),
        )


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
