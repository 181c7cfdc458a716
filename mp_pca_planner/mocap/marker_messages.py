# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of bodies from the messages of motion capture systems, whatever their type."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..recordings.bags import MARKER_ARRAY, NS_PER_S, Bag, IntArray, Stored, Topic
from .frame_tree import in_root

POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""The same message type by its present name, and by its name in early ROS 1."""

MARKER_TYPES = (MARKER_ARRAY, POINT, POSE, *TF_TYPES)


@dataclass(frozen=True, eq=False)
class BodySamples:
    """Recorded poses of one body.

    Attributes
    ----------
    stamps : array of int, shape (n_samples, 2)
        Header stamps and times of reception [ns].
    poses : array, shape (n_samples, 7)
        Positions [m] and quaternions (x, y, z, w), which may be 0.
    frame : str
        The frame in which they are given.
    """

    stamps: IntArray
    poses: FloatArray
    frame: str


class _PoseBuffer:
    """Numbers of a body in flat arrays: a long recording needs little more memory than these."""

    def __init__(self, frame: str) -> None:
        self.frame = frame
        self._integers = array("q")
        self._numbers = array("d")

    def add(self, integers: Sequence[int], position: Any, orientation: Any = None) -> None:
        self._integers.extend(integers)
        self._numbers.extend((position.x, position.y, position.z))
        q = orientation
        self._numbers.extend((0.0,) * 4 if q is None else (q.x, q.y, q.z, q.w))

    def samples(self) -> BodySamples:
        """Samples, with the integers in one row for each."""
        poses = np.array(self._numbers, dtype=np.float64).reshape(-1, 7)
        integers = np.array(self._integers, dtype=np.int64)
        return BodySamples(integers.reshape(len(poses), -1), poses, self.frame)


def read_samples(bag: Bag, topic: str, bodies: Collection[str]) -> dict[str, BodySamples]:
    """Samples of all bodies on a topic, see :func:`.markers.read_markers`.

    Only the poses of the named `bodies` are brought to the root of a tree of frames.
    """
    named = {item.type: item for item in bag.topics if item.name == topic}
    if MARKER_ARRAY in named:
        return samples_on(bag, named[MARKER_ARRAY])
    frames = [named[kind] for kind in TF_TYPES if kind in named]
    return _read_frames(bag, frames, bodies) if frames else _read_topics(bag, topic)


def samples_on(bag: Bag, topic: Topic) -> dict[str, BodySamples]:
    """Samples of all bodies on one topic without conversion; none if it is of another type."""
    if topic.type == MARKER_ARRAY:
        return bag.read([topic], partial(_marker_array, bag))
    if topic.type in (POINT, POSE):
        names = {topic.name: topic.name.rpartition("/")[2]}
        return bag.read([topic], partial(_single_bodies, bag, names))
    if topic.type in TF_TYPES:
        return bag.read([topic], partial(_frames, bag, (), set()))
    return {}


def _marker_array(bag: Bag, stored: Iterator[Stored]) -> dict[str, BodySamples]:
    """Poses in all messages, NaN where a marker is not in the message."""
    stamps: list[tuple[int, int]] = []
    found: dict[tuple[str, int], _PoseBuffer] = {}
    several: set[str] = set()
    for row, (source, receive, data) in enumerate(stored):
        header = 0
        in_message: set[tuple[str, int]] = set()
        for marker in bag.deserialise(source, data).markers:
            # Only added arrows, cubes, spheres and cylinders are at one place.
            if marker.action != 0 or marker.type not in range(4):
                continue
            key = str(marker.ns), int(marker.id)
            in_message.add(key)
            header = header or _nanoseconds(marker.header.stamp)
            buffer = found.setdefault(key, _PoseBuffer(str(marker.header.frame_id)))
            buffer.add((row,), marker.pose.position, marker.pose.orientation)
        spaces = [space for space, _ in in_message]
        if len(set(spaces)) < len(spaces):
            several.update(space for space in spaces if spaces.count(space) > 1)
        stamps.append((header, receive))
    all_stamps = np.array(stamps, dtype=np.int64).reshape(-1, 2)
    samples: dict[str, BodySamples] = {}
    for (space, number), buffer in found.items():
        name = f"{space}/{number}" if space in several else space
        empty = np.full((len(stamps), 7), np.nan)
        own = samples.setdefault(
            name if space else str(number), BodySamples(all_stamps, empty, buffer.frame)
        )
        seen = buffer.samples()
        own.poses[seen.stamps[:, 0]] = seen.poses
    return samples


def _read_topics(bag: Bag, pattern: str) -> dict[str, BodySamples]:
    wildcard = pattern if "*" in pattern else f"{pattern.rstrip('/')}/*"
    before, _, after = wildcard.partition("*")
    chosen = [t for t in bag.topics if t.type in (POINT, POSE) and fnmatchcase(t.name, wildcard)]
    if not chosen:
        good = [f"'{t.name}' ({t.type})" for t in bag.topics if t.type in MARKER_TYPES]
        raise RecordingError(
            f"there are no markers on '{pattern}', nor points or poses on topics below it; topics "
            f"that could hold markers: {', '.join(good) or 'none'}"
        )
    names = {t.name: t.name.removeprefix(before).removesuffix(after) for t in chosen}
    return bag.read(chosen, partial(_single_bodies, bag, names))


def _single_bodies(
    bag: Bag, names: Mapping[str, str], stored: Iterator[Stored]
) -> dict[str, BodySamples]:
    buffers: dict[str, _PoseBuffer] = {}
    for topic, receive, data in stored:
        message = bag.deserialise(topic, data)
        stamps = _nanoseconds(message.header.stamp), receive
        buffer = buffers.setdefault(names[topic.name], _PoseBuffer(str(message.header.frame_id)))
        if topic.type == POINT:
            buffer.add(stamps, message.point)
        else:
            buffer.add(stamps, message.pose.position, message.pose.orientation)
    return {name: buffer.samples() for name, buffer in buffers.items()}


def _read_frames(
    bag: Bag, topics: Sequence[Topic], bodies: Collection[str]
) -> dict[str, BodySamples]:
    static = [
        t for t in bag.topics if t.type in TF_TYPES and t.name == "/tf_static" and t not in topics
    ]
    fixed: set[str] = set()
    tree = bag.read([*topics, *static], partial(_frames, bag, static, fixed))
    return {
        child: BodySamples(samples.stamps, *in_root(child, tree, fixed))
        if child in bodies
        else samples
        for child, samples in tree.items()
    }


def _frames(
    bag: Bag, static: Collection[Topic], fixed: set[str], stored: Iterator[Stored]
) -> dict[str, BodySamples]:
    """Samples of frames by name; those of static topics are added to the set of fixed ones."""
    buffers: dict[str, _PoseBuffer] = {}
    for source, receive, data in stored:
        for item in bag.deserialise(source, data).transforms:
            child, parent = (
                str(name).lstrip("/") for name in (item.child_frame_id, item.header.frame_id)
            )
            known = buffers.setdefault(child, _PoseBuffer(parent))
            if known.frame != parent:
                raise RecordingError(
                    f"frame '{child}' has two parents in '{source.name}', '{known.frame}' and "
                    f"'{parent}': record each frame under one parent"
                )
            stamps = _nanoseconds(item.header.stamp), receive
            known.add(stamps, item.transform.translation, item.transform.rotation)
            if source in static:
                fixed.add(child)
    return {child: buffer.samples() for child, buffer in buffers.items()}


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
