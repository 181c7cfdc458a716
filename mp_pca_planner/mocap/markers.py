# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Marker recordings: from the messages that mocap systems send to trajectories of points.

Three ways to send markers are read: one MarkerArray for each frame; one topic of points or poses
for each marker or body; frames of /tf. The first has its frames as they are. In the others each
marker has samples of its own, which are brought to the stamps of the one that has most.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names, unknown_name
from ..recordings.bags import MARKER_ARRAY, NS_PER_S, Bag, IntArray, Stored, Topic, open_bag
from ..recordings.inspection import MarkerFinding
from ..recordings.repair import MAX_POSITION
from .marker_map import MarkerPlacement

POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
TF_TYPES = (TF, "tf/msg/tfMessage")
"""The same message by its present name, and by that of the first years of ROS 1."""

MARKER_TYPES = (MARKER_ARRAY, POINT, POSE, *TF_TYPES)
TF_STATIC_TOPIC = "/tf_static"

_SINGLE_MARKERS = range(4)  # arrow, cube, sphere and cylinder: those that are at one place
_ADD = 0

MAX_STEP_PERIODS = 2.5
"""Between samples farther apart than that many usual periods a marker is missing."""

_POSE = 7  # position and quaternion (x, y, z, w)


@dataclass(frozen=True, eq=False)
class MarkerTrajectories:
    """Positions of markers, frame by frame, in the order of reception.

    Attributes
    ----------
    topic : str
        Where they come from.
    names : tuple of str
        Names of the markers.
    header_stamps, receive_stamps : array of int, shape (n_frames,)
        Time in the header (0: not set) and time of reception [ns].
    positions : array, shape (n_frames, n_markers, 3)
        Where they are [m]; NaN where a marker is missing.
    notes : tuple of str
        What is worth knowing about how they were read, one sentence each.
    """

    topic: str
    names: tuple[str, ...]
    header_stamps: IntArray
    receive_stamps: IntArray
    positions: FloatArray
    notes: tuple[str, ...] = ()


def read_markers(
    path: Path, topic: str, markers: Sequence[MarkerPlacement], *, salvage: bool = False
) -> MarkerTrajectories:
    """Read the trajectories of some markers.

    Parameters
    ----------
    path :
        The recording.
    topic :
        A topic of MarkerArray, in which markers are called by their namespace, by
        ``namespace/id`` where a message has several of one namespace, and by their id where it is
        empty. Or a topic of TFMessage, whose child frames are the markers. Or what the topics of
        PointStamped or PoseStamped have in common, one for each marker: ``/mocap`` for
        ``/mocap/NAME``, ``/mocap/*/pose`` for ``/mocap/NAME/pose``.
    markers :
        Which ones, and what they are called in the recording.
    salvage :
        Of a damaged recording, take what is before the damage.

    Raises
    ------
    RecordingError
        If the recording can't be read, no marker is on the topic, or one of them is missing.
    """
    with open_bag(path, salvage=salvage) as bag:
        samples = _read_samples(bag, topic, {m.body for m in markers})
        notes = bag.notes
    bodies = {m.body: _wanted(samples, m, path) for m in markers}
    _refuse_mixed_frames(bodies)
    header, receive, poses = _assemble(bodies)
    return MarkerTrajectories(
        topic,
        tuple(m.name for m in markers),
        header,
        receive,
        np.stack([_point(poses[m.body], m) for m in markers], axis=1),
        notes,
    )


def find_markers(bag: Bag) -> tuple[MarkerFinding, ...]:
    """Look into all topics that may hold markers.

    Raises
    ------
    RecordingError
        If the recording can't be read.
    """
    found = []
    for topic in bag.topics:
        if topic.type == MARKER_ARRAY:
            samples = bag.read([topic], partial(_marker_array, bag))
        elif topic.type in (POINT, POSE):
            chosen = {topic.name: topic.name.rpartition("/")[2]}
            samples = bag.read([topic], partial(_single_markers, bag, chosen=chosen))
        elif topic.type in TF_TYPES:
            frames = bag.read([topic], partial(_frames, bag, static=(), fixed=set()))
            samples = {name: buffer.samples() for name, buffer in frames.items()}
        else:
            continue
        found += [_finding(topic.name, name, own) for name, own in samples.items()]
    return tuple(found)


def _finding(topic: str, name: str, samples: _Samples) -> MarkerFinding:
    finite = (np.abs(samples.poses[:, :3]) < MAX_POSITION).all(axis=1)
    stamps = samples.stamps[finite]
    times = np.sort(stamps[:, 0 if stamps[:, 0].all() else 1])
    steps = np.diff(times)
    moving = bool((steps > 0).any())
    return MarkerFinding(
        topic,
        name,
        NS_PER_S / _period(times) if moving else None,
        int(times.size),
        1.0 - times.size / max(1, finite.size),
        int(np.count_nonzero(steps > MAX_STEP_PERIODS * _period(times))) if moving else 0,
    )


@dataclass(frozen=True, eq=False)
class _Samples:
    """What was recorded of one body.

    Attributes
    ----------
    stamps : array of int, shape (n_samples, 2)
        Header stamps and times of reception [ns].
    poses : array, shape (n_samples, 7)
        Positions [m] and quaternions (x, y, z, w), which may be 0.
    frame : str
        The frame they are given in.
    """

    stamps: IntArray
    poses: FloatArray
    frame: str


class _Buffer:
    """Gathers integers and poses flat: a long recording takes little more than its numbers."""

    def __init__(self, frame: str) -> None:
        self.frame = frame
        self._integers = array("q")
        self._numbers = array("d")

    def add(self, integers: Sequence[int], pose: Sequence[float]) -> None:
        self._integers.extend(integers)
        self._numbers.extend(pose)

    @property
    def integers(self) -> IntArray:
        """All integers."""
        return np.array(self._integers, dtype=np.int64)

    @property
    def poses(self) -> FloatArray:
        """All poses, shape (n_samples, 7)."""
        return np.array(self._numbers, dtype=np.float64).reshape(-1, _POSE)

    def samples(self) -> _Samples:
        """What was gathered, if the integers are pairs of stamps."""
        return _Samples(self.integers.reshape(-1, 2), self.poses, self.frame)


def _read_samples(bag: Bag, topic: str, bodies: set[str]) -> dict[str, _Samples]:
    named = {item.type: item for item in bag.topics if item.name == topic}
    frames = [named[kind] for kind in TF_TYPES if kind in named]
    if MARKER_ARRAY in named:
        return bag.read([named[MARKER_ARRAY]], lambda stored: _marker_array(bag, stored))
    if frames:
        return _read_frames(bag, frames, bodies)
    return _read_topics(bag, topic)


def _marker_array(bag: Bag, stored: Iterator[Stored]) -> dict[str, _Samples]:
    stamps = array("q")
    found: dict[tuple[str, int], _Buffer] = {}
    several: set[str] = set()
    for frame, (source, receive, data) in enumerate(stored):
        message = bag.deserialise(source, data)
        header = 0
        in_message: set[tuple[str, int]] = set()
        for marker in message.markers:
            if marker.action != _ADD or marker.type not in _SINGLE_MARKERS:
                continue
            space, number = str(marker.ns), int(marker.id)
            in_message.add((space, number))
            header = header or _nanoseconds(marker.header.stamp)
            buffer = found.setdefault((space, number), _Buffer(str(marker.header.frame_id)))
            buffer.add((frame,), _pose(marker.pose.position, marker.pose.orientation))
        spaces = [space for space, _ in in_message]
        if len(set(spaces)) < len(spaces):
            several.update(space for space in spaces if spaces.count(space) > 1)
        stamps.extend((header, receive))
    return _by_name(np.array(stamps, dtype=np.int64).reshape(-1, 2), found, several)


def _by_name(
    stamps: IntArray, found: Mapping[tuple[str, int], _Buffer], several: set[str]
) -> dict[str, _Samples]:
    """Poses in all frames, NaN where a marker is not in the message."""
    samples: dict[str, _Samples] = {}
    for key, buffer in found.items():
        name = _marker_name(*key, several)
        if name not in samples:
            samples[name] = _Samples(stamps, np.full((len(stamps), _POSE), np.nan), buffer.frame)
        samples[name].poses[buffer.integers] = buffer.poses
    return samples


def _marker_name(space: str, number: int, several: set[str]) -> str:
    if not space:
        return str(number)
    return f"{space}/{number}" if space in several else space


def _read_topics(bag: Bag, pattern: str) -> dict[str, _Samples]:
    wildcard = pattern if "*" in pattern else f"{pattern.rstrip('/')}/*"
    before, _, after = wildcard.partition("*")
    chosen = {
        item.name: item.name.removeprefix(before).removesuffix(after)
        for item in bag.topics
        if item.type in (POINT, POSE) and fnmatchcase(item.name, wildcard)
    }
    if not chosen:
        good = [f"'{t.name}' ({t.type})" for t in bag.topics if t.type in MARKER_TYPES]
        raise RecordingError(
            f"there are no markers on '{pattern}', nor points or poses on topics below it; topics "
            f"that could hold markers: {', '.join(good) or 'none'}"
        )
    wanted = [item for item in bag.topics if item.name in chosen and item.type in (POINT, POSE)]
    return bag.read(wanted, lambda stored: _single_markers(bag, stored, chosen))


def _single_markers(
    bag: Bag, stored: Iterator[Stored], chosen: Mapping[str, str]
) -> dict[str, _Samples]:
    buffers: dict[str, _Buffer] = {}
    for topic, receive, data in stored:
        message = bag.deserialise(topic, data)
        stamp, frame = _nanoseconds(message.header.stamp), str(message.header.frame_id)
        if topic.type == POINT:
            pose = _pose(message.point, None)
        else:
            pose = _pose(message.pose.position, message.pose.orientation)
        buffers.setdefault(chosen[topic.name], _Buffer(frame)).add((stamp, receive), pose)
    return {name: buffer.samples() for name, buffer in buffers.items()}


def _read_frames(bag: Bag, topics: Sequence[Topic], bodies: set[str]) -> dict[str, _Samples]:
    static = [
        t
        for t in bag.topics
        if t.type in TF_TYPES and t.name == TF_STATIC_TOPIC and t not in topics
    ]
    fixed: set[str] = set()
    buffers = bag.read([*topics, *static], lambda stored: _frames(bag, stored, set(static), fixed))
    tree = {child: buffer.samples() for child, buffer in buffers.items()}
    return {
        child: _in_root(child, tree, fixed) if child in bodies else samples
        for child, samples in tree.items()
    }


def _frames(
    bag: Bag, stored: Iterator[Stored], static: Collection[Topic], fixed: set[str]
) -> dict[str, _Buffer]:
    """Gather frames by name; add those that never move to the set of fixed ones."""
    buffers: dict[str, _Buffer] = {}
    for source, receive, data in stored:
        for item in bag.deserialise(source, data).transforms:
            child = str(item.child_frame_id).lstrip("/")
            parent = str(item.header.frame_id).lstrip("/")
            known = buffers.setdefault(child, _Buffer(parent))
            if known.frame != parent:
                raise RecordingError(
                    f"frame '{child}' has two parents in '{source.name}', '{known.frame}' and "
                    f"'{parent}': record each frame under one parent"
                )
            pose = _pose(item.transform.translation, item.transform.rotation)
            known.add((_nanoseconds(item.header.stamp), receive), pose)
            if source in static:
                fixed.add(child)
    return buffers


def _in_root(child: str, tree: Mapping[str, _Samples], fixed: set[str]) -> _Samples:
    """A frame's poses in the root of its tree, at the frame's own stamps."""
    chain = [child]
    while (parent := tree[chain[-1]].frame) in tree:
        if parent in chain:
            raise RecordingError(f"frames {quote_names(chain)} are each other's parents")
        chain.append(parent)
    stamps, poses = tree[child].stamps, tree[child].poses
    for ancestor in chain[1:]:
        own = tree[ancestor]
        index = (
            np.zeros(len(stamps), dtype=np.int64)
            if ancestor in fixed
            else _same_time(stamps, own.stamps)
        )
        outer = np.where((index >= 0)[:, None], own.poses[index], np.nan)
        poses = _compose(outer, poses)
    return _Samples(stamps, poses, tree[chain[-1]].frame)


def _same_time(stamps: IntArray, others: IntArray) -> IntArray:
    """Which of the others is nearest in time; -1 where none is within half a usual period."""
    column = 0 if stamps[:, 0].all() and others[:, 0].all() else 1
    times, theirs = stamps[:, column], others[:, column]
    order = np.argsort(theirs, kind="stable")
    right = np.clip(np.searchsorted(theirs[order], times), 1, max(1, order.size - 1))
    right = np.minimum(right, order.size - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(theirs[order[left]] - times) <= np.abs(theirs[order[right]] - times)
    nearest = order[np.where(nearer_left, left, right)]
    return np.where(np.abs(theirs[nearest] - times) <= 0.5 * _period(theirs), nearest, -1)


def _period(times: IntArray) -> float:
    steps = np.diff(np.sort(times))
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else float(NS_PER_S)


def _compose(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Poses of inner frames given in outer ones, in the frame the outer ones are given in."""
    from scipy.spatial.transform import Rotation

    result = np.full(inner.shape, np.nan)
    usable = _has_rotation(outer) & _has_rotation(inner)
    first = Rotation.from_quat(outer[usable, 3:])
    result[usable, :3] = outer[usable, :3] + first.apply(inner[usable, :3])
    result[usable, 3:] = (first * Rotation.from_quat(inner[usable, 3:])).as_quat()
    return result


def _has_rotation(poses: FloatArray) -> Any:
    return np.isfinite(poses).all(axis=1) & (np.abs(poses[:, 3:]).sum(axis=1) > 0.0)


def _wanted(samples: Mapping[str, _Samples], marker: MarkerPlacement, path: Path) -> _Samples:
    if marker.body not in samples:
        raise RecordingError(unknown_name("recorded marker", marker.body, sorted(samples)))
    found = samples[marker.body]
    if not (np.abs(found.poses[:, :3]) < MAX_POSITION).all(axis=1).any():
        raise RecordingError(f"marker '{marker.body}' has no finite position in '{path}'")
    return found


def _refuse_mixed_frames(bodies: Mapping[str, _Samples]) -> None:
    frames = dict.fromkeys(samples.frame for samples in bodies.values())
    if len(frames) > 1:
        where = "; ".join(
            f"'{frame}': {quote_names(b for b, s in bodies.items() if s.frame == frame)}"
            for frame in frames
        )
        raise RecordingError(
            f"the markers are given in different frames ({where}), but must be in one"
        )


def _assemble(bodies: Mapping[str, _Samples]) -> tuple[IntArray, IntArray, dict[str, FloatArray]]:
    """Bring all bodies to the stamps of the one that has most samples."""
    stamps = {body: samples.stamps for body, samples in bodies.items()}
    base = max(stamps.values(), key=len)
    column = 0 if all(own[:, 0].all() for own in stamps.values()) else 1
    poses = {
        body: samples.poses
        if np.array_equal(stamps[body], base)
        else _resampled(stamps[body][:, column], samples.poses, base[:, column])
        for body, samples in bodies.items()
    }
    return base[:, 0].copy(), base[:, 1].copy(), poses


def _resampled(times: IntArray, poses: FloatArray, wanted: IntArray) -> FloatArray:
    """Positions between samples that are near each other, NaN elsewhere.

    Orientations are interpolated number by number: between samples that are near each other
    that is what a rotation does, too, once the quaternions are on the same side and normalised.
    """
    usable = (np.abs(poses[:, :3]) < MAX_POSITION).all(axis=1)
    times, first = np.unique(times[usable], return_index=True)
    poses = poses[usable][first]
    signs = np.cumprod(np.where(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0.0, -1.0, 1.0))
    poses[1:, 3:] *= signs[:, None]
    seconds = (times - times[0]) / NS_PER_S
    asked = (wanted - times[0]) / NS_PER_S
    result = np.column_stack([np.interp(asked, seconds, column) for column in poses.T])
    after = np.searchsorted(times, wanted)
    before = np.searchsorted(times, wanted, side="right") - 1
    inside = (after < times.size) & (before >= 0)
    step = times[np.minimum(after, times.size - 1)] - times[np.maximum(before, 0)]
    result[~inside | (step > MAX_STEP_PERIODS * _period(times))] = np.nan
    return result


def _point(poses: FloatArray, marker: MarkerPlacement) -> FloatArray:
    """The point of a body that is meant; NaN where it is not known."""
    from scipy.spatial.transform import Rotation

    points: FloatArray = poses[:, :3].copy()
    # NaN compares false, too.
    points[~(np.abs(points) < MAX_POSITION).all(axis=1)] = np.nan
    if marker.offset.any():
        turned = _has_rotation(poses)
        points[~turned] = np.nan
        points[turned] += Rotation.from_quat(poses[turned, 3:]).apply(marker.offset.copy())
    return points


def _pose(position: Any, orientation: Any) -> tuple[float, ...]:
    place = (position.x, position.y, position.z)
    if orientation is None:
        return (*place, 0.0, 0.0, 0.0, 0.0)
    return (*place, orientation.x, orientation.y, orientation.z, orientation.w)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
