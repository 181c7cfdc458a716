# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Maps of markers, and their trajectories from recordings of motion capture systems.

A map is a YAML file with the places of markers on the links of a robot or person.

Three forms of messages are read: one MarkerArray for each frame; one topic of points or poses for
each marker or body; frames of /tf. The first contains whole frames. In the others each marker has
its own samples, which are interpolated at the stamps of the marker with most samples.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import RecordingError, quote_names, unknown_name
from ..files import check_form, load_yaml, read_text, reading
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule
from ..recordings.bags import MARKER_ARRAY, Bag, open_bag
from ..recordings.joint_states import NS_PER_S, IntArray

transform = LazyModule("scipy.spatial.transform")

BaseMotion = Literal["moving", "identity"]
BASE_MOTIONS: tuple[BaseMotion, ...] = get_args(BaseMotion)
"""Motion of the root link in the frame that markers are recorded in: its pose is fitted to the
markers on it frame by frame, or it is that frame."""

OriginFit = Literal["position", "length"]
ORIGIN_FITS: tuple[OriginFit, ...] = get_args(OriginFit)
"""Fitted part of a joint's origin in its parent link: its position, or its distance only."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class MarkerPlacement:
    """A marker on a link.

    Attributes
    ----------
    name : str
        Name in reports.
    link : str
        The link that it is attached to.
    position : tuple of 3 floats
        Position in the link's frame [m].
    weight : float
        Weight of its squared distance, over 0.
    body : str
        Name in the recording; its own name unless given.
    offset : tuple of 3 floats
        Position of the marker in the recorded body's own frame [m]. A body that is recorded with
        its orientation gives any number of markers.
    """

    name: str
    link: str
    position: Point
    weight: float = 1.0
    body: str = ""
    offset: Point = (0.0, 0.0, 0.0)

    @property
    def recorded_name(self) -> str:
        """Name in the recording."""
        return self.body or self.name


@dataclass(frozen=True)
class MarkerMap:
    """All markers, and the parts of the model that are fitted to the recording.

    Attributes
    ----------
    markers : tuple of MarkerPlacement
        The markers.
    base : str
        Motion of the root link, see :data:`BASE_MOTIONS`.
    fit_origins : mapping
        Joints whose origin in the parent link is fitted to each recording, so that one model
        serves people (or calibrations) that differ, see :data:`ORIGIN_FITS`.
    source : str
        Name of the map in messages.
    """

    markers: tuple[MarkerPlacement, ...]
    base: BaseMotion
    fit_origins: Mapping[str, OriginFit]
    source: str = "marker map"


_MARKER = {
    "link": str,
    "position": [float],
    "weight?": float,
    "body?": (str, int, type(None)),
    "offset?": [float],
}
_MAP = {"markers": {str: _MARKER}, "base?": str, "fit_origins?": {str: str}}


def read_marker_map(path: str | Path) -> MarkerMap:
    """Read a marker map from a YAML file.

    The file holds ``markers: {NAME: {link: LINK, position: [x, y, z]}}`` with the optional keys
    ``weight``, ``body`` and ``offset`` for each marker, and optionally ``base`` and
    ``fit_origins: {JOINT: position | length}``; see the classes of this module.

    Raises
    ------
    RecordingError
        If the file can't be read or has other content.
    """
    where = f"marker map '{path}'"
    with reading(f"the {where}", RecordingError):
        content = load_yaml(read_text(path))
        if isinstance(content, dict) and isinstance(content.get("markers"), dict):
            content["markers"] = {str(name): x for name, x in content["markers"].items()}
        check_form(content, _MAP, "it")
        _known_only(content, _MAP, "key", where)
        base, fits = content.get("base", "moving"), content.get("fit_origins", {})
        _known_only([base], BASE_MOTIONS, "motion of the base", where)
        for joint, fit in fits.items():
            _known_only([fit], ORIGIN_FITS, f"fit of the origin of joint '{joint}'", where)
        markers = tuple(_placement(name, x, where) for name, x in content["markers"].items())
    return MarkerMap(markers, base, fits, where)


def _placement(name: str, entry: dict[str, Any], where: str) -> MarkerPlacement:
    _known_only(entry, _MARKER, f"key of marker '{name}'", where)
    points = (
        frozen_array(entry.get(key, [0.0] * 3), (3,), f"{where}: {key} of '{name}'", RecordingError)
        for key in ("position", "offset")
    )
    position, offset = (tuple(point.tolist()) for point in points)
    weight, body = float(entry.get("weight", 1.0)), entry.get("body")
    if not 0.0 < weight < np.inf:
        raise RecordingError(f"{where}: weight of '{name}' is {weight:g}, but must be over 0")
    return MarkerPlacement(
        name, entry["link"], position, weight, "" if body is None else str(body), offset
    )


def _known_only(values: Iterable[str], known: Iterable[str], kind: str, where: str) -> None:
    valid = [name.removesuffix("?") for name in known]
    for value in values:
        if value not in valid:
            raise RecordingError(f"{where}: {unknown_name(kind, str(value), valid)}")


# Largest time between samples, in usual periods, within which a marker counts as present.
_MAX_STEP = 2.5

POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""The same message type by its present name, and by its name in early ROS 1."""


@dataclass(frozen=True, eq=False)
class MarkerTrajectories:
    """Positions of markers, frame by frame, in the order of reception.

    Attributes
    ----------
    topic : str
        Their topic.
    names : tuple of str
        Names of the markers.
    header_stamps, receive_stamps : array of int, shape (n_frames,)
        Time in the header (0: not set) and time of reception [ns].
    positions : array, shape (n_frames, n_markers, 3)
        Positions [m]; NaN where a marker is missing.
    notes : tuple of str
        Notes on the reading, one sentence each.
    """

    topic: str
    names: tuple[str, ...]
    header_stamps: IntArray
    receive_stamps: IntArray
    positions: FloatArray
    notes: tuple[str, ...] = ()


class _Samples(NamedTuple):
    """Recorded poses of one body."""

    # The header stamps and times of reception [ns], shape (n_samples, 2); the positions [m] and
    # quaternions (x, y, z, w), which may be 0, shape (n_samples, 7); the frame in which they are.

    stamps: IntArray
    poses: FloatArray
    frame: str


def read_markers(
    path: Path,
    topic: str,
    markers: Sequence[MarkerPlacement],
    *,
    salvage: bool = False,
) -> MarkerTrajectories:
    """Read the trajectories of some markers.

    Parameters
    ----------
    path :
        The recording.
    topic :
        A topic of MarkerArray, in which the name of a marker is its namespace, ``namespace/id``
        if a message has several of one namespace, or its id if that is empty. Or a topic of
        TFMessage, whose child frames are the markers, all in one parent frame. Or the common part
        of the topics of PointStamped or PoseStamped, one for each marker: ``/mocap`` for
        ``/mocap/NAME``, ``/mocap/*/pose`` for ``/mocap/NAME/pose``.
    markers :
        The markers, and their names in the recording.
    salvage :
        Reads the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If the recording can't be read, no marker is on the topic, or one of them is missing.
    """
    with open_bag(path, salvage=salvage) as bag:
        samples = _read_samples(bag, topic)
        notes = bag.notes
    bodies: dict[str, _Samples] = {}
    frames = defaultdict[str, list[str]](list)
    for name in dict.fromkeys(marker.recorded_name for marker in markers):
        if name not in samples:
            raise RecordingError(unknown_name("recorded marker", name, sorted(samples)))
        bodies[name] = samples[name]
        if not _has_position(bodies[name].poses).any():
            raise RecordingError(f"marker '{name}' has no finite position in '{path}'")
        frames[bodies[name].frame].append(name)
    if len(frames) > 1:
        listed = "; ".join(f"'{frame}': {quote_names(names)}" for frame, names in frames.items())
        raise RecordingError(
            f"the markers are given in different frames ({listed}), but must be in one"
        )
    stamps, poses = _assemble(bodies)
    points = [_point(poses[marker.recorded_name], marker) for marker in markers]
    names = tuple(marker.name for marker in markers)
    times = stamps[:, 0].copy(), stamps[:, 1].copy()
    return MarkerTrajectories(topic, names, *times, np.stack(points, axis=1), notes)


def _read_samples(bag: Bag, topic: str) -> dict[str, _Samples]:
    """Samples of all bodies on a topic, or on the topics below it."""
    on_topic = [item for item in bag.topics if item.name == topic]
    if arrays := [item for item in on_topic if item.type == MARKER_ARRAY]:
        messages = ((t, bag.deserialise(source, x)) for source, t, x in bag.messages(arrays))
        return _marker_array(messages)
    if chosen := [item for item in on_topic if item.type in TF_TYPES]:
        return _bodies(bag, chosen, lambda _: "")
    wildcard = topic if "*" in topic else f"{topic.rstrip('/')}/*"
    before, _, after = wildcard.partition("*")
    chosen = [t for t in bag.topics if t.type in (POINT, POSE) and fnmatchcase(t.name, wildcard)]
    if not chosen:
        kinds = (MARKER_ARRAY, POINT, POSE, *TF_TYPES)
        good = [f"'{t.name}' ({t.type})" for t in bag.topics if t.type in kinds]
        raise RecordingError(
            f"there are no markers on '{topic}', nor points or poses on topics below it; topics "
            f"that could hold markers: {', '.join(good) or 'none'}"
        )
    return _bodies(bag, chosen, lambda name: name.removeprefix(before).removesuffix(after))


def _marker_array(messages: Iterator[tuple[int, Any]]) -> dict[str, _Samples]:
    """Poses in all messages, NaN where a marker is not in the message."""
    stamps, several, frames = array("q"), set[str](), dict[tuple[str, int], str]()
    # Rows and poses by namespace and id, in flat arrays: a long recording needs little more memory.
    flats = defaultdict[tuple[str, int], "array[float]"](lambda: array("d"))
    for row, (receive, message) in enumerate(messages):
        # Only added arrows, cubes, spheres and cylinders are at one place.
        shown = [x for x in message.markers if x.action == 0 and x.type in range(4)]
        header = next(filter(None, (_nanoseconds(x.header.stamp) for x in shown)), 0)
        stamps.extend((header, receive))
        for marker in shown:
            key = str(marker.ns), int(marker.id)
            frames.setdefault(key, str(marker.header.frame_id))
            flats[key].extend((row, *_pose(marker.pose.position, marker.pose.orientation)))
        spaces = Counter(space for space, _ in {(str(x.ns), int(x.id)) for x in shown})
        several.update(space for space, count in spaces.items() if count > 1)
    times = np.array(stamps).reshape(-1, 2)
    samples: dict[str, _Samples] = {}
    for (space, number), flat in flats.items():
        rows = np.array(flat).reshape(-1, 8)
        name = f"{space}/{number}" if space in several else space or str(number)
        empty = np.full((len(times), 7), np.nan)
        _, poses, _ = samples.setdefault(name, _Samples(times, empty, frames[space, number]))
        rows = rows[~np.isnan(rows).any(axis=1)]
        poses[rows[:, 0].astype(int)] = rows[:, 1:]
    return samples


def _bodies(bag: Bag, topics: Sequence[Any], named: Callable[[str], str]) -> dict[str, _Samples]:
    """Samples by name: that of the topic, or of the frame in messages of several."""
    # Frame, stamps and poses by name, in flat arrays.
    tracks: dict[str, tuple[str, array[int], array[float]]] = {}
    for topic, receive, data in bag.messages(topics):
        message = bag.deserialise(topic, data)
        for name, header, *pose in _poses(message, topic.type, named(topic.name)):
            frame = str(header.frame_id).lstrip("/")
            first, stamps, poses = tracks.setdefault(name, (frame, array("q"), array("d")))
            if first != frame:
                raise RecordingError(
                    f"'{name}' is given in two frames in '{topic.name}', '{first}' and "
                    f"'{frame}': record each marker in one frame"
                )
            stamps.extend((_nanoseconds(header.stamp), receive))
            poses.extend(_pose(*pose))
    return {
        name: _Samples(np.array(stamps).reshape(-1, 2), np.array(poses).reshape(-1, 7), frame)
        for name, (frame, stamps, poses) in tracks.items()
    }


def _poses(message: Any, kind: str, name: str) -> Iterator[tuple[Any, ...]]:
    """Name, header, position and orientation of each body in a message."""
    if kind == POINT:
        yield name, message.header, message.point
    elif kind == POSE:
        yield name, message.header, message.pose.position, message.pose.orientation
    else:
        for item in message.transforms:
            child, pose = str(item.child_frame_id).lstrip("/"), item.transform
            yield child, item.header, pose.translation, pose.rotation


def _pose(position: Any, orientation: Any = None) -> tuple[float, ...]:
    """Position and quaternion of a message; the quaternion is 0 if there is none."""
    q = (0.0,) * 4
    if orientation is not None:
        q = orientation.x, orientation.y, orientation.z, orientation.w
    return position.x, position.y, position.z, *q


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _has_position(poses: FloatArray) -> NDArray[np.bool_]:
    # NaN compares false, too.
    return np.asarray((np.abs(poses[:, :3]) < INPUT_LIMITS.position).all(axis=1))


def _assemble(bodies: Mapping[str, _Samples]) -> tuple[IntArray, dict[str, FloatArray]]:
    """Stamps of the body with most samples, and all bodies interpolated at these."""
    base = max((samples.stamps for samples in bodies.values()), key=len)
    # Header stamps if all are set, else times of reception.
    column = 0 if all(samples.stamps[:, 0].all() for samples in bodies.values()) else 1
    return base, {
        body: poses
        if np.array_equal(stamps, base)
        else _resampled(stamps[:, column], poses, base[:, column])
        for body, (stamps, poses, _) in bodies.items()
    }


def _resampled(times: IntArray, poses: FloatArray, new_times: IntArray) -> FloatArray:
    """Interpolated poses between samples that are near each other, NaN at other times."""
    # Quaternions are interpolated number by number. Between near samples the result is that of a
    # rotation, once they are on the same side and normalised.
    usable = _has_position(poses)
    times, first = np.unique(times[usable], return_index=True)
    poses = poses[usable][first]
    signs = np.cumprod(np.where(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0.0, -1.0, 1.0))
    poses[1:, 3:] *= signs[:, None]
    seconds, new_seconds = (times - times[0]) / NS_PER_S, (new_times - times[0]) / NS_PER_S
    result = np.column_stack([np.interp(new_seconds, seconds, column) for column in poses.T])
    after = np.searchsorted(times, new_times)
    before = np.searchsorted(times, new_times, side="right") - 1
    inside = (after < times.size) & (before >= 0)
    step = times[np.minimum(after, times.size - 1)] - times[np.maximum(before, 0)]
    usual = float(np.median(np.diff(times))) if times.size > 1 else float(NS_PER_S)
    result[~inside | (step > _MAX_STEP * usual)] = np.nan
    return result


def _point(poses: FloatArray, marker: MarkerPlacement) -> FloatArray:
    """The marker's point on its body; NaN where it is unknown."""
    points: FloatArray = poses[:, :3].copy()
    points[~_has_position(poses)] = np.nan
    if any(marker.offset):
        turned = np.isfinite(poses).all(axis=1) & poses[:, 3:].any(axis=1)
        points[~turned] = np.nan
        points[turned] += transform.Rotation.from_quat(poses[turned, 3:]).apply(marker.offset)
    return points
