# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of markers from recordings of motion capture systems.

Three forms of messages are read: one MarkerArray for each frame; one topic of points or poses for
each marker or body; frames of /tf. The first contains whole frames. In the others each marker has
its own samples, which are interpolated at the stamps of the marker with most samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names, unknown_name
from ..input_limits import INPUT_LIMITS
from ..recordings.bags import Bag, IntArray, open_bag
from ..recordings.byte_layout import NS_PER_S
from ..recordings.inspection import MarkerFinding
from .frame_tree import clock_of, has_rotation, usual_period
from .marker_map import MarkerPlacement
from .marker_messages import BodySamples, read_samples, samples_on

MAX_STEP_PERIODS = 2.5
"""Largest time between samples, in usual periods, within which a marker counts as present."""


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


def read_markers(
    path: Path, topic: str, markers: Sequence[MarkerPlacement], *, salvage: bool = False
) -> MarkerTrajectories:
    """Read the trajectories of some markers.

    Parameters
    ----------
    path :
        The recording.
    topic :
        A topic of MarkerArray, in which the name of a marker is its namespace, ``namespace/id``
        if a message has several of one namespace, or its id if that is empty. Or a topic of
        TFMessage, whose child frames are the markers. Or the common part of the topics of
        PointStamped or PoseStamped, one for each marker: ``/mocap`` for ``/mocap/NAME``,
        ``/mocap/*/pose`` for ``/mocap/NAME/pose``.
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
        samples = read_samples(bag, topic, {m.body for m in markers})
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


def find_markers(bag: Bag) -> tuple[MarkerFinding, ...]:
    """Markers on all topics that may hold some.

    Raises
    ------
    RecordingError
        If the recording can't be read.
    """
    return tuple(
        _finding(topic.name, name, samples)
        for topic in bag.topics
        for name, samples in samples_on(bag, topic).items()
    )


def _finding(topic: str, name: str, samples: BodySamples) -> MarkerFinding:
    finite = _has_position(samples.poses)
    stamps = samples.stamps[finite]
    times = np.sort(stamps[:, clock_of([stamps])])
    steps, period = np.diff(times), usual_period(times)
    moving = bool((steps > 0).any())
    return MarkerFinding(
        topic,
        name,
        rate=NS_PER_S / period if moving else None,
        n_samples=int(times.size),
        missing_share=1.0 - times.size / max(1, finite.size),
        n_gaps=int(np.count_nonzero(steps > MAX_STEP_PERIODS * period)) if moving else 0,
    )


def _has_position(poses: FloatArray) -> NDArray[np.bool_]:
    # NaN compares false, too.
    return np.asarray((np.abs(poses[:, :3]) < INPUT_LIMITS.position).all(axis=1))


def _chosen(samples: Mapping[str, BodySamples], marker: MarkerPlacement, path: Path) -> BodySamples:
    if marker.body not in samples:
        raise RecordingError(unknown_name("recorded marker", marker.body, sorted(samples)))
    found = samples[marker.body]
    if not _has_position(found.poses).any():
        raise RecordingError(f"marker '{marker.body}' has no finite position in '{path}'")
    return found


def _refuse_mixed_frames(bodies: Mapping[str, BodySamples]) -> None:
    frames: dict[str, list[str]] = {}
    for body, samples in bodies.items():
        frames.setdefault(samples.frame, []).append(body)
    if len(frames) > 1:
        where = "; ".join(f"'{frame}': {quote_names(own)}" for frame, own in frames.items())
        raise RecordingError(
            f"the markers are given in different frames ({where}), but must be in one"
        )


def _assemble(
    bodies: Mapping[str, BodySamples],
) -> tuple[IntArray, IntArray, dict[str, FloatArray]]:
    """Interpolate all bodies at the stamps of the one with most samples."""
    base = max((samples.stamps for samples in bodies.values()), key=len)
    column = clock_of([samples.stamps for samples in bodies.values()])
    poses = {
        body: samples.poses
        if np.array_equal(samples.stamps, base)
        else _resampled(samples.stamps[:, column], samples.poses, base[:, column])
        for body, samples in bodies.items()
    }
    return base[:, 0].copy(), base[:, 1].copy(), poses


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
    result[~inside | (step > MAX_STEP_PERIODS * usual_period(times))] = np.nan
    return result


def _point(poses: FloatArray, marker: MarkerPlacement) -> FloatArray:
    """The marker's point on its body; NaN where it is unknown."""
    from scipy.spatial.transform import Rotation

    points: FloatArray = poses[:, :3].copy()
    points[~_has_position(poses)] = np.nan
    if marker.offset.any():
        turned = has_rotation(poses)
        points[~turned] = np.nan
        points[turned] += Rotation.from_quat(poses[turned, 3:]).apply(marker.offset.copy())
    return points
