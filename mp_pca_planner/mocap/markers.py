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
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, frozen_array, set_frozen
from ..exceptions import RecordingError, quote_names, unknown_name
from ..files import load_yaml, read_text, reading
from ..input_limits import INPUT_LIMITS
from ..recordings.bags import MARKER_ARRAY, Bag, Stored, open_bag
from ..recordings.joint_states import NS_PER_S, IntArray

BaseMotion = Literal["moving", "identity"]
BASE_MOTIONS: tuple[BaseMotion, ...] = get_args(BaseMotion)
"""Motion of the root link in the frame that markers are recorded in: its pose is fitted to the
markers on it frame by frame, or it is that frame."""

OriginFit = Literal["position", "length"]
ORIGIN_FITS: tuple[OriginFit, ...] = get_args(OriginFit)
"""Fitted part of a joint's origin in its parent link: its position, or its distance only."""


@dataclass(frozen=True, eq=False)
class MarkerPlacement:
    """A marker on a link.

    Attributes
    ----------
    name : str
        Name in reports.
    link : str
        The link that it is attached to.
    position : array, shape (3,)
        Position in the link's frame [m].
    weight : float
        Weight of its squared distance, over 0.
    body : str
        Name in the recording; its own name unless given.
    offset : array, shape (3,)
        Position of the marker in the recorded body's own frame [m]. A body that is recorded with
        its orientation gives any number of markers.

    Raises
    ------
    RecordingError
        If a position has another shape or is not finite, or the weight is not positive.
    """

    name: str
    link: str
    position: FloatArray
    weight: float = 1.0
    body: str = ""
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    where: InitVar[str] = "marker map"

    def __post_init__(self, where: str) -> None:
        set_frozen(self, body=self.body or self.name)
        for field_, shape in (("position", (3,)), ("offset", (3,)), ("weight", ())):
            what = f"{where}: {field_} of marker '{self.name}'"
            values = frozen_array(getattr(self, field_), shape, what, RecordingError)
            set_frozen(self, **{field_: values})
        if not self.weight > 0.0:
            raise RecordingError(f"{what} is {self.weight:g}, but it must be positive")
        set_frozen(self, weight=float(self.weight))


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
        if not isinstance(content, dict) or not isinstance(content.get("markers"), dict):
            raise RecordingError(
                f"the {where} must hold a mapping 'markers' from names to links and positions"
            )
        for key in content:
            _one_of(key, "key", ("base", "fit_origins", "markers"), where)
        base = content.get("base", "moving")
        fits = content.get("fit_origins", {})
        if not isinstance(fits, dict):
            raise RecordingError(f"{where}: fit_origins must map joints to 'position' or 'length'")
        for joint, fit in fits.items():
            _one_of(fit, f"fit of the origin of joint '{joint}'", ORIGIN_FITS, where)
        return MarkerMap(
            tuple(_placement(str(name), e, where) for name, e in content["markers"].items()),
            _one_of(base, "motion of the base", BASE_MOTIONS, where),
            {str(joint): fit for joint, fit in fits.items()},
            where,
        )


def _placement(name: str, entry: Any, where: str) -> MarkerPlacement:
    if not isinstance(entry, dict) or not {"link", "position"} <= entry.keys():
        raise RecordingError(f"{where}: marker '{name}' must have a link and a position in it")
    for key in entry:
        valid = ("link", "position", "weight", "body", "offset")
        _one_of(key, f"key of marker '{name}'", valid, where)
    body = entry.get("body")
    texts = {"link": str(entry["link"]), "body": "" if body is None else str(body)}
    return MarkerPlacement(name, where=where, **{**entry, **texts})


def _one_of(value: Any, kind: str, valid: tuple[Any, ...], where: str) -> Any:
    if value not in valid:
        raise RecordingError(f"{where}: {unknown_name(kind, str(value), valid)}")
    return value


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


BodySamples = tuple[IntArray, FloatArray, str]
"""Recorded poses of one body.

The header stamps and times of reception [ns], shape (n_samples, 2); the positions [m] and
quaternions (x, y, z, w), which may be 0, shape (n_samples, 7); the frame in which they are given.
"""


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
    bodies = {m.body: _chosen(samples, m, path) for m in markers}
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


def _read_samples(bag: Bag, topic: str) -> dict[str, BodySamples]:
    """Samples of all bodies on a topic, or on the topics below it."""
    named = {item.type: item for item in bag.topics if item.name == topic}
    if MARKER_ARRAY in named:
        return _marker_array(bag, bag.messages([named[MARKER_ARRAY]]))
    frames = [named[kind] for kind in TF_TYPES if kind in named]
    return _bodies(bag, {}, bag.messages(frames)) if frames else _read_topics(bag, topic)


def _marker_array(bag: Bag, stored: Iterator[Stored]) -> dict[str, BodySamples]:
    """Poses in all messages, NaN where a marker is not in the message."""
    stamps, several = array("q"), set[str]()
    # Frame and poses by namespace and id, in flat arrays: a long recording needs little more
    # memory than these.
    found: dict[tuple[str, int], tuple[str, array[float]]] = {}
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
            _, poses = found.setdefault(key, (str(marker.header.frame_id), array("d")))
            _fill(poses, row)
            poses[7 * row :] = array("d", _pose(marker.pose.position, marker.pose.orientation))
        spaces = Counter(space for space, _ in in_message)
        several.update(space for space, count in spaces.items() if count > 1)
        stamps.extend((header, receive))
    all_stamps = np.array(stamps).reshape(-1, 2)
    samples: dict[str, BodySamples] = {}
    for (space, number), (frame, poses) in found.items():
        _fill(poses, len(all_stamps))
        new = np.array(poses).reshape(-1, 7)
        name = f"{space}/{number}" if space in several else space or str(number)
        _, own, _ = samples.setdefault(name, (all_stamps, new, frame))
        seen = ~np.isnan(new).all(axis=1)
        own[seen] = new[seen]
    return samples


def _fill(poses: array[float], n_rows: int) -> None:
    """Fill the poses of a marker with NaN up to a number of rows."""
    poses.extend([np.nan] * (7 * n_rows - len(poses)))


def _pose(position: Any, orientation: Any = None) -> tuple[float, ...]:
    """Position and quaternion of a message; the quaternion is 0 if there is none."""
    q = (0.0,) * 4
    if orientation is not None:
        q = orientation.x, orientation.y, orientation.z, orientation.w
    return position.x, position.y, position.z, *q


def _read_topics(bag: Bag, pattern: str) -> dict[str, BodySamples]:
    wildcard = pattern if "*" in pattern else f"{pattern.rstrip('/')}/*"
    before, _, after = wildcard.partition("*")
    chosen = [t for t in bag.topics if t.type in (POINT, POSE) and fnmatchcase(t.name, wildcard)]
    if not chosen:
        kinds = (MARKER_ARRAY, POINT, POSE, *TF_TYPES)
        good = [f"'{t.name}' ({t.type})" for t in bag.topics if t.type in kinds]
        raise RecordingError(
            f"there are no markers on '{pattern}', nor points or poses on topics below it; topics "
            f"that could hold markers: {', '.join(good) or 'none'}"
        )
    names = {t.name: t.name.removeprefix(before).removesuffix(after) for t in chosen}
    return _bodies(bag, names, bag.messages(chosen))


def _bodies(bag: Bag, names: Mapping[str, str], stored: Iterator[Stored]) -> dict[str, BodySamples]:
    """Samples by name: that of the topic, or of the frame in messages of several."""
    # Frame, stamps and poses by name, in flat arrays.
    found: dict[str, tuple[str, array[int], array[float]]] = {}
    for topic, receive, data in stored:
        message = bag.deserialise(topic, data)
        for name, header, *pose in _poses(message, topic.type, names.get(topic.name, "")):
            frame = str(header.frame_id).lstrip("/")
            first, stamps, poses = found.setdefault(name, (frame, array("q"), array("d")))
            if first != frame:
                raise RecordingError(
                    f"'{name}' is given in two frames in '{topic.name}', '{first}' and "
                    f"'{frame}': record each marker in one frame"
                )
            stamps.extend((_nanoseconds(header.stamp), receive))
            poses.extend(_pose(*pose))
    return {
        name: (np.array(stamps).reshape(-1, 2), np.array(poses).reshape(-1, 7), frame)
        for name, (frame, stamps, poses) in found.items()
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


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _has_position(poses: FloatArray) -> NDArray[np.bool_]:
    # NaN compares false, too.
    return np.asarray((np.abs(poses[:, :3]) < INPUT_LIMITS.position).all(axis=1))


def _chosen(samples: Mapping[str, BodySamples], marker: MarkerPlacement, path: Path) -> BodySamples:
    if marker.body not in samples:
        raise RecordingError(unknown_name("recorded marker", marker.body, sorted(samples)))
    found = _, poses, _ = samples[marker.body]
    if not _has_position(poses).any():
        raise RecordingError(f"marker '{marker.body}' has no finite position in '{path}'")
    return found


def _refuse_mixed_frames(bodies: Mapping[str, BodySamples]) -> None:
    frames: dict[str, list[str]] = {}
    for body, (_, _, frame) in bodies.items():
        frames.setdefault(frame, []).append(body)
    if len(frames) > 1:
        where = "; ".join(f"'{frame}': {quote_names(own)}" for frame, own in frames.items())
        raise RecordingError(
            f"the markers are given in different frames ({where}), but must be in one"
        )


def _assemble(
    bodies: Mapping[str, BodySamples],
) -> tuple[IntArray, IntArray, dict[str, FloatArray]]:
    """Interpolate all bodies at the stamps of the one with most samples."""
    base = max((stamps for stamps, _, _ in bodies.values()), key=len)
    # Header stamps if all are set, else times of reception.
    column = 0 if all(stamps[:, 0].all() for stamps, _, _ in bodies.values()) else 1
    poses = {
        body: own
        if np.array_equal(stamps, base)
        else _resampled(stamps[:, column], own, base[:, column])
        for body, (stamps, own, _) in bodies.items()
    }
    return base[:, 0].copy(), base[:, 1].copy(), poses


def _usual_period(times: IntArray) -> float:
    """Median step of times in any order [ns]; a second if they are all the same."""
    steps = np.diff(np.sort(times))
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else float(NS_PER_S)


def _resampled(times: IntArray, poses: FloatArray, new_times: IntArray) -> FloatArray:
    """Interpolated poses between samples that are near each other, NaN at other times.

    Quaternions are interpolated number by number. Between near samples the result is that of a
    rotation, once they are on the same side and normalised.
    """
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
    result[~inside | (step > _MAX_STEP * _usual_period(times))] = np.nan
    return result


def _point(poses: FloatArray, marker: MarkerPlacement) -> FloatArray:
    """The marker's point on its body; NaN where it is unknown."""
    points: FloatArray = poses[:, :3].copy()
    points[~_has_position(poses)] = np.nan
    if marker.offset.any():
        turned = np.isfinite(poses).all(axis=1) & poses[:, 3:].any(axis=1)
        points[~turned] = np.nan
        points[turned] += Rotation.from_quat(poses[turned, 3:]).apply(marker.offset.copy())
    return points
